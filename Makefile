# Every target builds the environment first where it is missing or out of date: what running needs, or with it what
# tests and checks need.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DEV := $(VENV)/.ready-dev
# Pip alone is still for a minute and more.
INSTALL := $(BIN)/python .ci/install.py
PEERS := build/peers
TABLE_PEERS := build/table-peers
DOCS := build/docs
AUDIT := build/audit

# Two tests at a time, each on a core of its own; a worker that is done takes over tests of the other.
TWO := --numprocesses 2 --dist worksteal
test test-core test-parts test-slow test-all test-cluster test-cluster-all coverage: export OMP_NUM_THREADS := 1
# Tests start hundreds of processes, which would each compile the package again where this is set.
test test-core test-parts test-slow test-all test-cluster test-cluster-all coverage: export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: help setup check-only demo examples test snapshots test-core test-parts test-slow test-all test-portable bits aarch64 test-gpu test-cluster test-cluster-all coverage check format bench bench-quick bench-table mutants replay paper pictures schemas docs release audit lock clean

help: ## list the targets
	@grep -hE '^[a-z0-9-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z0-9-]+):.*## /  \1\t/' | expand -t 20

setup: $(READY) ## build the environment that running needs in .venv, and nothing else

$(READY): requirements.lock torch.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "tacevo needs Python 3.11 or later; got $$($(PYTHON) --version); give one with PYTHON=..."; exit 1; }
	@echo "Making $(VENV), an environment of its own, with what running needs: 119 packages as $< has them, and torch."
	@echo "0.4 GB to fetch, 1.8 GB on the disk, under two minutes of a core. Nothing outside $(VENV) is changed but pip's cache."
	@echo "On Linux without a GPU, PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu saves gigabytes of CUDA;"
	@echo "where it cannot be reached, leave it unset (docs/installation.md)."
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --no-deps --require-hashes --requirement requirements.lock
	$(INSTALL) --requirement torch.lock
	$(INSTALL) --no-deps --no-build-isolation --editable .
	$(BIN)/pip check
	@touch $@

$(DEV): $(READY) requirements-dev.lock
	@echo "Installing what tests and checks need into $(VENV): 45 packages, 0.9 GB more."
	$(INSTALL) --no-deps --require-hashes --requirement requirements-dev.lock
	$(BIN)/pip check
	@touch $@

# An environment beside the other: who checks results trains nothing, tracks nothing and asks no model.
CHECK := .venv-check
check-only: $(CHECK)/.ready ## build what replaying, tables, figures and pages need in .venv-check: no torch, no MLflow

$(CHECK)/.ready: requirements-check.lock pyproject.toml
	@echo "Making $(CHECK): 51 packages, 0.6 GB on the disk, a minute of a core."
	$(PYTHON) -m venv $(CHECK)
	$(CHECK)/bin/python .ci/install.py --no-deps --require-hashes --requirement requirements-check.lock
	$(CHECK)/bin/python .ci/install.py --no-deps --no-build-isolation --editable .
	@echo "ready: source $(CHECK)/bin/activate"
	@touch $@

demo: $(READY) ## run a small search, train its best networks again with other seeds, and print what was found
	$(BIN)/tacevo search experiment=demo run.dir=runs/demo
	$(BIN)/tacevo noise runs/demo elites=2 seeds=12
	$(BIN)/tacevo report runs/demo

test: $(DEV) ## run the quick tests, two at a time (ten minutes on two slow cores)
	$(BIN)/pytest $(TWO)

snapshots: $(DEV) ## write the texts anew that tests compare (tests/**/__snapshots__), to be read as a difference and committed
	$(BIN)/pytest $(TWO) --snapshot-update

test-core: $(DEV) ## the core's tests, or those of TESTS="DIR DIR", with every part that can be left out hidden from import
	$(BIN)/pytest $(TWO) --without-rooms $(TESTS)

