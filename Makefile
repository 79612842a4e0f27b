# One virtual environment, made when missing and brought up to date when pyproject.toml is newer.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready

.PHONY: demo test test-all lint bench docs site clean

demo: $(READY) .venv/kernels
	$(BIN)/python examples/carbon_fibres.py --out out/demo
	$(BIN)/python examples/fluidised_bed.py --out out/demo

test: $(READY) .venv/kernels
	$(BIN)/pytest -m "not slow"

test-all: $(READY) .venv/kernels
	$(BIN)/pytest

# Compiled kernels are cached by the file they stand in, not by those they call: drop stale ones.
.venv/kernels: $(READY) $(wildcard src/grainmesh/*.py src/grainmesh/*/*.py)
	@find src -name '*.nb[ic]' -delete
	@touch $@

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(READY) .venv/kernels
	@set -e; for script in $(sort $(wildcard benchmarks/*.py)); do \
	  echo "== $$script"; $(BIN)/python $$script --quick; done

docs: $(READY) .venv/kernels
	@set -e; for script in $(sort $(filter-out docs/conf.py,$(wildcard docs/*.py))); do \
	  echo "== $$script"; $(BIN)/python $$script; done

# The site; runs no example, loads nothing from the network.
site: $(READY)
	$(BIN)/python -m sphinx -E -a -W --keep-going -q -b html -d out/doctrees docs out/site

clean:
	rm -rf .venv out build .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -prune -exec rm -rf {} +

$(READY): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "grainmesh needs Python 3.11 or newer as $(PYTHON) (Debian 12: apt install python3), or make PYTHON=python3.12" >&2; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv || { rm -rf .venv; \
	  echo "$(PYTHON) cannot make .venv (Debian: apt install python3-venv)" >&2; exit 1; }
	@$(BIN)/python -m pip install --quiet --editable '.[dev]' || { \
	  echo "pip could not install grainmesh into .venv: the reason stands above" >&2; exit 1; }
	@$(BIN)/python -c 'import ngsolve, netgen.occ' || { \
	  echo "ngsolve cannot be loaded, the missing library stands above (Debian: apt install libstdc++6)" >&2; exit 1; }
	@touch $@
