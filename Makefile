# Two commands do everything: `make demo` and `make test`.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
RUNS := .venv/.runs
# where it is set, each process compiles all Python that it imports anew: a command takes twice as long to start
unexport PYTHONDONTWRITEBYTECODE

VERSIONS := 3.11 3.12 3.13
# one more than two cores: a quarter of the time, tests wait for robots, cameras and browsers
WORKERS ?= 3

.PHONY: demo test test-alone test-others check types style guides docs install lock packages test-all $(VERSIONS:%=test-%) clean

demo: $(RUNS)
	$(BIN)/armsight demo -o demo

# tests that follow a robot in real time wait for three quarters of it: all others fill that time, and give way to them
test-alone: HOW := -m alone
test-others: HOW := -n $(WORKERS) --dist worksteal -m "not alone"
test-others: GIVES_WAY := $(shell chrt --idle 0 true 2>/dev/null && echo chrt --idle 0 || echo nice -n 19)
LAST := .pytest_cache

# what failed beside others is run once more by itself: it fails, or the machine was too busy for it, as told
test: install
	@rm -rf $(LAST)
	@$(MAKE) --no-print-directory --jobs=2 test-alone test-others
	@for part in alone others; do test ! -e $(LAST)/$$part/failed || \
	  $(BIN)/pytest -o cache_dir=$(LAST)/$$part --last-failed --last-failed-no-failures none || exit 1; done

# 1: tests failed; all else means that the run itself did. What an assertion's parts were, the repetition tells: to
# rewrite them all takes each process as long as to read the tests
test-alone test-others:
	@$(GIVES_WAY) $(BIN)/pytest --assert=plain -o cache_dir=$(LAST)/$(@:test-%=%) $(HOW) || \
	  { test $$? = 1 && touch $(LAST)/$(@:test-%=%)/failed; }

# the same tests under every Python that armsight is for: each of them has to be on the machine
test-all: $(VERSIONS:%=test-%)

$(VERSIONS:%=test-%): test-%: install
	$$($(BIN)/python -m uv python find $*) tools/make_environment.py .venv-$* requirements.lock
	.venv-$*/bin/python -m armsight.ops.compilation
	.venv-$*/bin/pytest -n $(WORKERS) --dist worksteal -m "not alone"
	.venv-$*/bin/pytest -m alone

check: types style docs

types: install
	$(BIN)/mypy

style: install
	$(BIN)/ruff format --check src sim plant lab tests benchmarks tools examples
	$(BIN)/ruff check src sim plant lab tests benchmarks tools examples
	$(BIN)/lint-imports
	$(BIN)/python tools/structure.py
	$(BIN)/python tools/ratchet.py

guides: install
	$(BIN)/python tools/follow_guides.py

install: $(READY)

$(READY): pyproject.toml sim/pyproject.toml plant/pyproject.toml lab/pyproject.toml requirements.lock tools/make_environment.py
	$(PYTHON) tools/make_environment.py .venv requirements.lock
	$(BIN)/python -m armsight.ops.compilation
	@touch $@ $(RUNS)

# what it takes to run it, without what the tests and the documentation need
$(RUNS): pyproject.toml sim/pyproject.toml plant/pyproject.toml lab/pyproject.toml requirements-run.lock tools/make_environment.py
	$(PYTHON) tools/make_environment.py .venv requirements-run.lock
	$(BIN)/python -m armsight.ops.compilation demo
	@touch $@

# wheels and sources of all distributions, in dist/
packages: install
	rm -rf dist
	$(BIN)/python -m uv build --quiet --no-build-isolation --out-dir dist .
	$(BIN)/python -m uv build --quiet --no-build-isolation --out-dir dist sim
	$(BIN)/python -m uv build --quiet --no-build-isolation --out-dir dist plant
	$(BIN)/python -m uv build --quiet --no-build-isolation --out-dir dist lab
	$(BIN)/python tools/licences.py --out dist/licences.md

docs: install
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "Open site/index.html"

LOCKED = $(BIN)/python -m uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url \
	--custom-compile-command "make lock" pyproject.toml --extra install

lock:
	$(LOCKED) --extra dev -o requirements.lock
	$(LOCKED) --constraint requirements.lock -o requirements-run.lock
	echo 'armsight-lab ; python_version < "3"' > .venv/.ours  # built from here, and in no index: left out of the lock
	$(LOCKED) --extra batch --override .venv/.ours --constraint requirements.lock -o requirements-worker.lock

clean:
	rm -rf .venv .venv-3.* demo dist sim/dist plant/dist lab/dist build site .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
