# `make demo` and `make test` need python3 (>= 3.10) and nothing else: each makes its own virtual environment.
PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin/python
export MPLBACKEND := Agg
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-all test-rest mutation lint edit station docs pictures urdf bench study reproduce score clean

demo: $(VENV)/base.stamp
	$(RUN) examples/demo.py

# Two or more processes share the tests, so each has one thread for its matrices.
PYTEST := OPENBLAS_NUM_THREADS=1 $(RUN) -m pytest -n auto --maxprocesses 6 --dist worksteal

test: $(VENV)/test.stamp
	$(PYTEST) $(ARGS)

# Everything, with many and random examples; what needs a browser is skipped where there is no Chromium.
test-all: $(VENV)/test-all.stamp
	$(PYTEST) --full $(ARGS)

# What `make test-all` adds to `make test`: the two of them run each test once.
test-rest: $(VENV)/test-all.stamp
	$(PYTEST) --rest $(ARGS)

# Seeded faults in the library: does the quick set catch what the full set catches? Half an hour.
mutation: $(VENV)/test-all.stamp
	$(RUN) tests/mutation.py $(ARGS)

lint: $(VENV)/lint.stamp
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(RUN) .ci/structure.py --check

# The editor in the browser, at an example. Another task: make edit TASK=mine.toml
TASK ?= examples/tasks/keyframes.toml
edit: $(VENV)/editor.stamp
	$(RUN) -m pinposture edit $(TASK)

# A simulated robot on ROS 2, its driver and the page of an operator, without an installation of ROS; Ctrl-C ends it.
STATION := out/station/arm.urdf
station: $(VENV)/ros2,sim,editor,foxglove.stamp
	mkdir -p $(dir $(STATION))
	$(RUN) -m pinposture generate RyRz --modules 20 --feed 1.2 -o $(STATION)
	export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST; \
	$(RUN) -m pinposture robot $(STATION) --scene examples/hole.toml --camera --start $$(printf '0,%.0s' $$(seq 40))0 & \
	robot=$$!; trap 'kill $$robot' EXIT INT TERM; \
	$(RUN) -m pinposture operate $(STATION) --ros --record $(dir $(STATION))run-$$(date +%Y%m%d-%H%M%S).mcap

# The documentation site, into build/site; a test builds it, too, and checks its links.
docs: $(VENV)/docs.stamp
	NO_MKDOCS_2_WARNING=1 $(RUN) -m mkdocs build --strict

# The pictures of the documentation; some minutes. They are kept with the source.
pictures: $(VENV)/test-all.stamp
	$(RUN) docs/pictures.py
	$(RUN) docs/notebook.py
	PICTURES=docs/screenshots $(RUN) -m pytest --full tests/editor/browser

# The generated robot descriptions under urdf/; a test fails when they are stale.
urdf: $(VENV)/base.stamp
	$(RUN) -m benchmarks.cases urdf

# The evidence for what the documentation says. Options follow "--", with a blank between a name and its value:
#     make study STUDY=clutter -- --seeds 5 -o out/clutter
# or stand in ARGS: make study STUDY=clutter ARGS="--seeds=5". `make study` alone lists the studies.
EVIDENCE := bench study reproduce score
ifneq ($(filter $(EVIDENCE),$(firstword $(MAKECMDGOALS))),)
OPTIONS := $(wordlist 2,$(words $(MAKECMDGOALS)),$(MAKECMDGOALS))
MAKEFLAGS += --silent
.DEFAULT: ;
endif

# Our controllers and others on the same cases; makes environments for the others under build/bench.
bench: $(VENV)/base.stamp
	$(RUN) -m benchmarks.peers.bench $(OPTIONS) $(ARGS)

study reproduce score: $(VENV)/base.stamp
	$(RUN) -m benchmarks $@ $(STUDY) $(OPTIONS) $(ARGS)

clean:
	rm -rf $(VENV) out build dist
	rm -f $(addprefix pinposture/kernels/__pycache__/,*.nb[ci] *.lock *.note)

$(VENV)/bin/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "pinposture needs Python 3.10 or newer")'
	$(PYTHON) -m venv $(VENV)

# A stamp for each extra of pyproject.toml; pip compiles no bytecode, Python does for what is imported.
$(VENV)/base.stamp: pyproject.toml | $(VENV)/bin/python
	$(RUN) -m pip install --quiet --no-compile --editable .
	$(RUN) -m pinposture compile
	touch $@

# The source is read, not run: no kernels.
$(VENV)/lint.stamp: pyproject.toml | $(VENV)/bin/python
	$(RUN) -m pip install --quiet --no-compile --editable '.[lint]'
	touch $@

$(VENV)/%.stamp: pyproject.toml | $(VENV)/bin/python
	$(RUN) -m pip install --quiet --no-compile --editable '.[$*]'
	$(RUN) -m pinposture compile
	touch $@
