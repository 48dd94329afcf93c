# make train   set up .venv and train PG-RSSNN on the cascaded tanks (about a minute)
# make test    set up .venv and run the tests that take minutes
# make test-slow  those that need more;  make test-all  both, compiled as users compile
# make check   formatting, lint, layers and types
# make install set up .venv alone;  make lock  renew the lock file
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SOURCES := pgrssnn_jax hydra_plugins tests benchmarks train.py discover.py report.py

.PHONY: train test test-slow test-all check install lock
train: install
	$(BIN)/python train.py +experiment=cascaded_tank

test: install
	$(BIN)/python -m pytest

test-slow: install
	$(BIN)/python -m pytest -m slow

test-all: install
	$(BIN)/python -m pytest -m ""

check: install
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/lint-imports
	$(BIN)/pyright

install: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "error: python: expected 3.11 or newer, found $$($(PYTHON) --version 2>&1); set PYTHON=..."; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	touch $@

lock: install
	$(BIN)/python -m pip install --quiet pip-tools
	$(BIN)/pip-compile --quiet --extra test --extra check --strip-extras --no-emit-index-url \
	  --no-emit-find-links --no-emit-trusted-host --output-file requirements.lock pyproject.toml
