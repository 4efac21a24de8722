# Each target works on a fresh machine: it makes the environment first.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
COUNT  ?= 100000
SEED   ?= 0
JOBS   ?= 2

.PHONY: demo test test-all fuzz options bench lint types clean
.DEFAULT_GOAL := demo

$(BIN)/.installed: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
	touch $@

demo: $(BIN)/.installed   ## map the built-in scene and print its accuracy
	$(BIN)/polarmap demo --out out/demo --force

test: $(BIN)/.installed   ## the test suite but for what is marked slow, in JOBS processes
	$(BIN)/python -m pytest --numprocesses $(JOBS) --dist loadfile -m "not slow"

test-all: $(BIN)/.installed   ## the whole test suite
	$(BIN)/python -m pytest --numprocesses $(JOBS) --dist loadfile

fuzz: $(BIN)/.installed   ## 100000 changed inputs for all readers; COUNT and SEED may be given
	cd tests && $(abspath $(BIN))/python -m fuzz --count $(COUNT) --seed $(SEED)

options: $(BIN)/.installed  ## every option at both ends of its range, on a tiny scene
	$(BIN)/python tests/option_walk.py

bench: $(BIN)/.installed  ## milliseconds per step of mapping and odometry by image size; how live runs keep up
	$(BIN)/python benchmarks/bench_steps.py
	$(BIN)/python benchmarks/bench_live.py

lint: $(BIN)/.installed
	$(BIN)/ruff check .ci src tests benchmarks examples training
	$(BIN)/ruff format --check .ci src tests benchmarks examples training

types: $(BIN)/.installed  ## mypy; no errors but those that are known
	$(BIN)/python .ci/check_types.py

clean:
	rm -rf $(VENV) out build dist