# Pytest ends with 5 where a part has slow tests alone.
PARTS := $(notdir $(wildcard tests/rooms/*)) crate
test-parts: $(DEV) ## the tests of each such part, or of PARTS="NAME NAME", with all others hidden
	@for part in $(PARTS); do echo "$$part, alone with the core"; \
		$(BIN)/pytest $(TWO) --quiet --room $$part || test $$? = 5 || exit; done

test-slow: $(DEV) ## run the tests that attack each promise further, or for long
	$(BIN)/pytest $(TWO) -m "slow and not cluster"

test-all: $(DEV) ## run brute force, too (hours); all but test-portable and test-cluster
	$(BIN)/pytest $(TWO) -m "not portable and not cluster" --hypothesis-profile thorough

test-portable: $(DEV) ## compare bits with those of emulated CPUs (qemu-user; ten minutes)
	$(BIN)/pytest -m portable

bits: $(DEV) ## find the functions whose bits MKL's vector library chooses by the CPU (minutes)
	$(BIN)/python tests/support/portable/vector_library.py

aarch64: $(DEV) ## fetch a Python for aarch64, whose bytes test-portable then compares, too (on Debian; 0.9 GB, minutes)
	tests/support/portable/aarch64.sh build/aarch64

test-gpu: $(DEV) ## run the tests that need an NVIDIA GPU
	$(BIN)/pytest -m gpu

test-cluster: $(DEV) ## run the tests on clusters of several nodes: Ray, and Slurm where it is installed
	$(BIN)/pytest tests/rooms/ray tests/rooms/slurm -m "cluster and not slow"

test-cluster-all: $(DEV) ## the same, and those that wait for minutes
	$(BIN)/pytest tests/rooms/ray tests/rooms/slurm -m cluster

coverage: $(DEV) ## run `make test` and `make test-slow`, and print the lines that no test reaches
	$(BIN)/pytest $(TWO) -m "not long and not portable and not cluster" --cov --cov-report=term-missing:skip-covered

mutants: $(DEV) ## put 64 small faults into the package, one at a time, and see which of them the tests find (hours)
	$(BIN)/python -m benchmarks.mutants

check: $(DEV) ## formatting, lint, types and import direction
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy
	$(BIN)/lint-imports

# The package stands in an environment of its own, which sees the packages of ours.
examples: $(DEV) ## install the example package into a fresh environment, and run its tests
	rm -rf build/examples
	$(BIN)/python -m venv --without-pip build/examples
	$(BIN)/python -c 'import site; print(f"import site; site.addsitedir({site.getsitepackages()[0]!r})")' \
		> "$$(build/examples/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/project.pth"
	$(BIN)/pip --python build/examples/bin/python install --quiet --disable-pip-version-check --no-deps --no-build-isolation \
		./examples/tacevo_lexicase
	OMP_NUM_THREADS=1 build/examples/bin/python -m pytest -q examples/tacevo_lexicase/tests

format: $(DEV) ## format the code
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

bench: $(PEERS)/.ready ## measure speed and memory beside a peer, in the same run (14 to 30 minutes on two quiet cores)
	$(BIN)/python -m benchmarks

bench-quick: $(PEERS)/.ready ## run each of its benchmarks once on next to nothing, to see that it runs
	$(BIN)/python -m benchmarks --quick

# SMAC3's searches were seen to repeat with one seed of Python's hashes, and not without.
bench-table: $(TABLE_PEERS)/.ready ## let optimisers of others search the table of a space (an hour of a core)
	OMP_NUM_THREADS=1 PYTHONHASHSEED=0 $(TABLE_PEERS)/bin/python -m benchmarks.peers_table

# As it stood when it answered, with the code of then: make answered NAME="evidence --trials 200"
ANSWERED := b2f46d5c54ec455f1106bb9899ca329f95253a5f
answered: $(READY) ## run a benchmark of an answered question: NAME=evidence, niches, difficulty, curves or linear
	@test -d build/answered/$(ANSWERED) || git worktree add --detach build/answered/$(ANSWERED) $(ANSWERED)
	cd build/answered/$(ANSWERED) && $(abspath $(BIN))/python -m benchmarks.$(NAME)

# The peers' own environments; the packages of ours are seen in them, so that both train with one torch.
$(PEERS)/.ready: benchmarks/peers.txt
$(TABLE_PEERS)/.ready: benchmarks/peers_table/peers.txt
$(PEERS)/.ready $(TABLE_PEERS)/.ready: $(DEV)
	$(BIN)/python -m venv --without-pip $(@D)
	$(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))' \
		> "$$($(@D)/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/project.pth"
	$(BIN)/pip --python $(@D)/bin/python install --quiet --disable-pip-version-check --requirement $(filter %.txt,$^)
	@touch $@

# The smaller environment is enough to read what is published, where it alone is there.
READS := $(if $(wildcard $(READY)),$(VENV),$(if $(wildcard $(CHECK)/.ready),$(CHECK),$(VENV)))

# Each line bears the name of its run, since two at a time print.
replay: $(READS)/.ready ## replay the published runs that come with the project, two at a time, and compare everything
	@ls cache/published/*.zip cache/tables/*.zip | xargs -P 2 -I % bash -o pipefail -c '$(READS)/bin/tacevo replay % 2>&1 | sed -u "s|^|$$(basename % .zip): |"'

# Published runs and sweeps, or directories of yours: make paper RUNS="DIR DIR" SWEEPS="DIR"
ifndef RUNS
RUNS := cache/published/grating-grammar.zip cache/published/grating-claude.zip
WINNERS := cache/published/grating-winners.zip
VARIANTS := cache/published/grating-variants.zip cache/published/grating-by-hand.zip cache/published/force-variants.zip
SWEEPS := cache/published/ablation-proposals.zip cache/published/ablation-elites.zip
endif

paper: $(READS)/.ready ## every table and figure of the published runs, or of RUNS="DIR DIR" SWEEPS="DIR", into build/paper
	$(READS)/bin/tacevo report --latex $(RUNS) --output build/paper
	$(if $(WINNERS),$(READS)/bin/tacevo report --latex $(WINNERS) --output build/paper/winners)
	$(if $(VARIANTS),$(READS)/bin/tacevo report --latex $(VARIANTS) --output build/paper/variants)
	@for sweep in $(SWEEPS); do \
		$(READS)/bin/tacevo ablations "$$sweep" --output "build/paper/$$(basename "$$sweep" .zip)" || exit; done
	$(if $(WINNERS),$(READS)/bin/python docs/found/draw.py build/paper/found)

pictures: $(READS)/.ready ## draw every picture of README and of the pages anew, which tests compare
	$(READS)/bin/python docs/site/loop.py docs/figures/loop.svg
	$(READS)/bin/python docs/site/difficulty.py docs/figures/difficulty.svg
	$(READS)/bin/python docs/site/diagrams.py docs/figures
	$(READS)/bin/python docs/site/pictures.py docs/figures
	$(READS)/bin/python docs/found/draw.py docs/found

schemas: $(READS)/.ready ## write the JSON schemas of all files (docs/formats.md) anew, which tests compare
	$(READS)/bin/python docs/site/schemas.py docs/schemas

docs: $(DOCS)/.ready ## build the site into build/docs/site: every page, the references and the notebooks (three minutes)
	$(BIN)/python docs/site/pages.py $(DOCS)/pages
	NO_MKDOCS_2_WARNING=1 $(DOCS)/bin/mkdocs build --quiet --config-file docs/site/mkdocs.yml

$(DOCS)/.ready: $(READY) requirements-docs.lock
	$(PYTHON) -m venv $(DOCS)
	$(DOCS)/bin/python .ci/install.py --no-deps --require-hashes --requirement requirements-docs.lock
	@touch $@

release: ## from a clean checkout: wheel and sdist, checked and tried in empty environments; says what a person uploads
	$(PYTHON) .ci/release.py

audit: $(AUDIT)/.ready ## compare what is locked with the public list of known faults (needs pypi.org)
	@for lock in requirements.lock torch.lock requirements-check.lock requirements-dev.lock requirements-docs.lock; do \
		echo "$$lock"; $(AUDIT)/bin/pip-audit --requirement $$lock --no-deps --disable-pip --strict || exit; done

$(AUDIT)/.ready:
	$(PYTHON) -m venv $(@D)
	$(@D)/bin/pip install --quiet --disable-pip-version-check pip-audit
	@touch $@

OURS := --exclude tacevo --exclude torch --exclude pip --exclude setuptools --exclude wheel
lock: ## resolve the dependencies again into requirements*.lock, with the hashes of every file (ten minutes)
	rm -rf build/lock
	$(PYTHON) -m venv build/lock
	build/lock/bin/pip install --quiet --disable-pip-version-check --requirement torch.lock hatchling editables .
	build/lock/bin/pip freeze --all $(OURS) > build/lock/requirements
	build/lock/bin/pip install --quiet --disable-pip-version-check --constraint build/lock/requirements '.[dev]'
	build/lock/bin/pip freeze --all $(OURS) | grep --invert-match --line-regexp --fixed-strings --file build/lock/requirements \
		> build/lock/requirements-dev
	$(PYTHON) -m venv build/lock/docs
	build/lock/docs/bin/pip install --quiet --disable-pip-version-check mkdocs-material mkdocstrings-python
	build/lock/docs/bin/pip freeze > build/lock/requirements-docs
	build/lock/bin/pip install --quiet --disable-pip-version-check uv
	build/lock/bin/uv pip compile --quiet --no-header --no-annotate --constraint build/lock/requirements requirements-check.in \
		> build/lock/requirements-check
	@for name in requirements requirements-check requirements-dev requirements-docs; do \
		{ sed '/^[^#]/,$$d' $$name.lock; build/lock/bin/uv pip compile --quiet --no-deps --generate-hashes --no-header --no-annotate \
			build/lock/$$name; } > build/lock/$$name.lock && cp build/lock/$$name.lock $$name.lock || exit; \
	done

clean: ## remove the environment, builds and caches of tools; runs and stores stay
	rm -rf $(VENV) $(CHECK) build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis .coverage*
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
