# Every path here is relative, so the checkout may lie in a folder whose name holds spaces.

PYTHON := .venv/bin/python
OUT := runs/falling_particle
REPORT := $(OUT)/report/index.html
DEMO := kncal compare falling_particle --engine liggghts --out $(OUT)

.DEFAULT_GOAL := help
.PHONY: help demo test lint clean setup setup-dev

help:
	@echo 'make demo   set up everything, compare linear and Hertz contact of a falling particle, write a report'
	@echo 'make test   set up everything with the development tools, run all tests'
	@echo 'make lint   set up likewise, check style, formatting and types'
	@echo 'make clean  remove .venv, the demo run, builds and caches'

setup:
	@bash .ci/setup.sh run

setup-dev:
	@bash .ci/setup.sh dev

demo: setup
	.venv/bin/$(DEMO)
	@test -f $(REPORT) && echo "The report: $$PWD/$(REPORT)"

test: setup-dev
	$(PYTHON) -m pytest -n 2 --dist loadscope

lint: setup-dev
	$(PYTHON) -m ruff check
	$(PYTHON) -m ruff format --check
	$(PYTHON) -m mypy

clean:
	rm -rf .venv $(OUT) dist build .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
	find kncal tests -name __pycache__ -prune -exec rm -rf {} +
