# TacEvo with what running needs, and a checkout in /tacevo. It ends with the demo:
#
#     docker build -t tacevo . && docker run --rm tacevo
#
# Other commands: docker run --rm -v "$PWD:/work" -w /work tacevo tacevo replay cache/published/grating-claude.zip
# By its tag: a digest can be learned from a registry only, which was not at hand. `docker pull` prints it.
FROM python:3.11-slim-bookworm
ARG PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu
RUN apt-get update && apt-get install --yes --no-install-recommends git make && rm -rf /var/lib/apt/lists/*
WORKDIR /tacevo
COPY . .
RUN make setup && rm -rf /root/.cache
ENV PATH=/tacevo/.venv/bin:$PATH
CMD ["make", "demo"]
