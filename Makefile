# Everything is installed into .venv, pinned by requirements.lock; nothing needs root.

SHELL := /bin/bash
.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help setup demo test unit slow arm64 lint format audit sbom bench docs api wheels release lock clean

# The newest suitable Python that really runs (a pyenv shim may exist and fail).
PYTHON ?= $(shell for python in python3.13 python3.12 python3.11 python3; do \
	"$$python" -c 'import sys; raise SystemExit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' \
	2>/dev/null && { echo "$$python"; break; }; done)
ARGS ?=

VENV := .venv
BIN := $(VENV)/bin
UV := $(BIN)/uv
STAMPS := $(VENV)/.stamps
MEMBERS := common $(patsubst %/pyproject.toml,%,$(wildcard services/*/pyproject.toml))
MEMBER_FILES := $(addsuffix /pyproject.toml,$(MEMBERS))
KERNEL_FILES := $(shell grep -rlE --include='*.py' '^from trolley.jit import' common services)
# Programs that say in their first lines how they are run, without arguments that they need.
BENCHES = $(shell grep -rhoE '^    (TROLLEY_DATA=\S+ )?python -m bench[a-z_.]+( \[|$$)' --include='*.py' bench | grep -oE 'bench[a-z_.]+' | sort -u)

export UV_PYTHON_DOWNLOADS := never
# Matrices are small here: more threads only take the cores from other tests.
export OPENBLAS_NUM_THREADS ?= 1
# Containers like to forbid compiled modules to be kept: each program would compile them again.
export PYTHONDONTWRITEBYTECODE :=

help: ## Show this list.
	@echo 'Usage: make TARGET [ARGS="..."]   (Python for .venv: make setup PYTHON=python3.12)'
	@sed -nE 's/^([a-z0-9]+):[^#]*## (.*)/  \1\t\2/p' Makefile | expand -t 12

setup: $(STAMPS)/kernels ## Install everything into .venv and compile the kernels (once).

demo: setup ## A simulated robot in the viewer; ARGS="--tour --seed 7" goes to `trolley demo`.
	@$(BIN)/trolley demo $(ARGS)

test: setup ## Lint, type check, all tests; ARGS="tests/unit/geometry" or "-k goal": only those tests.
ifeq ($(ARGS),)
	@$(BIN)/python tests/parts.py "not slow"
else
	@$(BIN)/python -m pytest $(ARGS)
endif

# Each worker collects all tests, which takes it ten seconds and more: one for each core.
unit: setup ## The quick tests, while you work: no whole drives, no other programs, no browser, no lint.
	@$(BIN)/python -m pytest -m "not slow and not programs and not drives" \
		--numprocesses "$$(nproc)" --dist worksteal tests/unit tests/rules $(ARGS)

slow: setup ## The tests that take longer: whole drives, more seeds, most of the browser's.
	@$(BIN)/python tests/parts.py slow

arm64: setup ## Try the last commit on 64-bit ARM, emulated; as root, takes an hour or two.
	@$(BIN)/python -m bench.arm64 $(ARGS)

lint: setup ## ruff, its formatter and pyrefly, changing nothing.
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/pyrefly check

format: setup ## Let ruff mend and format the code.
	@$(BIN)/ruff check --fix .
	@$(BIN)/ruff format .

# In an environment of its own: what it needs itself is no business of Trolley's.
AUDIT := $(VENV)/audit
audit: $(STAMPS)/venv ## Ask a public database for known vulnerabilities of requirements.lock.
	@test -x $(AUDIT)/bin/pip-audit || { \
		"$(PYTHON)" -m venv $(AUDIT) && \
		$(AUDIT)/bin/python -m pip install --quiet --disable-pip-version-check 'pip-audit>=2.7,<3'; } || { \
		echo "pip-audit cannot be installed here: is this machine on the Internet?"; exit 1; }
	@$(AUDIT)/bin/pip-audit --requirement requirements.lock --require-hashes --disable-pip \
		--vulnerability-service osv --progress-spinner off 2> $(AUDIT)/problems; code=$$?; \
	if grep -qE '^[a-zA-Z._]*(Error|Timeout):' $(AUDIT)/problems; then \
		echo "The database of vulnerabilities does not answer; nothing was checked:"; \
		tail -n 1 $(AUDIT)/problems | cut -c 1-300; exit 2; \
	fi; cat $(AUDIT)/problems >&2; exit $$code

# In the same environment as the check, for the same reason.
sbom: setup ## Write a software bill of materials (CycloneDX) to out/sbom.cdx.json.
	@test -x $(AUDIT)/bin/cyclonedx-py || { \
		"$(PYTHON)" -m venv $(AUDIT) && \
		$(AUDIT)/bin/python -m pip install --quiet --disable-pip-version-check \
			'cyclonedx-bom[json-validation]>=7,<8'; } || { \
		echo "cyclonedx-bom cannot be installed here: is this machine on the Internet?"; exit 1; }
	@$(AUDIT)/bin/python deploy/bill_of_materials.py $(BIN)/python out/sbom.cdx.json

bench: setup ## Run every program in bench/.
	@failed=(); for bench in $(BENCHES); do \
		echo "== $$bench"; $(BIN)/python -m "$$bench" $(ARGS) || failed+=("$$bench"); \
	done; \
	test $${#failed[@]} -eq 0 || { echo "failed: $${failed[*]}"; exit 1; }

docs: setup ## Write the generated pages of docs/ anew.
	@$(BIN)/python docs/make_wire.py

# What programs import; the rest of the package is for those who read the code.
API := client async_client connection laser_scan picture messages topics requests codes geometry gridmap.grid runtime.service
api: setup ## Write the pages of the Python API, made from docstrings, to out/api.
	@$(BIN)/pdoc --docformat google --no-show-source --output-directory out/api $(addprefix trolley.,$(API))
	@echo "Open out/api/trolley/client.html"

wheels: setup ## Build a wheel of each member into out/wheels.
	@rm -rf out/wheels && mkdir -p out/wheels
	@for member in $(MEMBERS); do \
		(cd "$$member" && "$(CURDIR)/$(BIN)/python" -m hatchling build -t wheel -d "$(CURDIR)/out/wheels") || exit 1; \
	done

release: setup ## Check, build, sign and tag a release: VERSION=0.2.0, and ARGS="--key FILE".
	@$(BIN)/python deploy/release.py $(VERSION) $(ARGS)

# Keeps the versions that requirements.lock names already; ARGS=--upgrade takes the newest.
# No line of it says where packages come from: that is the business of the machine's own settings.
lock: $(STAMPS)/venv ## Write requirements.lock anew from the pyproject files.
	@$(UV) pip compile --quiet --universal --python-version 3.11 --generate-hashes \
		--no-header --no-annotate --no-emit-index-url --no-emit-find-links \
		$(patsubst %,--no-emit-package %,trolley-robot $(patsubst services/%,trolley-robot-%,$(filter services/%,$(MEMBERS)))) \
		--group dev pyproject.toml --output-file requirements.lock $(ARGS) > /dev/null

clean: ## Remove .venv, caches and what test runs left.
	@rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis out uv.lock
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(STAMPS)/venv:
	@test -n "$(PYTHON)" || { \
		echo "Trolley needs Python 3.11, 3.12 or 3.13; none was found on the PATH."; \
		echo "If it lies elsewhere: make PYTHON=/path/to/python3.12 ..."; exit 1; }
	@"$(PYTHON)" -c 'import sys; raise SystemExit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' || { \
		echo "Trolley needs Python 3.11, 3.12 or 3.13; $(PYTHON) is $$("$(PYTHON)" --version 2>&1)."; exit 1; }
	@"$(PYTHON)" -c 'import struct, sys; \
		raise SystemExit(sys.platform != "linux" or struct.calcsize("P") != 8)' || { \
		echo "Trolley needs 64-bit Linux (numba is not made for 32-bit ARM)."; exit 1; }
	@"$(PYTHON)" -c 'import ensurepip, venv' 2>/dev/null || { \
		echo "$(PYTHON) cannot make virtual environments: its venv module is not installed."; \
		echo "Debian, Ubuntu, Raspberry Pi OS: sudo apt install python3-venv"; exit 1; }
	@echo "Making $(VENV) with $$("$(PYTHON)" --version) ..."
	@"$(PYTHON)" -m venv --clear $(VENV)
	@awk '/^[^ ]/ { wanted = /^uv==/ } wanted' requirements.lock > $(VENV)/uv.txt
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r $(VENV)/uv.txt
	@mkdir -p $(STAMPS) && touch $@

# Empty where the time of the first start counts for less: Python compiles what it imports.
COMPILE_BYTECODE ?= --compile-bytecode
# uv does not read pip's settings: where only those know the way to the packages, pip does the work.
$(STAMPS)/packages: $(STAMPS)/venv requirements.lock
	@echo "Installing the packages of requirements.lock ..."
	@$(UV) pip sync --quiet --python $(BIN)/python --require-hashes $(COMPILE_BYTECODE) requirements.lock || { \
		echo "uv could not; trying pip ..."; \
		$(BIN)/python -m pip install --disable-pip-version-check --require-hashes -r requirements.lock; }
	@touch $@

# Members were called trolley and trolley-base, ... before; nobody should find both.
FORMER := trolley $(patsubst services/%/pyproject.toml,trolley-%,$(wildcard services/*/pyproject.toml))

$(STAMPS)/members: $(STAMPS)/packages $(MEMBER_FILES)
	@$(UV) pip uninstall --quiet --python $(BIN)/python $(FORMER) 2> /dev/null
	@$(UV) pip install --quiet --python $(BIN)/python --offline --no-deps --no-build-isolation \
		$(addprefix -e ./,$(MEMBERS))
	@touch $@

$(STAMPS)/kernels: $(STAMPS)/members $(KERNEL_FILES)
	@echo "Compiling the kernels (numba keeps them; one to four minutes the first time) ..."
	@$(BIN)/python -m trolley.warmup
	@touch $@
