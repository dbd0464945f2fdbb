# Everything a person needs to type. `make help` lists it.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
include .env
ORACLE_DAGSTER_HOME := $(CURDIR)/.dagster_home
DAGSTER_HOME := $(ORACLE_DAGSTER_HOME)
export
export PATH := $(CURDIR)/$(BIN):$(PATH)

# The small default campaign of `make run`: the first three runs of each of the six modes.
FIRST := lidar_passthrough|run000
LAST := delayed_fakeobject|run002

# Pins without the address of any registry.
PIN := pip-compile --quiet --strip-extras --no-header --no-annotate \
	--no-emit-index-url --no-emit-trusted-host --no-emit-find-links

# uv installs in a fifth of pip's time. It reads no pip.conf, so it is told the index that is there.
UV_VERSION := 0.13.9
INDEX = $$($(BIN)/pip config get global.index-url 2>/dev/null)
INSTALL = UV_DEFAULT_INDEX=$${UV_DEFAULT_INDEX:-$(INDEX)} \
	$(BIN)/uv pip install --quiet --python $(BIN)/python --constraint constraints.txt --editable
export PYTHONDONTWRITEBYTECODE :=

.PHONY: help setup setup-dev demo demo-card found-attacks run campaign ui test test-everything test-quick test-browser lint types size architecture docs \
	pictures wheel install-check bench ros1 soak constraints requirements image sbom clean
.DEFAULT_GOAL := help

help: ## Show this list
	@grep -E '^[a-z0-9-]+:.*## ' Makefile | awk -F':.*## ' '{printf "  make %-15s %s\n", $$1, $$2}'

setup: $(VENV)/.compiled ## Make .venv with what running needs, in pinned versions

setup-dev: $(VENV)/.ready-dev ## Add what tests, types and benchmarks need
	@$(MAKE) --no-print-directory $(VENV)/.compiled

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "This needs Python 3.11 or newer; say which with: make setup PYTHON=python3.12"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet uv==$(UV_VERSION)

$(VENV)/.ready: pyproject.toml constraints.txt | $(BIN)/python
	$(INSTALL) .
	@touch $@

# What changes later is compiled when it is first called.
$(VENV)/.compiled: $(VENV)/.ready
	$(BIN)/python tools/scripts/compile_loops.py
	@touch $@

# With what running needs, so that it is installed at once where there is nothing yet.
$(VENV)/.ready-dev: pyproject.toml constraints.txt | $(BIN)/python
	$(INSTALL) '.[dask,dev,dg,docs,kubernetes,live,logs,mcp,postgres,s3,search,zenoh]'
	@touch $(VENV)/.ready $@

demo: $(VENV)/.ready ## Record a normal and an attacked run, and judge both by the shipped reference card
	python -m tools.scripts.demo

# The card holds the features of 40 runs, each of another block: verdicts at 5 % take 19.
demo-card: setup ## Learn the demo's reference card again, after a change of simulation or features
	oracle-sim record -m lidar_passthrough_odom -n 40 --goals 1 --refresh \
		--out $${ORACLE_HOME:-data}/demo-card
	oracle learn $${ORACLE_HOME:-data}/demo-card --output examples/demo/normal.card
	python -m tools.scripts.short_recording

found-attacks: setup-dev ## Score the attacks that searches found; move those that are caught
	python -m tools.scripts.found_attacks

# Dagster 1.13 warns that `dg launch`, which needs a further package, does the same.
run campaign: export PYTHONWARNINGS = ignore:Function `asset_materialize_command` is superseded
run: setup ## Simulate the small campaign, analyse it, and say where the report is
	dagster asset materialize -m oracle_pipeline.definitions --select '*' \
		--partition-range '$(FIRST)...$(LAST)'
	@echo "Report: $${ORACLE_HOME:-$(CURDIR)/data}/report/index.html"

BLOCKS := 60
SEED := 20260101
campaign: setup ## Simulate BLOCKS=60 of every mode and hard negative, SEED=20260101, and evaluate the oracle
	ORACLE_HOME=$${ORACLE_HOME:-data/campaign} ORACLE_RUNS=$(BLOCKS) \
		dagster asset materialize -m oracle_pipeline.definitions --select '*' \
		--partition-range "lidar_passthrough|run000...benign_slow|$$(printf run%03d $$(($(BLOCKS) - 1)))" \
		--config-json '{"resources": {"campaign": {"config": {"seed": $(SEED)}}}}'

ui: setup ## Open the pipeline in the browser, on 127.0.0.1
	oracle-ui -w workspace.yaml

test: $(VENV)/.ready-dev ## Check style and types, and run every test that needs only Python and PyPI
	@$(MAKE) --no-print-directory --jobs=2 types test-all

