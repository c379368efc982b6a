#!/usr/bin/env bash
# aarch64.sh DIR: put Debian's Python 3.11 for aarch64 and what running needs, but torch, into DIR (0.8 GB). On Debian.
set -euo pipefail
mkdir -p "$1"
here=$(realpath "$1")
cd "$(dirname "$0")/../../.."
mkdir -p "$here"/apt/{lists,archives}/partial
touch "$here/apt/status"
# Its own lists and archives: the machine's packages stay what they are.
echo "deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] http://deb.debian.org/debian bookworm main" \
  > "$here/apt/sources.list"
fetch() {
  apt-get --quiet=2 --yes -o APT::Architecture=arm64 -o APT::Architectures=arm64 -o Debug::NoLocking=1 \
    -o Dir::State="$here/apt" -o Dir::State::status="$here/apt/status" -o Dir::Cache="$here/apt" \
    -o Dir::Etc::SourceList="$here/apt/sources.list" -o Dir::Etc::SourceParts=- "$@"
}
fetch update
fetch install --download-only --no-install-recommends python3.11 libgomp1 libstdc++6
for package in "$here"/apt/archives/*.deb; do dpkg -x "$package" "$here/root"; done
rm -rf "$here/site"
.venv/bin/pip install --quiet --disable-pip-version-check --no-compile --target "$here/site" --no-deps --require-hashes \
  --implementation cp --python-version 3.11 --platform manylinux_2_17_aarch64 --platform manylinux_2_27_aarch64 \
  --platform manylinux_2_28_aarch64 --only-binary :all: --no-binary antlr4-python3-runtime --requirement requirements.lock
