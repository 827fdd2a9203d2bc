.DEFAULT_GOAL := help
.PHONY: help setup demo serve dist fmt check lint types layers test proof fuzz docs drawings screenshots bench clean

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
LENS := out/infrared_lens

help: ## list the targets
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /	/' | expand -t 13

INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

# Stamps: an environment is made once, and again when what it is made from changes.
$(VENV)/.installed: pyproject.toml | $(BIN)/python
	$(INSTALL) --editable '.[web]'
	touch $@

$(VENV)/.testing: $(VENV)/.installed
	$(INSTALL) --editable '.[test]'
	touch $@

# CI installs the versions of requirements.lock; LOCK= takes the newest instead.
LOCK ?= --constraint requirements.lock
$(VENV)/.developing: pyproject.toml requirements.lock | $(BIN)/python
	$(INSTALL) $(LOCK) --editable '.[web,test,docs,dev]'
	touch $(VENV)/.installed $(VENV)/.testing $@

setup: $(VENV)/.developing ## make the environment with everything a developer needs

demo: $(VENV)/.installed ## install, run the main example (the freeform infrared lens) and say where its report is
	$(BIN)/turnwright run examples/infrared_lens.toml --out $(LENS) --force
	@echo
	@echo "The report: $(CURDIR)/$(LENS)/report.html"

serve: $(VENV)/.installed ## open the workbench, a page to plan, see, run and correct a part
	$(BIN)/turnwright serve

# A process of tests for each core: threads of linear algebra beside them only wait for each other, at full speed.
test: $(VENV)/.testing ## install what tests need and run them, doctests included
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest tests src README.md -q -n auto --dist worksteal

# The suite keeps a tenth of these cases or less; tests marked proof repeat others with another case, or take long.
proof: $(VENV)/.testing ## carry out the acceptance proofs, thousands of cases: figures, and failure where one is missed
	@for one in tests/proof/proof_*.py; do echo "== $$one"; $(BIN)/python -m tests.proof.$$(basename $$one .py) || failed=1; done; \
	TURNWRIGHT_LAWS=all OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest tests -q -n auto -m 'proof or hypothesis' || failed=1; \
	test -z "$$failed"

fuzz: $(VENV)/.testing ## give 20,000 mutated inputs to every door; make proof gives 12
	$(BIN)/python tests/proof/fuzz.py --inputs 20000

fmt: setup ## format, and mend what can be mended
	$(BIN)/ruff format src tests benchmarks docs tools
	$(BIN)/ruff check --fix src tests benchmarks docs tools

lint: setup
	$(BIN)/ruff format --check src tests benchmarks docs tools
	$(BIN)/ruff check src tests benchmarks docs tools
	$(BIN)/python tools/check_words.py

types: setup
	$(BIN)/mypy

layers: setup
	$(BIN)/lint-imports --no-cache

docs: setup ## build the documentation; every page is run
	$(BIN)/sphinx-build -q -W --keep-going -j auto -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

drawings: $(VENV)/.installed ## write the drawings of the documentation, docs/images/drawings
	$(BIN)/python -m docs.drawings

screenshots: $(VENV)/.testing ## take the pictures of the workbench that docs and README show; needs Chromium
	TURNWRIGHT_SCREENSHOTS=docs/images/workbench $(BIN)/python -m pytest tests/web/test_web_page.py -q -k picture

check: setup lint types layers test docs ## everything CI runs

# A wheel must work without the checkout: it is installed and used in an environment of its own.
dist: setup ## build wheel and sdist, install the wheel in a clean environment and use it
	rm -rf dist build/clean
	$(BIN)/python -m build --outdir dist .
	$(PYTHON) -m venv build/clean
	build/clean/bin/python -m pip install --quiet --disable-pip-version-check $(LOCK) dist/*.whl
	cd build/clean && bin/turnwright new "even asphere" --out job.toml && bin/turnwright check job.toml

bench: setup ## ratios measured in one run
	$(BIN)/python benchmarks/run.py

clean:
	rm -rf $(VENV) out docs/_build build dist
