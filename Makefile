# Everything starts here: `make demo` and `make test` install what they need into
# .venv from a fresh clone; only Python 3.11 or newer and make must be there.
PYTHON ?= python3
VENV ?= .venv
BENCH_VENV ?= .venv-bench
OLDEST_VENV ?= .venv-oldest
BARE_VENV ?= .venv-bare
NEWEST_VENV ?= .venv-newest
DIST_VENV ?= .venv-dist
LEROBOT_VENV ?= .venv-lerobot
DOCS_VENV ?= .venv-docs
CLIENTS_VENV ?= .venv-clients
LOOK_VENV ?= .venv-look
POLICY_VENV ?= .venv-policy
# The oldest Python that pyproject.toml promises, and the newest that is there.
OLDEST_PYTHON ?= python3.11
NEWEST_PYTHON ?= $(firstword $(foreach minor,14 13 12,$(shell python3.$(minor) -c "import sys; print(sys.executable)" 2> /dev/null)) python3)
BIN := $(VENV)/bin
# One thread per process: tests and benchmarks run side by side.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1
# Neighbouring tests in one process, so that what a file learns is learnt once; one more
# than two cores have, since browsers and disks let a process wait.
IN_PARALLEL := -n 3 --dist worksteal
# Checks accessibility in the tests of the page; fetched, never shipped.
AXE_CORE := 4.14.1
# Compiled tests are kept, whatever the shell says: half of the time of finding them.
unexport PYTHONDONTWRITEBYTECODE

PIP_INSTALL := -m pip install --quiet --disable-pip-version-check

.PHONY: demo test test-all test-oldest test-newest test-bare test-everywhere check check-lerobot check-look check-clients check-page format fuzz mutants bench policy docs linkcheck dist clean

demo: $(VENV)/.demo-installed
	@echo "To go on afterwards, type once in this shell, so that it finds palpate: . $(BIN)/activate"
	@$(BIN)/palpate demo $(if $(PALPATE_DATA),--real)

test: check
	$(ONE_THREAD) $(BIN)/python -m pytest $(IN_PARALLEL) -m "not slow"

test-all: check
	$(ONE_THREAD) $(BIN)/python -m pytest $(IN_PARALLEL) --cov --cov-report=term
	$(MAKE) check-lerobot check-look

# The oldest versions that pyproject.toml promises; old packages beside new ones warn
# about each other.
test-oldest: $(OLDEST_VENV)/.installed
	$(ONE_THREAD) $(OLDEST_VENV)/bin/python -m pytest $(IN_PARALLEL) -m "not slow" \
		-W ignore::DeprecationWarning -W ignore::PendingDeprecationWarning

# The newest Python of this machine: types and tests.
test-newest: $(NEWEST_VENV)/.installed
	$(NEWEST_VENV)/bin/mypy
	$(ONE_THREAD) $(NEWEST_VENV)/bin/python -m pytest $(IN_PARALLEL) -m "not slow"

# All of these before a release; the file says with what and when it last passed.
test-everywhere: test test-oldest test-newest test-bare
	@echo "$$(date -u +%F) $$(git rev-parse --short HEAD): $$($(BIN)/python -V), \
	$$($(OLDEST_VENV)/bin/python -V) with the oldest packages, \
	$$($(NEWEST_VENV)/bin/python -V), $$($(BARE_VENV)/bin/python -V) without extras" \
		| tr -s ' \t' ' ' > .ci/tested-everywhere.txt
	@cat .ci/tested-everywhere.txt

# No extra at all: what needs one is skipped by its name, and everything else works.
test-bare: $(BARE_VENV)/.installed
	PALPATE_BARE=1 $(ONE_THREAD) $(BARE_VENV)/bin/python -m pytest $(IN_PARALLEL) \
		-m "not slow" --doctest-ignore-import-errors

# Inputs changed by chance, for so long; goes on where the last run stopped.
SECONDS ?= 60
fuzz: $(VENV)/.test-installed
	$(ONE_THREAD) $(BIN)/python tests/fuzz/fuzz.py --seconds $(SECONDS)

# One fault at a time in the core: what share of them do the tests find?
N ?= 24
mutants: $(VENV)/.test-installed
	$(ONE_THREAD) $(BIN)/python benchmarks/mutants.py -n $(N)

# What a checker of accessibility finds on the live page; needs npm and Chromium.
check-page: $(VENV)/.test-installed $(VENV)/axe/package/axe.min.js
	PALPATE_AXE=$(VENV)/axe/package/axe.min.js $(ONE_THREAD) $(BIN)/python -m pytest \
		-n 0 tests/web/test_web_axe.py

