# What you need: Linux, python3 (3.11 or newer, with venv) and make. Every target sets up its own environment first,
# in .venv, once; it is made again when pyproject.toml or constraints.txt change.
#
#   make demo PYTHON=python3.12           another interpreter
#   make demo PIP_FLAGS='--index-url …'   another package index (a CPU-only torch saves gigabytes)

PYTHON ?= python3
VENV ?= .venv
OUT ?= out
WORKERS ?= 2
PIP_FLAGS ?=

BIN := $(VENV)/bin
READY := $(VENV)/.ready
# A file's tests run in one process, so that what they share is made once. Files go in the order of tests/conftest.py:
# those of one folder far from each other, the short ones last. Every process has one thread, as there is one process a
# core. Compiled sources are kept: the tests start many processes, and each would compile all of cyclekit again.
PYTEST := PYTHONDONTWRITEBYTECODE= POLARS_MAX_THREADS=1 OMP_NUM_THREADS=1 \
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder
BENCHMARKS := $(sort $(wildcard benchmarks/*.py))

.DEFAULT_GOAL := help
.PHONY: help demo test test-all contract contract-quick bench docs lint clean

help: ## say what can be made
	@echo "cyclekit:"
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 24

demo: $(READY) ## the whole way on a simulated cell; everything it makes lies in out/
	@echo "== demo: simulated logs -> dataset -> model -> cycle times, replay and report in $(OUT)/"
	@$(BIN)/cyclekit demo --out $(OUT)/

test: $(READY) ## the tests that guard what cyclekit does; for every day
	@echo "== test: all but the slow tests, fewer examples where any are drawn, $(WORKERS) processes"
	@$(PYTEST) -m "not slow" --hypothesis-profile everyday

test-all: $(READY) ## every test, also the slow ones: kills, browsers, clusters, clean environments
	@echo "== test-all: the whole suite, $(WORKERS) processes"
	@$(PYTEST)

CONTRACT := POLARS_MAX_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.contract --compare benchmarks/contract/contract.json

contract: $(READY) ## what is answered for simulated cells, beside the truth and the answers of before (two hours)
	@echo "== contract: $(OUT)/contract.json beside benchmarks/contract/contract.json"
	@$(CONTRACT) --out $(OUT)/contract.json

contract-quick: $(READY) ## a few rows of it (minutes)
	@echo "== contract-quick: $(OUT)/contract-quick.json beside benchmarks/contract/contract.json"
	@rm -f $(OUT)/contract-quick.json
	@$(CONTRACT) --quick --orders 2 --out $(OUT)/contract-quick.json

bench: $(READY) ## the measurements in benchmarks/, one after the other (minutes)
	@echo "== bench: $(words $(BENCHMARKS)) measurements"
	@set -e; for file in $(BENCHMARKS); do echo "-- $$file"; $(BIN)/python $$file; done

docs: $(READY) ## the documentation as a site in out/site; a link that leads nowhere is an error
	@echo "== docs: $(OUT)/site/docs/index.html"
	@$(BIN)/sphinx-build -q -W --keep-going -c docs . $(OUT)/site

lint: $(READY) ## style, format and types
	@echo "== lint: ruff check, ruff format --check, mypy --strict"
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

clean: ## remove the environment and everything that was made
	@echo "== clean: removing $(VENV), $(OUT), caches and builds"
	@rm -rf $(VENV) $(OUT) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	@find cyclekit adapters sim_fixtures tests benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +

$(READY): pyproject.toml constraints.txt
	@echo "== environment: $(VENV), with all extras and the tools for tests (once; minutes, depending on the network)"
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "error: $(PYTHON) is older than 3.11; give another: make PYTHON=…")'
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null \
		|| { echo "error: $(PYTHON) has no venv; on Debian and Ubuntu: apt install python3-venv" >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check $(PIP_FLAGS) -c constraints.txt -e '.[all,dev]'
	@touch $(READY)
