# `make demo` shows what moveset does; `make test` checks that it still does. Both make .venv first; a second call is quick.
#
#   PYTHON=python3.12 make demo     another interpreter (3.11 or newer)
#   TORCH_INDEX=URL make demo       PyTorch's index of CPU wheels, where pip would otherwise choose a CUDA build
#   ANY_TORCH=1 make demo           take whatever build of torch pip chooses
#   MODELS='DIR …' make tables      the papers' tables, from the shipped models and model folders of your own

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:

# OpenMP threads that spin while they wait make small networks crawl as soon as anything else runs on the machine.
export OMP_WAIT_POLICY ?= PASSIVE
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
TORCH := -c constraints.txt $(if $(TORCH_INDEX),--index-url $(TORCH_INDEX)) torch
SOURCES := $(shell find src -type f -not -path '*/__pycache__/*' -not -path '*.egg-info/*')

.PHONY: demo test pytest lint format viewer tables clean
# One clip or segment at a time is quickest with one thread where threads sleep while they wait.
demo: .venv/.demo
	OMP_NUM_THREADS=$${OMP_NUM_THREADS:-1} $(BIN)/python examples/demo.py

# Three processes, since tests of pages and streams wait, and lint beside them; what tests of several files share is made
# once, and the longest comes first.
test: .venv/.dev
	$(MAKE) --no-print-directory --jobs 2 lint pytest

pytest: .venv/.dev
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses 3 --dist loadgroup --no-loadscope-reorder

lint: .venv/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/mypy

format: .venv/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# The pages' builds are committed, so that users need no node; run this after changing anything in viewer/.
viewer:
	cd viewer && npm ci --no-audit --no-fund && npm test && npm run build

# Days: repeats of this commit that are there already are kept, so it can be stopped and called again.
tables: .venv/.dev
	rm -f docs/results/*/*.json
	$(BIN)/moveset evaluate $(MODELS) --suite motionpcm --out docs/results > /dev/null
	$(BIN)/moveset evaluate $(MODELS) --suite rdm --out docs/results > /dev/null
	$(BIN)/python -m moveset.evaluation.report docs/results/motionpcm docs/results/rdm --page docs/results.md

clean:
	rm -rf .venv out build *.egg-info src/*.egg-info .pytest_cache .ruff_cache .mypy_cache .hypothesis .import_linter_cache

# Torch first and alone: resolved together with the rest, a package that asks for another build could replace it.
.venv/.torch: constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "moveset needs Python 3.11 or newer; set PYTHON=…")'
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(if $(ANY_TORCH),,$(PIP) install --dry-run --quiet --no-deps --report - $(TORCH) | $(BIN)/python .ci/check_torch.py)
	$(PIP) install $(TORCH)
	touch $@

# Not editable, so that the demo shows what a user installs; a developer's editable install is left in place.
.venv/.demo: .venv/.torch pyproject.toml $(SOURCES)
	test -e .venv/.dev || $(PIP) install -c constraints.txt .
	touch $@

.venv/.dev: .venv/.torch pyproject.toml
	$(PIP) install -c constraints.txt -e '.[dev]'
	.ci/chromium
	touch $@