$(VENV)/axe/package/axe.min.js: Makefile
	mkdir -p $(VENV)/axe
	cd $(VENV)/axe && npm pack --silent axe-core@$(AXE_CORE)
	tar -xzf $(VENV)/axe/axe-core-$(AXE_CORE).tgz -C $(VENV)/axe -m package/axe.min.js

# Does lerobot's own package read what is exported? It asks for an older torch than the
# one this project tests with, so it is installed without its dependencies, then these.
LEROBOT := lerobot==0.4.4
LEROBOT_NEEDS := torch==2.13.0 torchvision==0.28.0 "datasets>=4,<5" "av>=15,<16" \
	"huggingface-hub<0.36" "accelerate<2" "deepdiff<9" "draccus==0.10.0" \
	"einops<0.9" "gymnasium>=1.1.1" "imageio[ffmpeg]" "jsonlines>=4" \
	"opencv-python-headless<4.13" "packaging<26" "pandas>=2.2" "rerun-sdk<0.27" \
	"termcolor<4" pyserial pytest
# Agents that learn in the environment of exploration, and the gym of its task.
AGENTS := stable-baselines3==2.9.2 sb3-contrib==2.9.2 ap_gym==0.7.1
check-lerobot: $(LEROBOT_VENV)/.installed
	HF_HUB_OFFLINE=1 $(ONE_THREAD) PYTHONPATH=src:plugs/lerobot \
		$(LEROBOT_VENV)/bin/python -m pytest -q -p no:cacheprovider plugs/lerobot tests/test_torch.py \
		tests/test_blocks.py -k "not blocks or encoder"

# Do the readers of Rerun and of MCAP read what is written for them?
check-look: $(LOOK_VENV)/.installed
	$(ONE_THREAD) $(LOOK_VENV)/bin/python -m pytest -q -p no:cacheprovider plugs/look

# A robot in another process on DDS, zenoh and Fast DDS, the last where Debian's
# libfastrtps-dev and a compiler are there: frames lost, times, restarts. Minutes.
PRESSES ?= 60
check-clients: $(CLIENTS_VENV)/.installed
	-$(CXX) -std=c++17 benchmarks/fastdds_wire.cpp $(FASTDDS_FLAGS) -lfastrtps -lfastcdr \
		-o $(CLIENTS_VENV)/fastdds_wire 2> $(CLIENTS_VENV)/fastdds.txt || \
		echo "Fast DDS is not tried: see $(CLIENTS_VENV)/fastdds.txt"
	PATH="$(CURDIR)/$(CLIENTS_VENV)/bin:$$PATH" $(ONE_THREAD) \
		$(CLIENTS_VENV)/bin/python -m pytest -q -p no:cacheprovider \
		tests/sensors/test_ros_wires.py tests/web/test_ros_beliefs.py plugs/ros
	$(ONE_THREAD) $(CLIENTS_VENV)/bin/python benchmarks/clients.py --presses $(PRESSES) \
		$$(test -x $(CLIENTS_VENV)/fastdds_wire && echo --fastdds $(CLIENTS_VENV)/fastdds_wire)

check: $(VENV)/.test-installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/.test-installed
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(BENCH_VENV)/.installed
	$(ONE_THREAD) $(BENCH_VENV)/bin/python benchmarks/run.py

# PPO of stable-baselines3 learns where to touch, beside random and chosen places; a
# quarter of an hour of one core, `POLICY="--seeds 1 --rounds 1"` a part of it.
POLICY ?= --out benchmarks/policy.json
policy: $(POLICY_VENV)/.installed
	$(ONE_THREAD) $(POLICY_VENV)/bin/python benchmarks/policy.py $(POLICY)

# The site, without network: every example runs, warnings are errors.
SPHINX := nice $(DOCS_VENV)/bin/python -m sphinx -W --keep-going -j 1
docs: $(DOCS_VENV)/.installed
	$(ONE_THREAD) $(SPHINX) -b html docs docs/_build/html
	@echo "Open docs/_build/html/index.html"

# Asks every address outside that a page names; needs the network.
linkcheck: $(DOCS_VENV)/.installed
	$(ONE_THREAD) $(SPHINX) -D plot_gallery=0 -b linkcheck docs docs/_build/linkcheck

