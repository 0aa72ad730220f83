# Everything starts here: `make demo` and `make test` install what they need into
# .venv from a fresh clone; only Python 3.11 or newer and make must be there.
PYTHON ?= python3
VENV ?= .venv
BENCH_VENV ?= .venv-bench
BIN := $(VENV)/bin
# One thread per process: tests and benchmarks run side by side.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

.PHONY: demo test test-all check format bench clean

demo: $(VENV)/.demo-installed
	@$(BIN)/palpate demo $(if $(PALPATE_DATA),--real)

test: check
	$(ONE_THREAD) $(BIN)/python -m pytest -n 2 -m "not slow"

test-all: check
	$(ONE_THREAD) $(BIN)/python -m pytest -n 2

check: $(VENV)/.test-installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/.test-installed
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(BENCH_VENV)/.installed
	$(ONE_THREAD) $(BENCH_VENV)/bin/python benchmarks/run.py

clean:
	rm -rf $(VENV) $(BENCH_VENV) .pytest_cache .mypy_cache .ruff_cache build dist

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.demo-installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "Installing palpate into $(VENV) (once, about a minute)..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[plot,sim]"
	@touch $@

$(VENV)/.test-installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "Installing palpate and its test tools into $(VENV) (once, about two minutes)..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[test]"
	@touch $@

# MKLpy (GPL-3) is a yardstick, never a dependency: it has an environment of its own,
# and its row says why where it cannot be installed.
$(BENCH_VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(BENCH_VENV)
	$(BENCH_VENV)/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[test]"
	-$(BENCH_VENV)/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt torch==2.13.0 MKLpy==0.6
	@touch $@
