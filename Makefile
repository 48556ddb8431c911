# Two commands need nothing but Python 3.11+, pip and make: `make bench` and `make test`.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready

.PHONY: help setup bench test test-slow lint format perf reliability scale clean

help: ## List the commands
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

setup: $(READY) ## Make the environment, .venv; the other targets do it too

bench: $(READY) ## Run the main job: the paper's method and its control on the gallery
	$(BIN)/gvr run bench

test: $(READY) ## Run the tests, but for the slow ones
	$(BIN)/python -m pytest -m "not slow"

test-slow: $(READY) ## Run the slow tests
	$(BIN)/python -m pytest -m slow

lint: $(READY) ## Check style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(READY) ## Put style right
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

perf: $(READY) ## Measure speed, and write docs/performance.md (about 15 minutes)
	$(BIN)/python benchmarks/perf.py

reliability: $(READY) ## Make faults on purpose, and write docs/reliability.md (about an hour)
	$(BIN)/python benchmarks/reliability.py --into docs/reliability.md
	$(BIN)/python benchmarks/fuzz.py --target all --into docs/reliability.md
	$(BIN)/python benchmarks/big_scene.py --into docs/reliability.md

scale: $(READY) ## Measure runners and a shared store, and write docs/scale.md and docs/sharing.md
	$(BIN)/python benchmarks/scale_out.py --into docs/scale.md
	$(BIN)/python benchmarks/remote_store.py --into docs/sharing.md

clean: ## Remove the environment; results, data and cache under .gvr stay
	rm -rf .venv

# Made anew when the dependencies change; pip's cache makes a second time cheap.
$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "GVR-Bench needs Python 3.11 or newer: make PYTHON=python3.11")'
	@echo "Installing into .venv (5 GB; about 3 minutes where pip has to download)"
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]' -c constraints.txt
	@touch $@
