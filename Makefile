# Every path here is relative, so the checkout may lie in a folder whose name holds spaces.

PYTHON := .venv/bin/python
PYTEST := $(PYTHON) -m pytest -n 2 --dist loadscope --no-loadscope-reorder
OUT := runs/falling_particle
BED_OUT := runs/bubbling_bed_mini_demo
DEMO := kncal compare falling_particle --engine liggghts --out $(OUT)
# Examples of each fuzz test
EXAMPLES := 100000
BED_DEMO := kncal compare bubbling_bed_mini --set run.until_time=0.1 --out $(BED_OUT)

# Tests start kncal in many processes: each would compile it anew.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help demo demo-bed studies validation adapter check test test-long lint clean setup setup-dev

help:
	@echo 'make demo   set up everything, compare linear and Hertz contact: a falling particle, then the first tenth of a'
	@echo '            second of a small bubbling bed; writes a report of each'
	@echo 'make check  set up everything with the development tools, run the tests that need no solver (a minute)'
	@echo 'make test   set up likewise, run all tests but the long ones, with the real solvers (six minutes on two cores)'
	@echo 'make test-long  set up likewise, run what is left: 1e5 damaged files of each kind, long beds, power cuts (hours)'
	@echo 'make studies  set up likewise, make the numbers and figures in docs/studies anew (about an hour)'
	@echo 'make validation  set up likewise, compare with closed forms and published numbers anew (docs/validation.md)'
	@echo 'make lint   set up likewise, check style, formatting and types'
	@echo 'make clean  remove .venv, the runs of the demo, builds and caches'

# What is in runs/studies already is not run again.
studies: setup adapter
	$(PYTHON) docs/studies/make.py

# The quick rows; `python docs/make_validation.py --all` makes the long ones, too.
validation: setup adapter
	$(PYTHON) docs/make_validation.py

setup:
	@bash .ci/setup.sh run

setup-dev:
	@bash .ci/setup.sh dev

# The adapter only makes coupled beds quicker: without a compiler or OpenFOAM's source package all goes on.
adapter: setup
	@.venv/bin/kncal adapter status || .venv/bin/kncal adapter build || \
	  echo 'make: no adapter on this machine (the reason is above): beds restart the gas solver for every coupling, slower'

demo: setup adapter
	.venv/bin/$(DEMO)
	@test -f $(OUT)/report/index.html && echo "The report: $$PWD/$(OUT)/report/index.html"
	@$(MAKE) --no-print-directory demo-bed

# A tenth of a second is too short to decide, and says so with exit code 1. From 2 on something has failed.
demo-bed:
	@if command -v DPMFoam >/dev/null; then \
	  echo '.venv/bin/$(BED_DEMO)'; \
	  .venv/bin/$(BED_DEMO); code=$$?; \
	  if [ $$code -eq 1 ]; then \
	    echo 'make: compared, not within the tolerances (exit code 1): a demo of 0.1 s is too short to decide.'; \
	    echo '      The whole case, some minutes: .venv/bin/kncal compare bubbling_bed_mini'; \
	  elif [ $$code -ne 0 ]; then exit $$code; fi; \
	  test -f $(BED_OUT)/report/index.html && echo "The report: $$PWD/$(BED_OUT)/report/index.html"; \
	else \
	  echo 'make: no DPMFoam on this machine (apt-get install openfoam): the bubbling bed is left out'; \
	fi

# See tests/README.md.
check: setup-dev
	$(PYTEST) -m 'not solver and not slow and not long'

test: setup-dev adapter
	$(PYTEST) -m 'not long'

test-long: setup-dev adapter
	KNCAL_FUZZ=$(EXAMPLES) $(PYTEST) -m long --timeout 0

lint: setup-dev
	$(PYTHON) -m ruff check
	$(PYTHON) -m ruff format --check
	$(PYTHON) -m mypy

clean:
	rm -rf .venv $(OUT) $(BED_OUT) dist build .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
	find kncal tests -name __pycache__ -prune -exec rm -rf {} +
