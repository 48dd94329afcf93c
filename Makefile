# make train   set up .venv with the package and train PG-RSSNN on the cascaded tanks (about a minute)
# make test    set up .venv and run the tests that take minutes
# make test-slow  those that need more;  make test-all  both, compiled as users compile
# make notebooks  execute examples/ again and store what they show
# make check   formatting, lint, layers and types
# make docs    build the documentation into site/;  make docs-serve  show it while you write
# make install set up .venv with all tools;  make lock  renew the lock file;  make audit  its known vulnerabilities
# make coverage  lines of the package that no fast test runs; fails where these are more than 5 %
# make mutants  would the tests notice? 300 small faults in the code, one at a time, after make coverage
# make test-latest  the tests on the newest releases;  make test-oldest  on the lower bounds of pyproject.toml
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
# Python compiles what it imports, unless it may not write: then everything is compiled here, once.
UV := $(BIN)/uv pip install --quiet --python $(BIN)/python $(if $(PYTHONDONTWRITEBYTECODE),--compile-bytecode)
SOURCES := pgrssnn_jax hydra_plugins tests benchmarks docs examples train.py discover.py report.py

.PHONY: train test test-slow test-all test-latest test-oldest notebooks coverage mutants check docs docs-serve audit
.PHONY: install lock
train: $(VENV)/.package
	$(BIN)/python train.py +experiment=cascaded_tank

# Tests share the cores: threads of BLAS would wait for each other.
test test-slow test-all: export OPENBLAS_NUM_THREADS = 1

test: install
	$(BIN)/python -m pytest

# First what mostly compiles, with little optimisation; then the others by file, because tests of a file share programs.
# A failure in the first part does not hide those in the second.
test-slow: install
	$(BIN)/python -m pytest -m compiles; compiles=$$?; \
	$(BIN)/python -m pytest -m "slow and not compiles" --dist loadfile && exit $$compiles

test-all: install
	$(BIN)/python -m pytest -m ""

notebooks: install
	$(BIN)/python examples/execute.py

check: install
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/lint-imports
	$(BIN)/pyright

docs: install
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build

docs-serve: docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs serve

install: $(VENV)/.installed

# uv takes half of pip's time or less. pip installs where uv cannot: behind an index that only pip is told of, for
# instance. Training needs the package alone.
$(VENV)/.package: pyproject.toml requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "error: python: expected 3.11 or newer, found $$($(PYTHON) --version 2>&1); set PYTHON=..."; exit 2; }
	$(PYTHON) -m venv $(VENV)
	@awk '/^uv==/ { on = 1 } on; on && !/\\$$/ { exit }' requirements.lock > $(VENV)/uv.txt
	{ $(PIP) -r $(VENV)/uv.txt && $(UV) --constraint requirements.lock --editable .; } || \
	  { $(PIP) -r requirements.lock && $(PIP) --no-deps --editable .; }
	touch $@

$(VENV)/.installed: $(VENV)/.package
	$(UV) -r requirements.lock || $(PIP) -r requirements.lock
	touch $@

test-latest: RESOLUTION := highest
test-oldest: RESOLUTION := lowest-direct
test-oldest: PYTEST_ARGUMENTS := -W ignore::DeprecationWarning  # of old packages, by what is newer than they are
test-latest test-oldest: test-%:
	$(PYTHON) -m venv --clear $(VENV)-$*
	$(VENV)-$*/bin/python -m pip install --quiet --disable-pip-version-check uv
	$(VENV)-$*/bin/uv pip install --quiet --python $(VENV)-$*/bin/python --resolution $(RESOLUTION) --editable '.[test,notebooks,docs]'
	$(VENV)-$*/bin/python -m pytest $(PYTEST_ARGUMENTS)

coverage: install
	$(PIP) pytest-cov
	$(BIN)/python -m pytest --cov --cov-context=test --cov-report=term --cov-fail-under=95 --junitxml=.coverage_times.xml

mutants: install
	$(PIP) cosmic-ray pytest-cov
	$(BIN)/python tests/mutants.py

audit: install
	$(PIP) pip-audit
	$(BIN)/pip-audit --requirement requirements.lock --require-hashes --disable-pip

lock: install
	$(BIN)/uv pip compile --quiet --python-version 3.11.0 --generate-hashes --no-emit-index-url --no-emit-find-links \
	  --extra test --extra notebooks --extra check --extra docs --extra install --output-file requirements.lock pyproject.toml
