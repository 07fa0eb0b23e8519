# Every target but `help` and `clean` makes the virtual environment first, if it is not there yet.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
TOOLS := $(VENV)/.tools
# Byte code is compiled when a module is first imported: most installed modules never are.
INSTALL := $(BIN)/python -m pip --disable-pip-version-check install --quiet --no-compile
WORKERS ?= 2

.PHONY: help setup demo test test-all check bench build clean

help: ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

setup: $(STAMP) $(TOOLS) ## make .venv and install everything; a no-op the second time

# torch comes first and alone: asked for together with other packages, pip may choose a build
# that brings gigabytes of CUDA libraries.
$(STAMP): pyproject.toml constraints.txt
	@echo "installing into $(VENV), one to two minutes"
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) torch==2.13.0
	$(INSTALL) --constraint constraints.txt --editable '.[all]'
	@touch $(STAMP)

$(TOOLS): $(STAMP)
	$(INSTALL) --constraint constraints.txt --editable '.[all,dev]'
	@touch $(TOOLS)
	@echo "source $(BIN)/activate puts bidexdata on the path"

demo: $(STAMP) ## the whole pipeline on built-in objects with the built-in hand, into demo/
	$(BIN)/bidexdata demo --out demo

# A test process is one core's work: threads of native libraries would only wait in loops.
test test-all: export OMP_NUM_THREADS ?= 1
# Every test process imports hundreds of modules: it finds their byte code, also where the shell says
# that none be written, and beside the checkout's own files there is none.
test test-all: export PYTHONDONTWRITEBYTECODE :=
test test-all: export PYTHONPYCACHEPREFIX ?= $(CURDIR)/$(VENV)/.bytecode

test: $(TOOLS) ## the tests; under 10 minutes on 2 cores
	$(BIN)/python -m pytest -m "not slow" -n $(WORKERS) --dist loadfile tests

test-all: $(TOOLS) ## the tests and the slow full-scale checks
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile tests

check: $(TOOLS) ## ruff, its formatter, pyright: zero findings
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

bench: $(STAMP) ## speed of every stage, with the quality beside it; JSON in benchmarks/results/
	$(BIN)/python -m benchmarks

build: $(TOOLS) ## source distribution and wheel, into dist/
	$(BIN)/python -m build

clean: ## remove what the targets made
	rm -rf $(VENV) demo dist build benchmarks/results
