# `make demo` and `make test` are all the set-up there is: each makes the environment it needs.
# `make test-all` adds the slow tests, the formatter, the type checker and the documentation, whose
# tutorials are not run. `make docs` runs them and writes build/docs/index.html. `make test-long`
# does that too, draws new examples for the tests that draw some, and runs tests that take long or are
# many of one kind: before a release, and after changes to a search.
# PYTHON=... chooses an interpreter; otherwise the first that is 3.12 or newer.
PYTHON ?= $(shell for p in python3.13 python3.12 python3.14 python3 python; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
DEMO ?= demo_run

# Installed modules are compiled at once, on all cores: pip would do it on one, and where Python may
# not write them (PYTHONDONTWRITEBYTECODE) every start of the command would take 4 s longer.
compile_modules = @$(BIN)/python -m compileall -qq -j 0 $(VENV)/lib bayes_inertia || true

# The tests of one environment share compiled code: two workers, fast tests and slow ones.
test test-all test-long docs: export JAX_COMPILATION_CACHE_DIR ?= $(CURDIR)/$(VENV)/jax_cache
test test-all test-long docs: export JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS ?= 0.05
# Workers rewrite the assertions of all test files: once, where Python may write what it compiles.
test test-all test-long: export PYTHONDONTWRITEBYTECODE :=
# Compiling is most of what tests do: a tenth of it is unrolling loops. What fast tests compile is
# not worth optimizing; slow tests sample, which optimized code does faster.
NOT_UNROLLED := --xla_backend_extra_options=xla_cpu_disable_loop_unrolling
test: export XLA_FLAGS = $(NOT_UNROLLED) --xla_backend_optimization_level=0
test-all test-long: export XLA_FLAGS = $(NOT_UNROLLED)

.PHONY: demo test test-all test-long lint types docs clean

demo: $(VENV)/ready
	$(BIN)/bayes-inertia demo -o $(DEMO)

test: $(VENV)/ready-test
	$(BIN)/ruff check .
	$(BIN)/python -m pytest -q -n 2 --dist worksteal -m "not slow"

# Types are checked and the documentation is built beside the slow tests: these leave a tenth of two
# cores idle.
test-all: test lint $(VENV)/ready-docs
	$(MAKE) types docs TUTORIALS=off & checked=$$!; \
	$(BIN)/python -m pytest -q -n 2 --dist worksteal -m "slow and not long" tests; tested=$$?; \
	wait $$checked && exit $$tested

test-long: $(VENV)/ready-test docs
	$(BIN)/python -m pytest -q -n 2 --dist worksteal -m "long or hypothesis" \
		--hypothesis-profile=default

lint: $(VENV)/ready-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/ready-test
	$(BIN)/mypy

docs: $(VENV)/ready-docs
	$(BIN)/python -m sphinx -q -n -W --keep-going -j 2 -c docs -d build/docs_pages . build/docs

$(VENV)/ready: pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "no Python 3.12 or newer found: install one, or call make PYTHON=/path/to/python"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --no-compile --quiet --disable-pip-version-check -c constraints.txt -e .
	$(compile_modules)
	@touch $@

$(VENV)/ready-test: $(VENV)/ready
	$(BIN)/python -m pip install --no-compile --quiet --disable-pip-version-check -c constraints.txt -e '.[test]'
	$(compile_modules)
	@touch $@

$(VENV)/ready-docs: $(VENV)/ready
	$(BIN)/python -m pip install --no-compile --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	$(compile_modules)
	@touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info $(DEMO)
