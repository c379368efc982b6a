# Every target builds the environment first where it is missing or out of date.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.DEFAULT_GOAL := help
.PHONY: help setup demo test test-slow test-portable check format bench paper lock clean

help: ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /  \1\t/' | expand -t 14

setup: $(READY) ## build the environment in .venv, and nothing else

$(READY): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "tacevo needs Python 3.11 or later; got $$($(PYTHON) --version); give one with PYTHON=..."; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --requirement requirements.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

demo: $(READY) ## run a small search, and print what it found and where to look
	$(BIN)/tacevo search experiment=demo

test: $(READY) ## run the tests, two at a time
	$(BIN)/pytest --numprocesses 2

test-slow: $(READY) ## run the tests that take minutes
	$(BIN)/pytest -m slow

test-portable: $(READY) ## compare bits with those of emulated CPUs (qemu-user; ten minutes)
	$(BIN)/pytest -m portable

check: $(READY) ## formatting, lint, types and import direction
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(READY) ## format the code
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

bench: $(READY) ## measure speed and memory beside a peer, in the same run
	$(BIN)/python -m benchmarks

# The runs that come with the project; RUNS="DIR DIR" names others.
RUNS ?= $(patsubst %/run.json,%,$(wildcard cache/published/*/run.json))
FOUND := $(patsubst %/run.json,%,$(wildcard runs/*/run.json))

paper: ## every table and figure of the shipped runs, or of RUNS="DIR DIR", into build/paper
	@test -n "$(RUNS)" || { echo "no run comes with the project yet: cache/published/ holds none"; \
		echo "name runs of yours: make paper RUNS=$(or $(firstword $(FOUND)),runs/NAME)"; exit 2; }
	@$(MAKE) --no-print-directory $(READY)
	$(BIN)/tacevo paper $(RUNS) --output build/paper

lock: ## resolve the dependencies anew into requirements.lock
	rm -rf build/lock
	$(PYTHON) -m venv build/lock
	build/lock/bin/pip install --quiet --disable-pip-version-check torch==2.13.0 hatchling editables '.[dev]'
	build/lock/bin/pip freeze --all --exclude tacevo --exclude pip --exclude setuptools --exclude wheel \
		| sed -E 's/\+cpu$$//' > requirements.lock

clean: ## remove the environment, builds and caches of tools; runs and stores stay
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
