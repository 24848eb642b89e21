# `make run` and `make test` set up .venv first; nothing is installed again until pyproject.toml, constraints.txt
# or this file changes. `make docs` adds what builds the documentation.

PYTHON ?= python3
# Linux wheels of torch without CUDA. For the CUDA build: make setup TORCH_INDEX=https://pypi.org/simple
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.set-up
DOCS_STAMP := $(VENV)/.set-up-docs
# Errors, and no warnings: an index that is out of reach matters only if a package is found nowhere else.
# pip warns of every index out of reach, however quiet it is told to be: shown where it fails.
LOG := $(VENV)/set-up.log
PIP := $(BIN)/python -m pip install -qq --retries 1
TORCH := $(shell grep '^torch==' constraints.txt)

.DEFAULT_GOAL := help
.PHONY: help run test docs setup clean

help: ## list these targets
	@sed -nE 's/^([a-z]+):.*## (.*)/make \1\t\2/p' $(MAKEFILE_LIST)

run: setup ## fly the paper's square at 50x, measured, and write a report
	$(BIN)/uavaccel run dp1 --clock 50

test: setup ## linter, types and tests
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/pytest

# The variable keeps the theme from advertising its successor.
docs: $(DOCS_STAMP) ## the documentation as a site, in build/docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict
	@echo "build/docs/index.html"

setup: $(STAMP) ## an environment in .venv with all that is needed

$(DOCS_STAMP): $(STAMP)
	@$(PIP) --constraint constraints.txt --editable '.[docs]' 2>$(LOG) || { cat $(LOG) >&2; exit 1; }
	@touch $@

$(STAMP): pyproject.toml constraints.txt Makefile
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "$(PYTHON) is older than Python 3.11: make PYTHON=python3.11 ..." >&2; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || \
		{ echo "no virtual environment: apt-get install python3-venv" >&2; exit 1; }
	@echo "setting up $(VENV); the first time takes minutes"
	@$(PIP) --extra-index-url $(TORCH_INDEX) "$(TORCH)" 2>$(LOG) || { cat $(LOG) >&2; exit 1; }
	@$(PIP) --constraint constraints.txt --editable '.[dev]' 2>$(LOG) || { cat $(LOG) >&2; exit 1; }
	@touch $@

clean: ## remove .venv, builds and caches
	rm -rf $(VENV) dist build .mypy_cache .pytest_cache .ruff_cache .hypothesis
