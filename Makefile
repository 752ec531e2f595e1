# Every target sets up .venv first (tools/bootstrap.sh); the second time that costs nothing.

export PYTHON
DEMO := out/jacksboro
WORKERS ?= 2
# What protects an invariant is always tested; other slow tests, viewers and second platforms are
# left to `make thorough`.
MARKED := -m "not slow or invariant"
# Property tests draw a quarter of their examples, the same each time; `make thorough` draws all.
EXAMPLES := quick

BENCHMARKS := adapters agreement annotation cold cutouts datasets estimate exposure foliage growth imaging \
  incremental optics preview prune throughput
#: Scripts of lab/ that write measured pages and their pictures; tests/docs/test_measured.py reads it.
MEASURED := $(addprefix pages/,numerics motion densities rocks errors extremes leaving_out converge sky haze \
    clouds relief viewers photographs lights) \
  $(addprefix robustness/,extremes cfgs soak faults fuzz) \
  $(addprefix experiments/,head_to_head ego_motion)
#: Of pictures alone, which show what stages still hold.
PICTURES := $(addprefix pages/,figures assets gallery)

.DEFAULT_GOAL := help
.PHONY: help setup pythons demo test thorough lint types unit audit browser format bench docs measured site lock gpu wheel clean distclean

help:  ## List the targets.
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 20

setup:  ## Make .venv from requirements.lock and requirements-nodeps.lock.
	@tools/bootstrap.sh

pythons: setup  ## Try the other Pythons found here: install scenec in .venv-3.x; same bytes?
	@tools/pythons.sh mitsuba pyrender demo
	@.venv/bin/python -m pytest -n 0 -rs tests/compiler/test_compile.py -k other_pythons

demo:  ## Compile and render configs/jacksboro.json, end with a contact sheet. Installs no more than that.
	@tools/bootstrap.sh mitsuba demo
	@echo "== Compiling configs/jacksboro.json and rendering it with Mitsuba, 16 samples a pixel"
	@.venv/bin/scenec run configs/jacksboro.json --seed 1 -o $(DEMO) --backend mitsuba --spp 16
	@echo "== Laying out the contact sheet"
	@.venv/bin/scenec sheet $(DEMO) -o $(DEMO)/contact_sheet.png

test: lint types unit  ## Linter, formatter, type checker and the tests.

thorough: MARKED :=
thorough: EXAMPLES := thorough
thorough: browser lint types unit  ## As test, and the slow tests too.

lint: setup  ## Linter (with the layering) and formatter.
	@echo "== Linting"
	@.venv/bin/ruff check .
	@echo "== Checking the format"
	@.venv/bin/ruff format --check .

types: setup  ## Type checker.
	@echo "== Checking types"
	@.venv/bin/mypy

# A test that takes its process along ends the run: pytest-xdist would wait for its other tests.
unit: setup  ## The tests alone (WORKERS=2 processes; PYTEST_ARGS for more).
	@.venv/bin/python tools/warm_kernels.py
	@echo "== Testing, $(WORKERS) processes"
	@.venv/bin/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder \
	  --max-worker-restart 0 --hypothesis-profile $(EXAMPLES) $(MARKED) $(PYTEST_ARGS)

# Python's development mode; what is never closed, deprecated or undefined ends a test. Processes of
# pytest-xdist do not inherit the options of the interpreter.
audit: setup  ## The fast tests once more, each warning an error (ruff's security rules: make lint).
	@echo "== Testing, every warning an error"
	@.venv/bin/python -X dev -W error -m pytest --dist loadfile \
	  --tx "$(WORKERS)*popen//python=.venv/bin/python -X dev -W error" \
	  --hypothesis-profile quick -m "not slow" $(PYTEST_ARGS)

browser: setup  ## A browser for the tests of `scenec view`, where there is none.
	@tools/browser.sh

format: setup  ## Format the code.
	@.venv/bin/ruff check --fix .
	@.venv/bin/ruff format .

bench: setup  ## Run every benchmark; each prints a table.
	@set -e; for name in $(BENCHMARKS); do \
	  echo "== $$name"; .venv/bin/python lab/benchmarks/$$name.py; \
	done

docs: setup  ## Generate the cfg's schema and docs/cfg.md from its declarations.
	@.venv/bin/python -m tools.declarations

measured: setup  ## Measure all pages and pictures anew (an hour and a half of CPU time), or MEASURED="pages/errors …" PICTURES=.
	@set -e; for name in $(MEASURED) $(PICTURES); do \
	  echo "== Measuring: $$name"; .venv/bin/python lab/$$name.py; \
	done

site: setup  ## Build the website of docs/ into build/site (Sphinx; a warning is an error).
	@echo "== Building the site"
	@.venv/bin/sphinx-build --quiet --fail-on-warning --keep-going --jobs auto docs build/site
	@echo "== Open build/site/index.html"

#: Packages whose own lists of what they need are overridden in pyproject.toml: locked apart, since
#: pip would miss in requirements.lock what the override takes away.
OVERRIDDEN := cityscapesscripts|lavavu-osmesa|nuscenes-devkit

# uv resolves in a folder of its own: uv.lock names hosts and must not come near the repository.
lock: setup  ## Resolve pyproject.toml again into requirements.lock and requirements-nodeps.lock.
	@echo "== Resolving requirements.lock"
	@set -e; folder=$$(mktemp -d); trap 'rm -rf "$$folder"' EXIT; \
	cp pyproject.toml README.md LICENSE "$$folder"; mkdir -p "$$folder/src/scenec"; \
	root=$$(pwd); cd "$$folder"; \
	"$$root/.venv/bin/uv" lock --quiet --python "$$root/.venv/bin/python"; \
	"$$root/.venv/bin/uv" export --quiet --frozen --all-extras \
	  --no-extra torch --no-extra networks --no-extra rerun \
	  --all-groups --no-emit-project --no-header --format requirements-txt \
	  --output-file all.lock; \
	awk -v overridden='^($(OVERRIDDEN))==' '/^[a-z]/ { file = $$0 ~ overridden ? \
	  "requirements-nodeps.lock" : "requirements.lock" } { print >file }' all.lock; \
	cp requirements.lock requirements-nodeps.lock "$$root"

#: Devices that make gpu tries: backend:device.
GPUS = mitsuba:cuda cycles:cuda cycles:optix pyrender:cuda

gpu: setup  ## On a machine with a GPU: doctor, the conformance suite there, tables of frames.
	@.venv/bin/scenec doctor || true
	@set -e; for of in $(GPUS); do echo "== Conformance of $${of%:*} on $${of#*:}"; \
	  SCENEC_TEST_DEVICE=$${of#*:} .venv/bin/pytest -q tests/backends/$${of%:*}/test_$${of%:*}.py; done
	@set -e; mkdir -p out; for name in gpu throughput; do echo "== $$name"; \
	  .venv/bin/python lab/benchmarks/$$name.py -o out/$$name.md; done

wheel: setup  ## Build a wheel into dist/ for each Python of `make pythons`, with kernels for this kind of CPU.
	@tools/wheel.sh

clean:  ## Remove caches and build results; keep .venv and out/.
	@echo "== Removing caches and build results"
	@rm -rf build dist schemas/compiled src/scenec.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	@find . -path ./.venv -prune -o -path ./.git -prune -o -name __pycache__ -type d -print0 \
	  | xargs -0 rm -rf

distclean: clean  ## As clean, and remove .venv and out/ too.
	@rm -rf .venv out
