PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
WORKERS ?= 2

.PHONY: demo test fuzz kills long-run mutants oldest rehearsal lint types docs clean

demo: $(STAMP)
	$(BIN)/objgraph map --dataset sample --out out/demo

# a file's tests stay in one process, and the long files come first (tests/conftest.py)
test: $(STAMP) lint types docs
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder

# FUZZ: malformed inputs of each test; the last line counts them
FUZZ ?= 1000
fuzz: $(STAMP)
	FUZZ=$(FUZZ) OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n $(WORKERS) tests/fuzz

# KILLS: of each command; full disks are tried as well
KILLS ?= 50
kills: $(STAMP)
	KILLS=$(KILLS) OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n $(WORKERS) tests/reliability/test_kills.py tests/reliability/test_disk.py

# UPDATES: of an incremental map, and a tenth as many maps in one process
UPDATES ?= 10000
long-run: $(STAMP)
	UPDATES=$(UPDATES) OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q tests/reliability/test_long.py

# factors with a mistake made on purpose, and whether tests/factors notice; MUTANTS: names, as factors.score*
MUTANTS ?=
mutants: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check "mutmut>=3.8"
	OMP_NUM_THREADS=1 $(BIN)/mutmut run --max-children $(WORKERS) $(MUTANTS)

# the tests with the oldest versions that pyproject.toml admits
oldest:
	$(PYTHON) -m venv out/oldest
	out/oldest/bin/python -m pip install --quiet -c constraints-min.txt -e ".[dev]"
	OMP_NUM_THREADS=1 out/oldest/bin/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder

# a release as its user gets it: the wheel, built from the sdist, in an empty environment, run from elsewhere
rehearsal:
	rm -rf out/rehearsal && $(PYTHON) -m venv out/rehearsal && mkdir out/rehearsal/elsewhere
	out/rehearsal/bin/python -m pip install --quiet build
	out/rehearsal/bin/python -m build --outdir out/rehearsal/dist .
	out/rehearsal/bin/python -m pip install --quiet -c constraints.txt out/rehearsal/dist/*.whl
	cd out/rehearsal/elsewhere && ../bin/objgraph map --dataset sample --out demo

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP)
	$(BIN)/pyright

docs: $(STAMP)
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs out/site

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	touch $@

clean:
	rm -rf $(VENV) out
