# spoofgym needs Python 3.11 to 3.13; choose one with `make PYTHON=python3.12 bench`.
PYTHON ?= python3
VENV   ?= .venv

python := $(VENV)/bin/python

# Processes that share the tests, file by file.
WORKERS ?= auto

# What each target needs beside the library itself.
extras_bench := flights,report
extras_check := flights,report,dev
extras_test  := flights,report,video,dev,train
extras_train := report,train

.DEFAULT_GOAL := help
.PHONY: help venv bench test check perf train

help: ## list the targets
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/  make \1\t\2/p' Makefile

venv: $(VENV)/.installed-bench ## create the virtual environment with what the benchmark needs

bench: $(VENV)/.installed-bench ## play the benchmark and write its report
	$(VENV)/bin/spoofgym bench $(ARGS)

test: $(VENV)/.installed-test ## run all tests; a part of them with ARGS="-k word"
	$(python) -m pytest -n $(WORKERS) --dist loadfile $(ARGS)

check: $(VENV)/.installed-check ## format, lint, types, import directions, docstrings, spelling
	$(python) -m ruff format --check .
	$(python) -m ruff check .
	$(python) -m mypy
	$(VENV)/bin/lint-imports
	find spoofgym -name '*.py' -exec $(python) -m numpydoc lint {} +
	$(VENV)/bin/codespell

train: $(VENV)/.installed-train ## train a spoofer, for example ARGS="--out runs/my-first"
	$(python) -m train.ppo_spoofer $(ARGS)

perf: $(VENV)/.installed-bench ## measure the speed of this machine
	$(VENV)/bin/spoofgym perf $(ARGS)

# One stamp for each set of extras, renewed when the dependencies change.
$(VENV)/.installed-%: pyproject.toml constraints.txt | $(python)
	$(python) -m pip install --quiet --prefer-binary -c constraints.txt -e '.[$(extras_$*)]'
	@touch $@

$(python):
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' || { \
	  echo "spoofgym needs Python 3.11 to 3.13, and $(PYTHON) is:" >&2; \
	  $(PYTHON) --version >&2; \
	  echo "choose another one: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); exit 1; }
