# `make demo` and `make test` install what they need into .venv first.
PYTHON ?= python3
VENV ?= .venv
PIP = $(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

.PHONY: demo test bench study lint clean

$(VENV)/.demo: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(PIP) --editable .
	touch $@

$(VENV)/.test: $(VENV)/.demo
	$(PIP) --editable '.[test]'
	touch $@

$(VENV)/.bench: $(VENV)/.test
	$(PIP) --editable '.[bench]'
	touch $@

$(VENV)/.lint: $(VENV)/.demo
	$(PIP) --editable '.[lint]'
	touch $@

demo: $(VENV)/.demo
	$(VENV)/bin/armflex demo

test: $(VENV)/.test
	OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python -m pytest -n auto --dist worksteal

bench: $(VENV)/.bench
	$(VENV)/bin/python tests/benchmarks/run.py -o bench.md

study: $(VENV)/.test
	$(VENV)/bin/python tests/study.py -o study.csv

lint: $(VENV)/.lint
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .

clean:
	rm -rf $(VENV) armflex_demo
