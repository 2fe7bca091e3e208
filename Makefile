# make demo: install into .venv and run everything on a simulated street.   make test: run the tests.   make check: all the checks, about an hour.
PYTHON ?= python3
BIN := .venv/bin
ALL_CORES := -n auto --dist worksteal
PIP = $(BIN)/python -m pip install --quiet --quiet --disable-pip-version-check
# pip writes no bytecode here, to install in half the time. If Python may not write it either, every process compiles its imports again.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: law demo test slow smoke browser lint types boundscheck coverage fuzz mutants docs check clean
.DELETE_ON_ERROR:

demo: .venv/.user
	$(BIN)/dynaviz demo

test: .venv/.dev
	$(BIN)/pytest $(ALL_CORES) -m "not slow"

slow: .venv/.dev  # the tests that take long and rarely fail, and further cases of those that make test runs
	DYNAVIZ_BROWSER=1 $(BIN)/pytest -q $(ALL_CORES) -m slow

SMOKE := $(addprefix tests/,io kernels/test_threads.py sources/test_refine.py spatial test_platforms.py)
smoke: BIN := build/smoke/bin
smoke:  # run a part of the tests with another Python: make smoke PYTHON=python3.13
	@$(PYTHON) -m venv --clear build/smoke
	@$(PIP) --no-compile --editable '.[explore,las,ros]' hypothesis pytest pytest-xdist
	@$(BIN)/python -m dynaviz.precompile
	$(BIN)/pytest -q $(ALL_CORES) $(SMOKE)

browser: .venv/.dev  # test the page of the explorer in Chromium, without a GPU
	DYNAVIZ_BROWSER=1 $(BIN)/pytest -q -m "not slow" tests/explorer/test_page.py

lint: .venv/.dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check --quiet

types: .venv/.dev
	$(BIN)/mypy

CHECKED := NUMBA_BOUNDSCHECK=1 NUMBA_OPT=1 NUMBA_CACHE_DIR=.venv/boundscheck
boundscheck: .venv/.dev  # test the kernels with bounds checking
	$(CHECKED) $(BIN)/python -m dynaviz.precompile --all
	$(CHECKED) $(BIN)/pytest -q $(ALL_CORES) -m boundscheck

# Coverage cannot see the lines of compiled kernels, so their tests on small worlds run again as plain Python. Plain Python warns
# when integers overflow, and cannot convert NaN to an integer. tests/README.md lists what this leaves out.
coverage: .venv/.dev
	$(BIN)/pytest -q $(ALL_CORES) --cov --cov-report=
	NUMBA_DISABLE_JIT=1 $(BIN)/pytest -q $(ALL_CORES) --cov --cov-append -W ignore::RuntimeWarning -m plain

fuzz: .venv/.dev  # read damaged files for 45 s; FUZZ_SEED=1000 selects others
	cd tests && $(abspath $(BIN))/python -m helpers.fuzzing -j 2 -n 5000 --seconds 45

law: .venv/.dev  # write 3,000 situations and read them: each map is right, or what is wrong has a name
	cd tests && $(abspath $(BIN))/python -m helpers.situations -j 2 -n 3000 -s 1000

mutants: .venv/.dev  # change the evaluation in one place at a time; list the changes that its tests miss
	$(BIN)/python tests/mutants.py

docs: .venv/.dev  # write the site to build/site; warnings are errors
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

check: lint types test slow browser fuzz boundscheck docs

.venv/.venv:
	@$(PYTHON) -c 'import sys; sys.exit("dynaviz needs Python 3.11 or newer: make PYTHON=python3.11 ..." if sys.version_info < (3, 11) else 0)'
	@$(PYTHON) -m venv .venv
	@touch $@

.venv/.user: .venv/.venv pyproject.toml
	@echo "installing dynaviz into .venv, about 1.5 GB ..."
	@$(PIP) --no-compile --editable '.[explore,report]'
	@$(BIN)/python -m dynaviz.precompile
	@touch $@

.venv/.dev: .venv/.venv pyproject.toml
	@echo "installing dynaviz and its test dependencies into .venv, about 2 GB ..."
	@$(PIP) --no-compile --editable '.[dev]'
	@$(BIN)/python -c 'import sys; sys.tracebacklimit = 0; from dynaviz.spatial import open3d; open3d.load("make test")'
	@$(BIN)/python -m dynaviz.precompile --all
	@touch .venv/.user $@

clean:
	rm -rf .venv build dist
