# spoofgym needs Python 3.11 or newer; choose one with `make PYTHON=python3.12 bench`.
PYTHON ?= python3
VENV   ?= .venv

python := $(VENV)/bin/python

# RLlib wants an older Gymnasium, the oldest that spoofgym takes: it has an environment of its own.
VENV_RAY ?= .venv-ray

# Processes that share the tests, file by file.
WORKERS ?= auto

# The minutes of make soak.
SOAK_MINUTES ?= 10

# What each target needs beside the library itself.
extras_bench := limits,report
extras_check := flights,limits,report,dev
extras_docs  := docs
extras_test  := flights,limits,logs,report,video,dev,train
extras_train := report,train
extras_learn := flights,limits,report,train

# What is tested with RLlib, Minari and the oldest Gymnasium.
tests_ray := tests/envs tests/duel tests/test_sb3.py tests/docs/test_duel.py tests/docs/test_rl_libraries.py tests/test_cli_dataset.py

.DEFAULT_GOAL := help
bench_detectors = $(addprefix --detector ,cumulative-bank:signals=range_rate snapshot-chi2)
.PHONY: help venv bench test test-nightly test-cpus test-pythons test-ray soak release check docs perf benchmarks train learn

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' Makefile

venv: $(VENV)/.installed-bench ## create the virtual environment with what the benchmark needs

# Where no bytecode may be written beside sources, the environment holds it: each process would
# compile every module again.
ifdef PYTHONDONTWRITEBYTECODE
bench: export PYTHONDONTWRITEBYTECODE :=
bench: export PYTHONPYCACHEPREFIX := $(abspath $(VENV)/bytecode)
endif

bench: $(VENV)/.installed-bench ## play a part of the standard suite by a quick budget, and write its report
	$(VENV)/bin/spoofgym bench --budget quick \
		$(bench_detectors) $(ARGS)

test: $(VENV)/.installed-test ## run all tests; a part of them with ARGS="-k word"
	$(python) -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder $(ARGS)

test-nightly: $(VENV)/.installed-test ## the long lists, with all that the pages let one run; hours
	$(python) -m pytest -n $(WORKERS) -m nightly $(ARGS)

test-cpus: $(VENV)/.installed-test ## test on other kinds of processors that the same bits come out; some with ARGS="haswell znver4"
	$(python) -m tests.cpus $(ARGS)

test-pythons: ## all tests, on every Python of this machine, each in an environment .venv-3.N
	@set -e; for each in 3.11 3.12 3.13 3.14; do \
	  if python$$each --version >/dev/null 2>&1; then $(MAKE) PYTHON=python$$each VENV=.venv-$$each test; \
	  else echo "python$$each is not here: not run"; fi; done

soak: $(VENV)/.installed-test ## wear engine, environments, duel and results down by drawn faults; SOAK_MINUTES=30
	SPOOFGYM_SOAK_MINUTES=$(SOAK_MINUTES) $(python) -m pytest tests/soak --nightly $(ARGS)

release: ## build sdist, wheel and bill of materials, try both in clean environments, print what is left to do by hand
	$(PYTHON) -m tools.release $(ARGS)

test-ray: $(VENV_RAY)/.installed ## test RLlib, Minari and the oldest Gymnasium, in an environment of its own
	$(VENV_RAY)/bin/python -m pytest $(tests_ray) $(ARGS)
	$(VENV_RAY)/bin/python -m pytest tests/bench/experiments/test_runner.py --nightly -k ray

# A fixed hash seed: without one, what types mypy joins differs from run to run.
check: $(VENV)/.installed-check ## format, lint, types, import directions, docstrings, spelling
	$(python) -m ruff format --check .
	$(python) -m ruff check .
	PYTHONHASHSEED=0 $(python) -m mypy
	$(VENV)/bin/lint-imports
	find spoofgym -name '*.py' -exec $(python) -m numpydoc lint {} +
	$(VENV)/bin/codespell

docs: $(VENV)/.installed-docs ## build the pages and the API as a site, build/docs/index.html; warnings are errors
	$(python) -m sphinx -q -W --keep-going -c docs -d build/doctrees . build/docs $(ARGS)
	cp build/docs/README.html build/docs/index.html

train: $(VENV)/.installed-train ## train a spoofer, for example ARGS="--out runs/my-first"
	$(python) -m train.ppo_spoofer $(ARGS)

learn: $(VENV)/.installed-learn ## all trainings behind the pages again, with their scores, into runs/all; hours, and goes on after a kill
	$(python) -m tools.learn_all --out runs/all $(ARGS)

perf: $(VENV)/.installed-bench ## measure the speed of this machine, part by part
	$(python) -m benchmarks.perf $(ARGS)

benchmarks: $(VENV)/.installed-test ## time kernels, detectors, environments and starts, by pytest-benchmark
	$(python) -m pytest benchmarks $(ARGS)

# To write bytecode for everything takes half of an installation; a first start writes its own.
pip_bench := --no-compile

# One stamp for each set of extras, renewed when the dependencies change.
$(VENV)/.installed-%: pyproject.toml constraints.txt | $(python)
	$(python) -m pip install --quiet --prefer-binary $(pip_$*) -c constraints.txt \
	  -e '.[$(extras_$*)]'
	@touch $@

# A version that constraints-ray.txt names is taken from there, all others from constraints.txt.
$(VENV_RAY)/.installed: pyproject.toml constraints.txt constraints-ray.txt | $(VENV_RAY)/bin/python
	awk -F== '!seen[$$1]++' constraints-ray.txt constraints.txt > $(VENV_RAY)/constraints.txt
	$(VENV_RAY)/bin/python -m pip install --quiet --prefer-binary -c $(VENV_RAY)/constraints.txt \
	  -e '.[$(extras_test),ray]' 'minari[arrow,create]'
	@touch $@

python_fits := import sys; print(sys.version_info >= (3, 11) or "")
too_old = spoofgym needs Python 3.11 or newer, got $(shell $(PYTHON) --version 2>&1); try: make PYTHON=python3.12

$(VENV)/bin/python $(VENV_RAY)/bin/python:
	$(if $(shell $(PYTHON) -c '$(python_fits)' 2>/dev/null),,$(error $(too_old) $(MAKECMDGOALS)))
	$(PYTHON) -m venv $(@:/bin/python=) || { rm -rf $(@:/bin/python=); exit 1; }
