# `make demo` is all a newcomer needs. `make test PYTHON=python3.12` tests another interpreter in its own folder.
PYTHON ?= python3
VENV ?= $(if $(filter python3,$(PYTHON)),.venv,.venv-$(notdir $(PYTHON)))
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
OUT ?= out/demo
# Two processes, a file each: nearly twice as fast on two cores.
PYTEST_ARGS ?= -n 2 --dist loadfile --no-loadscope-reorder
# What runs on JAX and MJX: with the code of the docs enough to tell whether another version of them holds.
JAX_TESTS = $(addprefix tests/unit/test_, arrival.py feasibility.py knots.py minsnap_accuracy.py minsnap_many.py \
    minsnap_time_allocation.py minsnap_traced.py policy.py prediction_mixture.py selection.py spline.py \
    spline_operations.py tracking_accuracy.py tracking_body.py tracking_disturbance.py tracking_fidelity.py tracking_physics.py tracking_plant.py \
    tracking_rollout.py tracking_track.py vehicle_flatness.py world_clearance.py) $(addprefix tests/integration/test_, \
    canaries.py planner.py plant_tools.py)

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help demo test test-jax test-slow test-docs test-browser test-firmware check format bench bench-check docs examples release-check clean

help:
	@echo "make demo       install, fly one interception, draw it (under 5 minutes)"
	@echo "make test       the fast tests (PYTHON=python3.12 for another interpreter)"
	@echo "make test-jax   those of them that touch JAX and MJX"
	@echo "make test-slow  the slow tests"
	@echo "make test-firmware  build Betaflight's simulator from the package index and fly it (docs/firmware.md)"
	@echo "make test-browser  the page of a replay in Chromium"
	@echo "make check      ruff and mypy"
	@echo "make format     let ruff rewrite what it can"
	@echo "make bench      every benchmark, into benchmarks/results/all.json and docs/performance.md"
	@echo "make bench-check  whether one has become slower against its peer of the same run"
	@echo "make docs       build the site into site/, with every link followed"
	@echo "make test-docs  run the code of README.md and docs/"
	@echo "make examples   run the examples anew and keep what they print; their notebooks, too"
	@echo "make release-check  build the packages, install them elsewhere, and use them there"
	@echo "make clean      remove environments, caches and outputs"

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml | $(BIN)/python
	$(PIP) install --quiet --editable .
	@touch $@

$(VENV)/.installed-dev: pyproject.toml | $(BIN)/python
	$(PIP) install --quiet --editable '.[dev]'
	@touch $@ $(VENV)/.installed

$(VENV)/.installed-docs: pyproject.toml | $(BIN)/python
	$(PIP) install --quiet --editable '.[docs,cluster]'
	@touch $@ $(VENV)/.installed

$(VENV)/.installed-release: pyproject.toml | $(BIN)/python
	$(PIP) install --quiet 'build>=1.2' 'twine>=6.1'
	@touch $@

demo: $(VENV)/.installed
	$(BIN)/jaxplan intercept --require-success --overwrite --out $(OUT)
	$(BIN)/jaxplan view $(OUT) --html $(OUT)/replay.html
	@echo "Open it in a browser: $(OUT)/replay.html    The picture: $(OUT)/episode.png    The numbers: $(OUT)/metrics.json"

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m "not slow and not gpu" $(PYTEST_ARGS)

test-jax: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m "not slow and not gpu" $(PYTEST_ARGS) $(JAX_TESTS)

test-slow: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m "slow and not gpu and not firmware" $(PYTEST_ARGS)

# Needs Chromium; skipped visibly without.
test-browser: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m slow tests/unit/test_viz_page.py

# One process; what is built stays in the user's cache.
test-firmware: $(VENV)/.installed-dev
	JAXPLAN_CACHE_DIR=$${JAXPLAN_CACHE_DIR-$${XDG_CACHE_HOME:-$$HOME/.cache}/jaxplan} \
	    $(BIN)/python -m pytest -m firmware tests/integration/test_firmware.py

check: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/.installed-dev
	$(BIN)/jaxplan bench all --json benchmarks/results/all.json --page docs/performance.md

bench-check: $(VENV)/.installed-dev
	$(BIN)/jaxplan bench all --against benchmarks/results/all.json

docs: $(VENV)/.installed-docs
	$(BIN)/python -m tools.site

test-docs: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n 2 tests/integration/test_docs.py

examples: $(VENV)/.installed-docs
	$(BIN)/python -m tools.record_examples
	$(BIN)/python -m tools.notebooks

# RELEASE_PYTHONS: the interpreters to install for, one after the other.
release-check: $(VENV)/.installed-release
	$(BIN)/python -m tools.release $(RELEASE_PYTHONS)

clean:
	rm -rf .venv .venv-* build dist out site .pytest_cache .ruff_cache .mypy_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
