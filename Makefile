# `make run` sets up .venv first, `make test` and `make docs` add what they need; nothing is installed again until
# pyproject.toml, constraints.txt or this file changes.

PYTHON ?= python3
# Linux wheels of torch without CUDA. For the CUDA build: make setup TORCH_INDEX=
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.set-up
# Errors, and no warnings: an index that is out of reach matters only if a package is found nowhere else.
# pip warns of every index out of reach, however quiet it is told to be: shown where it fails.
LOG := $(VENV)/set-up.log
PIP := $(BIN)/python -m pip install -qq --retries 1
TORCH := $(shell grep '^torch==' constraints.txt)

# From bytecode every program starts sooner by a third of a second; the tests start hundreds.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help run test docs setup clean

help: ## list these targets
	@sed -nE 's/^([a-z]+):.*## (.*)/make \1\t\2/p' $(MAKEFILE_LIST)

run: setup ## fly the paper's square at 50x, measured, and write a report
	$(BIN)/uavaccel run dp1 --clock 50

# One core compiles kernels, which tests load, while another checks types and compiles the tests.
test: $(STAMP)-dev ## linter, types and tests
	$(BIN)/ruff check .
	$(BIN)/python -m tests.compile_kernels & $(BIN)/mypy; typed=$$?; \
		$(BIN)/pytest -n0 --collect-only -qq >/dev/null; wait && exit $$typed
	$(BIN)/pytest

# The variable keeps the theme from advertising its successor.
docs: $(STAMP)-docs ## the documentation as a site, in build/docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict
	@echo "build/docs/index.html"

setup: $(STAMP) ## an environment in .venv with all that is needed

# A group of pyproject.toml's: dev, docs.
$(STAMP)-%: $(STAMP)
	@$(PIP) --constraint constraints.txt --group $* 2>$(LOG) || { cat $(LOG) >&2; exit 1; }
	@touch $@

$(STAMP): pyproject.toml constraints.txt Makefile
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "$(PYTHON) is older than Python 3.11: make PYTHON=python3.11 ..." >&2; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || \
		{ echo "no virtual environment: apt-get install python3-venv" >&2; exit 1; }
	@echo "setting up $(VENV); the first time takes minutes"
	@$(PIP) --constraint constraints.txt pip 2>$(LOG) || { cat $(LOG) >&2; exit 1; }
	@$(PIP) $(TORCH_INDEX:%=--extra-index-url %) "$(TORCH)" 2>$(LOG) || { cat $(LOG) >&2; exit 1; }
	@$(PIP) --constraint constraints.txt --editable '.[film,learn]' 2>$(LOG) || { cat $(LOG) >&2; exit 1; }
	@touch $@

clean: ## remove .venv, builds and caches
	rm -rf $(VENV) dist build .mypy_cache .pytest_cache .ruff_cache .hypothesis
