# make rirs and make test set up their own virtual environment on a fresh machine.
SHELL := /bin/sh
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# Python compiles what it imports, and keeps it: not all of every package, which takes as long as the rest of the
# installation. Where the environment forbids to keep it, each of the tests' processes would compile it anew.
export PYTHONDONTWRITEBYTECODE :=
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
# All distributions of this repository are built with what `.made` installs, not each with a copy of its own.
INSTALL := $(PIP) --no-build-isolation

SCENE ?= demo
OUT ?= out
# The demo is a quick look; scenes of your own get the paper's grid.
SPACING ?= $(if $(filter demo,$(SCENE)),1.0,0.5)
CONFIG ?= pipelines/default.toml
JOBS ?=
RATE ?=
STORE ?=
WALKS ?=
POINTS ?=
FIGURES ?= docs/figures
# Who runs the tiles: local, dask, slurm or ray; and what it is told, as in "address=tcp://host:8786 threads=2".
ENGINE ?= local
ENGINE_OPTIONS ?=
PRESET ?= small
SEEDS ?= 1
# The build of PyTorch: cpu, or default for the one that pip prefers, with CUDA on Linux.
TORCH ?= cpu
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
ARGS ?=
BENCH ?= all
BASE ?= main
HOMES ?= 1000
# What `make lint` checks the types of, with what that imports; empty for tests, benchmarks and neighbours too, as
# `make check` and `make test-neighbours` do.
TYPED ?= -p soundspaces_sim
NEIGHBOURS := $(patsubst neighbours/%/pyproject.toml,%,$(wildcard neighbours/*/pyproject.toml))

.DEFAULT_GOAL := help
.PHONY: help install rirs explore collection figures listen nav docs check test test-slow test-lowest test-arrays test-extras test-neighbours test-clients lint bench validate wheels pytest clean

help: ## Show this list
	@echo "make <target> [SCENE=demo|path] [OUT=out] [SPACING=0.5] [CONFIG=$(CONFIG)] [JOBS=n] [RATE=44100] [STORE=echogram] [WALKS=3000] [POINTS=points.txt] [ENGINE=local|dask|slurm|ray] [ENGINE_OPTIONS=\"key=value\"]"
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

$(VENV)/.made: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or newer is needed; set PYTHON=/path/to/python3.11" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(PIP) "hatchling>=1.25" editables
	@touch $@

$(VENV)/.installed: $(VENV)/.made
	$(INSTALL) -e ".[figures]" -e ./neighbours/parameters -e ./neighbours/renderers -e ./neighbours/pictures
	@touch $@

$(VENV)/.tested: $(VENV)/.installed
	$(INSTALL) -e ".[test,dev]"
	@touch $@

$(VENV)/.neighbours: $(VENV)/.tested $(wildcard neighbours/*/pyproject.toml)
	$(INSTALL) --no-deps $(foreach n,$(NEIGHBOURS),-e ./neighbours/$(n))
	@touch $@

$(VENV)/.validates: $(VENV)/.tested
	$(INSTALL) -e ".[validate]"
	@touch $@

$(VENV)/.documented: $(VENV)/.installed
	$(INSTALL) -e ".[docs]"
	@touch $@

# All at once and without what draws figures: who comes to listen waits for no more than that.
$(VENV)/.explores: $(VENV)/.made
	$(INSTALL) -e . -e ./neighbours/parameters -e ./neighbours/renderers -e ./neighbours/explorer
	@touch $@

$(VENV)/.collects: $(VENV)/.installed
	$(INSTALL) --no-deps -e ./neighbours/buildings -e ./neighbours/exports -e ./neighbours/rooms -e ./neighbours/collections
	@touch $@

$(VENV)/.engine-local: $(VENV)/.installed
	@touch $@

$(VENV)/.engine-%: $(VENV)/.installed
	$(INSTALL) -e "./neighbours/clusters[$*]"
	@touch $@

$(VENV)/.navigates: $(VENV)/.installed
	@build=""; if [ "$(TORCH)" = cpu ]; then build=$$($(BIN)/python pipelines/torch_cpu.py --index "$(TORCH_INDEX)") || exit 1; fi; \
	  set -x; $(INSTALL) $$build -e ".[nav,figures]" -e ./neighbours/buildings -e ./neighbours/continuous -e ./neighbours/agents
	@touch $@

install: $(VENV)/.installed ## Set up the virtual environment

rirs: $(VENV)/.engine-$(ENGINE) ## Simulate a scene: grid, transport, shards, manifest
	@$(BIN)/soundspaces-sim rirs "$(SCENE)" --out "$(OUT)" --spacing $(SPACING) --config "$(CONFIG)" \
	  $(if $(JOBS),--jobs $(JOBS)) $(if $(RATE),--rate $(RATE)) $(if $(STORE),--store $(STORE)) $(if $(WALKS),--walks $(WALKS)) \
	  $(if $(POINTS),--points "$(POINTS)") \
	  --engine "$(ENGINE)" $(foreach o,$(ENGINE_OPTIONS),--engine-option "$(o)") $(ARGS)

collection: OUT = out/collection
collection: CONFIG = pipelines/collection.toml
collection: $(VENV)/.engine-$(ENGINE) $(VENV)/.collects ## Datasets of many generated homes: splits, episodes, checksums, report [HOMES=1000] [JOBS=n]
	@$(BIN)/soundspaces-sim collection --out "$(OUT)" --homes $(HOMES) --config "$(CONFIG)" $(if $(JOBS),--jobs $(JOBS)) \
	  $(if $(WALKS),--walks $(WALKS)) --engine "$(ENGINE)" $(foreach o,$(ENGINE_OPTIONS),--engine-option "$(o)") $(ARGS)

figures: $(VENV)/.installed ## Pictures of the demo for the README (SCENE=path for another), in docs/figures
	@mkdir -p "$(FIGURES)"
	@for what in overview map field lobes decay rir error; do \
	  $(BIN)/soundspaces-sim plot "$(SCENE)" --what $$what --replace --out "$(FIGURES)/$$what.png" || exit; done

nav: OUT = out/nav
nav: $(VENV)/.navigates ## Agents that hear: homes, datasets, episodes, training, report [PRESET=quick|small|paper] [SEEDS=1]
	@$(BIN)/soundspaces-agents run --preset "$(PRESET)" --out "$(OUT)" --seeds $(SEEDS) $(if $(JOBS),--jobs $(JOBS)) $(ARGS)

explore: $(VENV)/.explores ## Hear a scene in the browser while it is simulated (SCENE=path, or the folder of a dataset)
	@$(BIN)/soundspaces-sim explore "$(SCENE)" --out "$(OUT)" $(ARGS)

listen: rirs ## Speech, a clap and music at three places and four headings, in OUT/listening
	@$(BIN)/soundspaces-sim listen "$(OUT)/$(basename $(notdir $(SCENE)))" --replace --out "$(OUT)/listening"

docs: $(VENV)/.documented ## The documentation as a site, in build/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "build/site/index.html"

check: $(VENV)/.tested ## Lint and the quick tests of what changed since main (BASE=other branch): before a commit
	@$(MAKE) --no-print-directory lint TYPED=
	$(BIN)/python -m tests.changed $(BASE)

test: $(VENV)/.tested ## Lint, types, layers, tests
	@$(MAKE) --no-print-directory -j 2 lint pytest

pytest: $(VENV)/.tested ## Tests alone, on compiled kernels
	$(BIN)/python -m soundspaces_sim.build.warm_up
	$(BIN)/python -m pytest $(ARGS)

test-slow: $(VENV)/.tested ## Long physics runs
	$(BIN)/python -m pytest -m slow $(if $(ARGS),$(ARGS),tests neighbours)

test-lowest: $(VENV)/.tested ## A small dataset by the lowest versions that pyproject.toml allows, read by the newest and back, in .venv-lowest
	$(BIN)/python -m tests.lowest $(ARGS)

test-arrays: $(VENV)/.tested ## The engine's tests with rays from arrays, as on machines without Embree
	SOUNDSPACES_SIM_RAYS=arrays $(BIN)/python -m pytest tests/transport tests/scene tests/echogram $(ARGS)

test-extras: ## What `make test` skips for want of extras: IFC, browser, Ray, learning, PTX, in .venv-extras (ARGS=GROUP for one)
	$(PYTHON) -m tests.extras --torch-index "$(TORCH_INDEX)" $(ARGS)

test-neighbours: $(VENV)/.neighbours ## Types and tests of what lies in neighbours/, each installed there
	$(BIN)/mypy
	$(BIN)/python -m soundspaces_sim.build.warm_up
	$(BIN)/python -m pytest neighbours $(ARGS)

test-clients: wheels ## Clients of habitat and RLR: their calls, their own checkouts (SOURCES=folder), AudibleLight's own tests (CHECKOUT=path)
	$(BIN)/python -m neighbours.rlr_audio_propagation.tests.clients.run --torch-index "$(TORCH_INDEX)" $(if $(CHECKOUT),--checkout "$(CHECKOUT)") $(if $(SOURCES),--sources "$(SOURCES)") $(ARGS)

wheels: $(VENV)/.tested ## Build the distributions into dist/, install them into empty environments and use them (ARGS=--simulate)
	@rm -f dist/soundspaces_*.whl dist/soundspaces_sim-*.tar.gz dist/rlr_audio_propagation-*.whl
	$(BIN)/python -m build --outdir dist .
	for n in $(NEIGHBOURS); do $(BIN)/python -m build --wheel --outdir dist neighbours/$$n || exit; done
	$(BIN)/python -m tests.use_wheels dist $(ARGS)

lint: $(VENV)/.tested ## ruff, mypy, import-linter
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy $(TYPED)
	$(BIN)/lint-imports

bench: $(VENV)/.tested ## All benchmarks, stored, and benchmarks/RESULTS.md (hours; BENCH="speed.startup …" for some)
	$(BIN)/python -m benchmarks run $(BENCH)

validate: $(VENV)/.validates ## Make the tables of docs/validation.md anew (some 20 minutes)
	$(BIN)/python -m benchmarks.validate

clean: ## Remove the environment, caches and build products (not OUT)
	rm -rf $(VENV) .venv-extras .venv-lowest build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
