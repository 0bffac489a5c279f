# kata is used from this clone: `make install` puts everything into .venv, `make demo` needs nothing before it.
PYTHON ?= python3
VENV := $(CURDIR)/.venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check
RUN := PATH="$(BIN):$$PATH"
CODE := core robot world view motion policy hal deploy sim2sim train benchmarks
# Compiled modules are kept, whatever the machine's setting: the tests start hundreds of processes.
export PYTHONDONTWRITEBYTECODE :=
.DEFAULT_GOAL := help
.PHONY: help install demo test side-by-side test-wires lint bench train

help:  ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

install: $(VENV)/.installed-all  ## .venv with everything needed on this machine

demo: $(VENV)/.installed-view  ## stand up, play taichi, stand again in MuJoCo: demo/taichi.mp4 and its metrics
	@mkdir -p demo
	$(RUN) deploy/run --backend mujoco --policy taichi --fast --video demo/taichi.mp4 --json demo/taichi.json
	@$(BIN)/python -P -m sim2sim.table demo/taichi.json
	@echo "video: demo/taichi.mp4"

# The tests that go side by side fill the cores: further threads of torch would only wait for one. The linters go beside
# them, and say again at the end what is wrong.
# What keeps time has the machine for itself. It lists what it tried again because the machine's host paused.
# Only the files that name the mark are loaded for it: the others take seconds to import.
test: install  ## linters, types, import rules, tests
	@$(MAKE) --no-print-directory --jobs 2 lint side-by-side || { $(MAKE) --no-print-directory lint; exit 1; }
	$(RUN) pytest -rRs -m real_time $$(grep -rlw real_time tests/hal tests/deploy --include='test_*.py')

side-by-side: install
	$(RUN) OMP_NUM_THREADS=1 pytest --numprocesses auto --maxprocesses 5 --dist worksteal -m "not real_time"

test-wires:  ## every conformance trial on every wire: half an hour, on a quiet machine
	$(RUN) pytest -rRs tests/hal/conformance --all-wires

lint: install  ## ruff, mypy, import-linter
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy $(CODE)
	$(BIN)/lint-imports

bench: install  ## timings of the control loop, of training and of retargeting on this machine
	$(RUN) benchmarks/control_loop.py
	$(RUN) benchmarks/train_throughput.py
	$(RUN) benchmarks/retarget.py

train: install  ## train the bundled taichi clip, from the bundled tracker on
	$(RUN) train/run.py motion=taichi

# A stamp is younger than pyproject.toml once its extras are installed, so a second call does nothing.
$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "kata needs Python 3.11 or newer: try make PYTHON=python3.11 $(MAKECMDGOALS)" >&2; exit 2; }
	@$(PYTHON) -m venv $(VENV) || \
	  { rm -rf $(VENV); echo "no virtual environment: on Debian or Ubuntu, apt-get install python3-venv" >&2; exit 2; }

$(VENV)/.installed-view: pyproject.toml | $(VENV)/bin/python
	$(PIP) install -e '.[view]'
	@touch $@

# torch comes first and pinned: resolving it together with the rest may pick another build of it.
$(VENV)/.installed-all: pyproject.toml | $(VENV)/bin/python
	$(PIP) install torch==2.13.0
	$(PIP) install -e '.[train,dds,moteus,motion,view,dev]'
	@touch $@ $(VENV)/.installed-view