# Tests begin once the style is right; types are checked beside them. A process that dies fails the
# run: restarted, it makes xdist 3.8 wait without end (its issue 1378).
.PHONY: test-all
test-all: lint $(VENV)/.compiled
	pytest -n 4 --dist loadfile --no-loadscope-reorder --max-worker-restart 0 $(TESTS)

# In one session, the tests share runs and processes.
test-everything: $(VENV)/.ready-dev ## Run all tests at once, as continuous integration does; needs Chromium
	$(BIN)/python -c 'import playwright' 2>/dev/null || $(INSTALL) '.[browser]'
	@$(MAKE) --no-print-directory --jobs=2 types test-all TESTS='tests/[!_]*/ tests/test_*.py'

test-quick: setup-dev ## Run the tests that take less than a second each: while you work
	pytest -n 2 --dist worksteal -m "not slow"

test-browser: setup-dev ## Look at the report in a headless Chromium, which has to be installed
	$(INSTALL) '.[browser]'
	pytest tests/browser

lint: $(VENV)/.ready-dev ## Check style and the direction of imports; warn about retired words
	ruff check .
	ruff format --check .
	lint-imports --no-logo
	python tools/scripts/check_words.py

types: $(VENV)/.ready-dev ## Check types, strictly
	mypy

docs: export NO_MKDOCS_2_WARNING = 1
docs: $(VENV)/.ready-dev ## Check words, spelling and links of the docs, and build their site into site/
	codespell docs *.md mkdocs.yml
	python tools/scripts/check_words.py
	pytest -q tests/docs/test_names.py tests/docs/test_reference.py
	mkdocs build --quiet --clean
	@echo "Site: $(CURDIR)/site/index.html (search needs a server: mkdocs serve)"

pictures: $(VENV)/.ready-dev ## Draw the pictures of the docs; of a campaign's report with CAMPAIGN=data/campaign
	$(INSTALL) '.[browser]'
	python docs/draw_worlds.py
	python docs/pictures.py $(CAMPAIGN)

# The environment has the dependencies, and the wheel's packages come before those of the checkout.
wheel: export PYTHONPATH = $(CURDIR)/dist/tried
wheel: setup ## Build a wheel into dist/, and try the commands of the README with what is in it
	rm -rf dist/*.whl dist/tried
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir dist .
	$(BIN)/python -m pip install --quiet --no-deps --target dist/tried dist/*.whl
	tools/scripts/try_commands.sh dist/tried/bin

install-check: ## Install into fresh environments of the Python versions that are here, and try them
	tools/scripts/install_check.sh $(or $(VERSIONS),3.11 3.12 3.13 3.14)

constraints: $(VENV)/.ready-dev ## Pin the newest versions that fit pyproject.toml
	$(PIN) --upgrade --all-extras --output-file constraints.txt pyproject.toml

requirements: $(VENV)/.ready-dev ## Write deploy/requirements.txt: what the image holds, with the hash of every file
	$(PIN) --constraint constraints.txt --generate-hashes --allow-unsafe --build-deps-for wheel \
		--extra dask --extra kubernetes --extra postgres --extra s3 --output-file deploy/requirements.txt pyproject.toml

image: requirements ## Build the image of deploy/ from files whose hashes are known
	docker build $(if $(BASE),--build-arg BASE=$(BASE)) -f deploy/Containerfile -t ros2-behaviour-oracle .

sbom: requirements ## Write dist/sbom.cdx.json: what the image is made of, as CycloneDX
	mkdir -p dist
	$(PYTHON) -m venv $(VENV)-sbom
	$(VENV)-sbom/bin/python -m pip install --quiet --constraint constraints.txt cyclonedx-bom
	$(VENV)-sbom/bin/cyclonedx-py requirements --pyproject pyproject.toml --output-reproducible \
		--output-format JSON --output-file dist/sbom.cdx.json deploy/requirements.txt

size: $(BIN)/python ## Count code lines of each package, and words of the docs
	@$(BIN)/python tools/scripts/size.py

architecture: $(VENV)/.ready-dev ## Draw who imports whom, for docs/explanation/architecture.md
	python docs/draw_architecture.py

bench: setup-dev ## Measure speed, size and memory, as ratios of one run
	python -m tools.bench

ros1: setup-dev ## Judge ROS 1 nodes that nobody here wrote; needs Debian's packages, see tools/ros1.py
	python -m tools.ros1

soak: setup-dev ## Kill everything at random moments, fill the disk, flip bits, keep 600 runs within 2 GB; hours
	python -m tools.soak.faults
	python -m tools.soak.aggregates
	python -m tools.soak.full_disk
	python -m tools.soak.flips
	python -m tools.soak.numbers
	python -m tools.soak.budget
	python -m tools.soak.watch
	python -m tools.soak.topics
	python -m tools.soak.watching

clean: ## Remove the environment and all caches; recorded data stay
	rm -rf $(VENV) $(VENV)-sbom .mypy_cache .pytest_cache .ruff_cache .hypothesis