# Wheel and source archive, checked: their page, and the wheel in an empty environment.
dist: $(VENV)/.dev-installed
	rm -rf build dist $(DIST_VENV)
	$(BIN)/python -m build
	$(BIN)/twine check --strict dist/*
	$(PYTHON) -m venv $(DIST_VENV)
	$(DIST_VENV)/bin/python $(PIP_INSTALL) dist/*.whl
	$(ONE_THREAD) $(DIST_VENV)/bin/python -I .ci/check_wheel.py dist/*.whl

clean:
	rm -rf $(VENV) $(BENCH_VENV) $(OLDEST_VENV) $(NEWEST_VENV) $(BARE_VENV) $(DIST_VENV) $(LEROBOT_VENV) $(LOOK_VENV) $(CLIENTS_VENV) $(DOCS_VENV) $(POLICY_VENV)
	rm -rf .coverage .coverage.* .pytest_cache .mypy_cache .ruff_cache build dist
	rm -rf docs/_build docs/gallery docs/reference/generated

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.demo-installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "Installing palpate into $(VENV) (once, about a minute)..."
	@$(BIN)/python $(PIP_INSTALL) -c constraints.txt -e ".[plot,sim,web]"
	@touch $@

$(VENV)/.test-installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "Installing palpate and its test tools into $(VENV) (once, about two minutes)..."
	@$(BIN)/python $(PIP_INSTALL) -c constraints.txt -e ".[test]"
	@touch $@

$(VENV)/.dev-installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	@$(BIN)/python $(PIP_INSTALL) -c constraints.txt -e ".[dev]"
	@touch $@

$(OLDEST_VENV)/.installed: pyproject.toml .ci/lower_bounds.py
	$(OLDEST_PYTHON) -m venv --clear $(OLDEST_VENV)
	$(OLDEST_VENV)/bin/python .ci/lower_bounds.py > $(OLDEST_VENV)/requirements.txt
	$(OLDEST_VENV)/bin/python $(PIP_INSTALL) --only-binary :all: -r $(OLDEST_VENV)/requirements.txt
	$(OLDEST_VENV)/bin/python $(PIP_INSTALL) --no-deps -e .
	@touch $@

$(NEWEST_VENV)/.installed: pyproject.toml constraints.txt
	$(NEWEST_PYTHON) -m venv --clear $(NEWEST_VENV)
	$(NEWEST_VENV)/bin/python $(PIP_INSTALL) -c constraints.txt -e ".[test]"
	@touch $@

$(BARE_VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv --clear $(BARE_VENV)
	$(BARE_VENV)/bin/python $(PIP_INSTALL) -c constraints.txt -e . pytest pytest-xdist hypothesis httpx
	@touch $@

$(DOCS_VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(DOCS_VENV)
	$(DOCS_VENV)/bin/python $(PIP_INSTALL) -c constraints.txt -e ".[docs]"
	@touch $@

$(POLICY_VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(POLICY_VENV)
	$(POLICY_VENV)/bin/python $(PIP_INSTALL) -c constraints.txt -e ".[sim]" torch==2.13.0 stable-baselines3==2.9.2
	@touch $@

$(LEROBOT_VENV)/.installed: pyproject.toml
	$(PYTHON) -m venv --clear $(LEROBOT_VENV)
	$(LEROBOT_VENV)/bin/python $(PIP_INSTALL) $(LEROBOT_NEEDS) $(AGENTS)
	$(LEROBOT_VENV)/bin/python $(PIP_INSTALL) --no-deps $(LEROBOT) "diffusers<0.36"
	$(LEROBOT_VENV)/bin/python $(PIP_INSTALL) -e ".[parquet,sim,onnx]" -e plugs/lerobot onnxscript
	@touch $@

$(CLIENTS_VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv --clear $(CLIENTS_VENV)
	$(CLIENTS_VENV)/bin/python $(PIP_INSTALL) -c constraints.txt -e ".[zenoh,web]" pytest httpx colcon-common-extensions
	@touch $@

$(LOOK_VENV)/.installed: pyproject.toml constraints.txt plugs/look/pyproject.toml
	$(PYTHON) -m venv --clear $(LOOK_VENV)
	$(LOOK_VENV)/bin/python $(PIP_INSTALL) -c constraints.txt -e . -e "plugs/look[rerun,live]" pytest pyarrow mcap-ros2-support websockets
	@touch $@

# MKLpy (GPL-3) is a yardstick, never a dependency: it has an environment of its own,
# and its row says why where it cannot be installed.
$(BENCH_VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(BENCH_VENV)
	$(BENCH_VENV)/bin/python $(PIP_INSTALL) -c constraints.txt -e ".[test]"
	-$(BENCH_VENV)/bin/python $(PIP_INSTALL) -c constraints.txt torch==2.13.0 MKLpy==0.6
	@touch $@
