# Two commands do everything: `make demo` and `make test`.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready

.PHONY: demo test check guides docs install lock clean

demo: install
	$(BIN)/armsight demo -o demo

test: install
	$(BIN)/pytest -n 2 --dist worksteal -m "not alone"
	$(BIN)/pytest -m alone

check: install
	$(BIN)/ruff format --check src tests benchmarks tools examples
	$(BIN)/ruff check src tests benchmarks tools examples
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python tools/structure.py

guides: install
	$(BIN)/python tools/follow_guides.py

install: $(READY)

$(READY): pyproject.toml requirements.lock tools/make_environment.py
	$(PYTHON) tools/make_environment.py .venv
	$(BIN)/python -m armsight.app.compilation
	@touch $@

docs: install
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "Open site/index.html"

lock:
	$(BIN)/python -m uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url --extra dev \
		--custom-compile-command "make lock" pyproject.toml -o requirements.lock

clean:
	rm -rf .venv demo dist build site .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
