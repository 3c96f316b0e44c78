# `make demo` and `make test` install what they need into .venv first.
PYTHON ?= python3
VENV ?= .venv
PIP = $(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

.PHONY: demo check test docs fuzz bench study style lint clean

# The engine is compiled while armflex is installed: by cc, or by ziglang's where there is none.
ENGINE = hatch_build.py $(addprefix armflex/mechanics/engine/,engine.c rest.h engine.h build.py)

$(VENV)/.demo: pyproject.toml constraints.txt $(ENGINE)
	$(PYTHON) -m venv $(VENV)
	$(PIP) --editable .
	touch $@

$(VENV)/.test: $(VENV)/.demo
	$(PIP) --editable '.[test]'
	touch $@

$(VENV)/.bench: $(VENV)/.test
	$(PIP) --editable '.[bench]'
	touch $@

$(VENV)/.lint: $(VENV)/.test
	$(PIP) --editable '.[lint]'
	touch $@

$(VENV)/.docs: $(VENV)/.demo
	$(PIP) --editable '.[docs]'
	touch $@

demo: $(VENV)/.demo
	$(VENV)/bin/armflex demo

# The daily round, 75 s on two cores: style, and everything that takes less than half a second of a processor.
# Types are checked by `make lint`, and nothing is spoilt at random.
check: style
	OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python -m pytest tests/unit tests/referee -m 'not slow' -n auto --dist worksteal

test: $(VENV)/.test
	OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python -m pytest -n auto --dist worksteal

# 75 times as many spoilt inputs as `make test` tries, new ones each time, in processes of at most 8 GiB each.
fuzz: $(VENV)/.test
	ulimit -v 8388608; HYPOTHESIS_PROFILE=fuzz OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python -m pytest tests/fuzz -n auto --dist worksteal

# docs/_build/html/index.html; a warning is an error, and nothing is fetched.
docs: $(VENV)/.docs
	OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python -m sphinx --fail-on-warning --keep-going -q docs docs/_build/html

# The pages show what `bench` and `study` write; `study` also traces what was once named wrong.
bench: $(VENV)/.bench
	$(VENV)/bin/python tests/benchmarks/run.py -o docs/results/bench.md

study: $(VENV)/.test
	$(VENV)/bin/python tests/studies/study.py -o study.csv --page docs/results/study.md
	$(VENV)/bin/python tests/studies/named.py

style: $(VENV)/.lint
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .

lint: style
	$(VENV)/bin/basedpyright --threads 2 --pythonpath $(VENV)/bin/python

clean:
	rm -rf $(VENV) armflex_demo docs/_build docs/_made
