# `make demo` and `make test` install what they need. `make help` lists all commands.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
export UV_PYTHON_DOWNLOADS := never
export UV_NO_PROGRESS := 1

# Otherwise each of the hundreds of services that the tests start would compile its modules again.
unexport PYTHONDONTWRITEBYTECODE

# More jobs than cores, at most 8, because tests wait for half of their time: for robots, people and time limits.
# Tests use free ports, so that they do not collide.
JOBS ?= $(shell cores=$$(getconf _NPROCESSORS_ONLN 2>/dev/null || echo 2); echo $$((cores < 4 ? 5 * cores / 2 : 8)))

# Lint and tests of the TypeScript, with the Node that built the page.
PAGE := $(BIN)/python -m handover_web.build

# The folders of the tests of each package, and of what crosses packages: the cell, its page, the project.
TESTS_accounts := services/accounts/tests
TESTS_alerts := services/alert_router/tests
TESTS_body := services/human_state/tests
TESTS_broker := services/context_broker/tests
TESTS_cases := services/assistive_devices/tests
TESTS_cell := tests/integration/cell tests/load
TESTS_datamodels := datamodels/tests
TESTS_devices := services/device_gateway/tests
TESTS_gloves := services/gesture_controller/tests tests/unit/glove_sdk_bridge tests/integration/glove_sdk_bridge
TESTS_humanoid := services/whole_body_control/tests
TESTS_kit := handover/tests tests/unit/kit tests/integration/kit
TESTS_page := tests/e2e
TESTS_processes := services/task_orchestrator/tests
TESTS_project := tests/unit/deploy tests/unit/docs tests/unit/requirements tests/integration/docs tests/integration/distributions
TESTS_robots := services/trajectory_tool/tests
TESTS_ros := ros_fiware_bridge/tests
TESTS_study := services/study/tests
TESTS_web := webui/tests

# In the order in which they start: what takes longest first.
PARTS := page cell broker processes robots devices ros body kit humanoid gloves web project accounts study datamodels \
	cases alerts

SELECTED ?= not nightly
# Of each property; `make test-broker` and `make nightly` try 25, `make thorough` 300.
EXAMPLES ?= 10

# Each part is one process, so that each file is compiled and collected once. The results are those of its last run.
pytest = $(BIN)/pytest -q -o cache_dir=.pytest_cache/$(1)

.PHONY: help setup demo up test test-failed ros-test crashes kill-test thorough orion-test lowest schemathesis humanoid-memory containers nightly check lint python-check page-check docs reference dist third-party lock bench bench-broker bench-orchestrator bench-gestures bench-handover bench-bridge bench-motion bench-devices bench-control bench-human-state bench-whole-body bench-load bench-cells bench-sign-in bench-screen bench-vr pictures humanoid-figures clean

help:  ## list the commands
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1: \2/' 

setup: $(READY)  ## install everything that demo and test need into .venv, and build the page
	@$(PAGE)

# Without a network, pip and uv write lines that hide the reason; everything else that they report is shown.
INSTALL_LOG := $(VENV)/install.log
UNREACHABLE := retrying|connection|network|resolution|dns error|timed out|error sending request|no matching distribution
define no_packages
if grep -qiE '$(UNREACHABLE)' $(INSTALL_LOG); then \
	echo "the packages of Python cannot be installed: check that this machine reaches the network and its package index (pip config list), then run make again; details are in $(INSTALL_LOG)" >&2; \
else cat $(INSTALL_LOG) >&2; fi; exit 1
endef

# Everything of our distributions, and what develops them; the lock holds for all.
LOCKS := requirements/handover.lock requirements/tools.lock
PROJECTS := pyproject.toml $(wildcard */pyproject.toml services/*/pyproject.toml services/*/*/pyproject.toml)
EVERYTHING := "handover-cell[all,figures,talos]" "handover-glove-sdk-bridge[serial]"

# Installs distributions of ours, with dependency groups, for an editable installation of this folder.
# Compiled here: where PYTHONDONTWRITEBYTECODE is set, every service would compile its libraries at each start.
define install
@command -v $(PYTHON) >/dev/null || { echo "there is no $(PYTHON) on this machine; install Python 3.11 to 3.13, or name another with make PYTHON=…" >&2; exit 1; }
@$(PYTHON) -c 'import sys; ok = (3, 11) <= sys.version_info[:2] <= (3, 13); sys.exit(not ok and f"Handover needs Python 3.11 to 3.13, and $(PYTHON) is {sys.version.split()[0]}; choose another with make PYTHON=python3.12")'
@$(PYTHON) -m venv $(VENV) || { echo "$(PYTHON) cannot make a virtual environment; on Debian and Ubuntu: sudo apt install python3-venv" >&2; exit 1; }
@$(BIN)/python -m pip install -q --disable-pip-version-check --require-hashes -r requirements/tools.lock >$(INSTALL_LOG) 2>&1 || { $(no_packages); }
@$(call install_in,$(VENV),$(1),$(2)) >$(INSTALL_LOG) 2>&1 || { $(no_packages); }
@touch $@
endef

# The same in the virtual environment $(1), with the uv of ours: distributions $(2), dependency groups $(3).
define install_in
	$(BIN)/python -m requirements.subset $(2) $(addprefix --group ,$(3)) >$(1)/requirements.txt \
	&& $(BIN)/uv pip sync --quiet --compile-bytecode --python $(1)/bin/python --require-hashes requirements/tools.lock $(1)/requirements.txt \
	&& $(call install_ours,$(1),$(2))
endef

define install_ours
	$(BIN)/uv pip install --quiet --python $(1)/bin/python --no-deps --no-build-isolation \
		$$($(BIN)/python -m requirements.subset --folders $(2) | sed 's,^,--editable ./,')
endef

$(READY): $(LOCKS) $(PROJECTS)
	$(call install,$(EVERYTHING),dev)

# The demo needs fewer packages. If everything is installed already, it uses that.
# With SIM=physics the robot moves in simulated physics, which needs more packages.
PHYSICS := $(filter physics,$(SIM))
DEMO_STAMP := $(VENV)/.ready-demo$(addprefix -,$(PHYSICS))
DEMO_READY := $(if $(wildcard $(READY)),$(READY),$(DEMO_STAMP))

$(DEMO_STAMP): $(LOCKS) $(PROJECTS)
	$(call install,"handover-cell$(if $(PHYSICS),[physics])")

demo: $(DEMO_READY)  ## a person and a robot work through the bin-picking process (ONCE=1: end after it; SIM=physics)
	@$(PAGE)
	@$(if $(SIM),HANDOVER_ROBOT=$(SIM) )$(BIN)/handover demo $(if $(filter 1 yes true,$(ONCE)),--once) $(ARGS)

up: setup  ## every service, with the simulated robot only
	@$(BIN)/handover up $(ARGS)

test: setup  ## every check and the tests of every part; `make test-broker` and so on runs one part
	@$(MAKE) --no-print-directory --jobs=$(JOBS) --keep-going --output-sync=target \
		page-check $(firstword $(PARTS:%=part-%)) python-check $(wordlist 2,99,$(PARTS:%=part-%))

part-%: setup
	@echo "== tests of $*" && export HANDOVER_TEST_EXAMPLES=$(EXAMPLES) && rm -rf .pytest_cache/$* && $(call pytest,$*) -n 0 -m "$(SELECTED)" $(TESTS_$*) $(ARGS) || [ $$? -eq 5 ]

test-%: setup
	@test -n "$(TESTS_$*)" || { echo "there is no part $*; the parts are: $(sort $(PARTS))" >&2; exit 2; }
	@$(call pytest,$*) -n $(JOBS) -m "$(SELECTED)" $(TESTS_$*) $(ARGS) || [ $$? -eq 5 ]

nightly-%: setup
	@test -n "$(TESTS_$*)" || { echo "there is no part $*; the parts are: $(sort $(PARTS))" >&2; exit 2; }
	@rm -rf .pytest_cache/$@ && $(call pytest,$@) -n $(JOBS) -m nightly $(TESTS_$*) $(ARGS) || [ $$? -eq 5 ]

# Six failed tests are no accident.
test-failed: setup  ## every check, and alone the tests that failed in their last run, of which there may be five
	@$(MAKE) --no-print-directory python-check page-check
	@mkdir -p build
	@$(BIN)/python -m tests.kit.failed_tests >build/failed-tests.txt
	@echo "repeated alone:" && cat build/failed-tests.txt
	@$(BIN)/pytest -n 0 -o cache_dir=.pytest_cache/repeated @build/failed-tests.txt $(ARGS)

# ROS 2 with Fast DDS from wheels, in a separate environment, because it starts more slowly and its types replace
# ours. The wheels are for Python 3.11 on Linux.
ROS_VENV := $(VENV)-ros
ROS_TESTS := ros_fiware_bridge/tests/integration/graph ros_fiware_bridge/tests/integration/test_fast_dds.py \
	ros_fiware_bridge/tests/integration/test_unknown_outcomes.py \
	ros_fiware_bridge/tests/integration/test_humanoid.py ros_fiware_bridge/tests/integration/test_humanoid_link.py

ros-test: setup  ## the ROS bridge against ROS 2 nodes (rclpy, Fast DDS; Python 3.11 on Linux)
	@if $(BIN)/python -c 'import sys; sys.exit(not (sys.platform == "linux" and sys.version_info[:2] == (3, 11)))'; then \
		$(MAKE) --no-print-directory $(ROS_VENV)/.ready && HANDOVER_TEST_ROS=1 $(ROS_VENV)/bin/pytest -n 2 $(ROS_TESTS) $(ARGS); \
	else \
		echo "ros-test: rclpy has wheels for Python 3.11 on Linux only; the ROS bridge was not tested against ROS 2 nodes" >&2; \
		[ -z "$$CI" ]; \
	fi

# Rebuilt for a new lock: the wheels contain a second record of each package, and `uv pip sync` would remove those.
$(ROS_VENV)/.ready: $(LOCKS) $(PROJECTS)
	@rm -rf $(ROS_VENV)
	@$(BIN)/python -m venv $(ROS_VENV)
	@$(call install_in,$(ROS_VENV),$(EVERYTHING) "handover-cell[ros-rclpy]",dev ros-test)
	@touch $@

crashes: setup  ## kill the broker a hundred times while it writes, and check its data
	@HANDOVER_TEST_CRASHES=100 $(call pytest,crashes) -n $(JOBS) services/context_broker/tests/integration/test_crashes*.py $(ARGS)

kill-test: setup  ## kill broker, orchestrator and performer at random moments for ten minutes (ARGS="--seconds 60 --processes 100")
	@$(BIN)/python -m tests.load.kill_test $(ARGS)

thorough: crashes  ## the crashes, the tests of all databases on PostgreSQL, and many more examples
	@HANDOVER_TEST_DATABASE=postgresql HANDOVER_TEST_EXAMPLES=300 $(call pytest,thorough) -n $(JOBS) $(foreach part,broker processes gloves devices study kit,$(TESTS_$(part))) $(ARGS)

# tests/kit/other_broker/needs.toml lists the tests that need what a broker may lack.
ORION_TESTS ?= tests/integration/cell $(foreach part,alerts devices gloves body ros study processes robots web \
	humanoid,$(firstword $(TESTS_$(part)))/integration)

orion-test: setup  ## the tests of cells with another broker, and what it can do (BROKER=URL; without it one that speaks as Orion-LD)
	@HANDOVER_TEST_BROKER=$(or $(BROKER),strict) $(call pytest,orion) -n $(JOBS) $(ORION_TESTS) $(ARGS)

# The lower bounds of pyproject.toml hold if everything works with them. Nothing is locked here: only the lower
# bounds count, and of what they depend on in turn the newest versions, as `pip install` chooses them.
LOWEST_VENV := $(VENV)-lowest
LOWEST_VERSIONS := build/lowest-versions.txt
LOWEST_EXTRAS := figures gif messengers motion parquet physics serial talos
LOWEST_TESTS ?= -m "not slow and not nightly" $(wildcard $(foreach part,$(PARTS),$(TESTS_$(part):%=%/unit)))

lowest: setup  ## the unit tests and the demo with the lowest versions that pyproject.toml allows (ARGS="-k cli")
	@mkdir -p build && rm -rf $(LOWEST_VENV)
	@$(BIN)/uv pip compile --quiet --resolution lowest-direct --python $(BIN)/python $(LOWEST_EXTRAS:%=--extra %) --group dev $(NO_EMIT) $(PROJECTS) -o $(LOWEST_VERSIONS)
	@$(BIN)/python -m venv $(LOWEST_VENV)
	@$(BIN)/uv pip install --quiet --compile-bytecode --python $(LOWEST_VENV)/bin/python -r $(LOWEST_VERSIONS) hatchling editables
	@$(call install_ours,$(LOWEST_VENV),$(EVERYTHING))
	@$(LOWEST_VENV)/bin/pytest -n $(JOBS) -p no:cacheprovider $(LOWEST_TESTS) $(ARGS)
	@data=$$(mktemp -d) && $(LOWEST_VENV)/bin/handover demo --once --data-dir "$$data"; ended=$$?; rm -rf "$$data"; exit $$ended

SCHEMATHESIS_VENV := $(VENV)-schemathesis

$(SCHEMATHESIS_VENV)/.ready: requirements/schemathesis.lock | setup
	@rm -rf $(SCHEMATHESIS_VENV)
	@$(BIN)/python -m venv $(SCHEMATHESIS_VENV)
	@$(BIN)/uv pip install --quiet --compile-bytecode --python $(SCHEMATHESIS_VENV)/bin/python --require-hashes -r requirements/schemathesis.lock
	@touch $@

schemathesis: $(SCHEMATHESIS_VENV)/.ready  ## schemathesis against the OpenAPI document of every service (ARGS="--service study --examples 100")
	@$(BIN)/python -m tests.load.schemathesis_run $(SCHEMATHESIS_VENV)/bin/schemathesis $(ARGS)

humanoid-memory: setup
	@$(BIN)/python -m benchmarks.humanoid.whole_body_memory

containers:
	@if docker info >/dev/null 2>&1 || { [ "$$(id -u)" = 0 ] && command -v podman >/dev/null; }; then \
		deploy/try-containers; \
	else \
		echo "the containers were not tried; that takes a Docker engine, or root and podman" >&2; \
	fi

nightly: setup  ## what takes long, in parts (ARGS="--only nightly-broker crashes", ARGS="--changed --minutes 50")
	@$(BIN)/python -m tests.nightly $(ARGS)

check:  ## lint, types, structure and quick tests, for an everyday change
	@$(MAKE) --no-print-directory test SELECTED="not nightly and not slow"

lint: python-check  ## lint, types and structure only
	@$(PAGE) lint
	@$(PAGE) size

# Those of one package stand in its project. A cache may name modules that have moved since.
contracts = $(BIN)/lint-imports --no-cache --config $(1) >$(VENV)/contracts.log 2>&1 || { cat $(VENV)/contracts.log; exit 1; }

python-check: setup
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/typos
	@$(BIN)/mypy
	@$(foreach project,$(shell grep -l '^\[tool.importlinter' $(PROJECTS)),$(call contracts,$(project)) &&) true
	@$(BIN)/python -m handover_datamodels.schemas --check
	@$(BIN)/python -m handover_web.roles --check
	@$(BIN)/python -m handover_web.types --check
	@$(BIN)/python -m handover_web.service_types --check
	@$(BIN)/python -m requirements.third_party --check
	@$(BIN)/python -m docs.site.reference --check
	@$(BIN)/python -m docs.site.adr_figures

# The linter and the tests use one core each.
page-check: setup
	@$(PAGE) size
	@$(PAGE) lint & lint=$$!; $(PAGE) test; tests=$$?; wait $$lint && exit $$tests

dist: setup  ## the wheels of all distributions, and their source archives
	@rm -rf dist
	@for folder in $(patsubst %/,%,$(dir $(PROJECTS))); do \
		(cd $$folder && $(CURDIR)/$(BIN)/python -m hatchling build -t sdist -t wheel -d $(CURDIR)/dist) || exit 1; \
	done

docs: setup  ## build the documentation site into build/site
	@$(BIN)/python -m docs.site.diagrams
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

reference: setup  ## write the reference pages of the documentation, and the roles of the page, from the code
	@$(BIN)/python -m docs.site.reference
	@$(BIN)/python -m handover_web.roles

third-party: setup  ## write THIRD_PARTY.md from the metadata of the installed packages
	@$(BIN)/python -m requirements.third_party

# Our own distributions are in no lock.
NO_EMIT = $(addprefix --no-emit-package ,$(sort $(shell sed -n 's/^name = "\(handover-.*\)"/\1/p' $(PROJECTS))))
COMPILE = $(BIN)/uv pip compile --quiet --universal --generate-hashes --no-header $(NO_EMIT) $(ARGS) --python-version

lock: $(VENV)/.ready  ## resolve the dependencies again (no host names, with hashes)
	@$(COMPILE) 3.11 --all-extras --group dev --group ros-test pyproject.toml -o requirements/handover.lock
	@$(COMPILE) 3.11 -c requirements/handover.lock requirements/tools.in -o requirements/tools.lock
	@$(COMPILE) 3.12 --override requirements/jazzy.in ros_fiware_bridge/pyproject.toml -o requirements/jazzy.lock
	@$(COMPILE) 3.11 requirements/node.in -o requirements/node.lock
	@$(COMPILE) 3.11 requirements/bench.in -o requirements/bench.lock
	@$(COMPILE) 3.11 requirements/schemathesis.in -o requirements/schemathesis.lock

bench: bench-broker bench-orchestrator bench-gestures bench-handover bench-bridge bench-motion bench-devices bench-human-state  ## measure everything

bench-broker: setup  ## the broker: create, patch, retrieve, query, notify
	@$(BIN)/python -m benchmarks.cell.broker

bench-orchestrator: setup  ## the token engine alone, and the orchestrator as a service (ARGS=--postgres)
	@$(BIN)/python -m benchmarks.cell.token_engine
	@$(BIN)/python -m benchmarks.cell.orchestrator $(ARGS)

bench-gestures: setup  ## the gesture controller: frames a second, cost of 50 gloves
	@$(BIN)/python -m benchmarks.gloves.gesture_controller $(if $(DATA),--data $(DATA))

bench-handover: setup  ## from the held gesture to the robot; cold start; memory
	@$(BIN)/python -m benchmarks.cell.handover

bench-bridge: setup  ## the ROS bridge: both ways through the broker, 1,000 messages a second
	@$(BIN)/python -m benchmarks.ros.ros_bridge $(ARGS)

bench-motion: setup  ## motion planning, and bin picking in simulated physics (SHORT=1: 12 minutes; ARGS="--problems 100")
	@$(BIN)/python -m benchmarks.robots.motion $(if $(SHORT),--problems 334 --peers 20) $(ARGS)
	@$(BIN)/python -m benchmarks.robots.random_moves $(if $(SHORT),--moves 2000)
	@$(BIN)/python -m benchmarks.robots.physics

bench-devices: setup  ## the device gateway: 1,000 devices at 1 Hz, values stored a second (ARGS=--postgres)
	@$(BIN)/python -m benchmarks.cell.devices $(ARGS)

bench-control: setup  ## people who move robots by hand: input to motion command, 50 users on 50 robots (ARGS="--users 10")
	@$(BIN)/python -m benchmarks.robots.control $(ARGS)

bench-human-state: setup  ## body signals: beats, rates, faults, cost, beside neurokit2, xqrs and heartpy (ARGS=--quick)
	@$(BIN)/python -m benchmarks.body.human_state $(ARGS)
	@$(BIN)/python -m benchmarks.body.human_state_limits

PEERS_VENV := $(VENV)-peers

# Peers have dependencies of their own, other versions of ours among them.
$(PEERS_VENV)/.ready: requirements/bench.lock | setup
	@rm -rf $(PEERS_VENV)
	@$(BIN)/python -m venv $(PEERS_VENV)
	@$(BIN)/uv pip install --quiet --compile-bytecode --python $(PEERS_VENV)/bin/python --require-hashes -r requirements/bench.lock
	@touch $@

bench-whole-body: setup $(PEERS_VENV)/.ready  ## the stack of tasks on COMAN and its peers, then walking for five minutes, pushes, lateness, throws (ARGS="--problems 400" CYCLE_SECONDS=600)
	@$(BIN)/python -m benchmarks.humanoid.whole_body $(ARGS)
	@$(BIN)/python -m benchmarks.humanoid.whole_body_peers $(PEERS_VENV)/bin/python $(ARGS)
	@$(BIN)/python -m benchmarks.humanoid.whole_body_walking $(if $(CYCLE_SECONDS),--seconds $(CYCLE_SECONDS))
	@$(BIN)/python -m benchmarks.humanoid.whole_body_throwing

bench-load: setup  ## 10,000 clients a minute on new TLS connections, replicas behind HAProxy, sign-ins, latency (ARGS="--replicas 1")
	@$(BIN)/python -m benchmarks.cell.load $(ARGS)

bench-cells: setup  ## 50 cells on one broker, until something gives way (ARGS="--cells 10 --broker http://orion.example:1026")
	@$(BIN)/python -m benchmarks.cell.many_cells $(ARGS)

bench-sign-in: setup  ## 1,000 wrong passwords a second for a minute, while a person signs in (ARGS="--addresses 500")
	@$(BIN)/python -m benchmarks.cell.sign_in $(ARGS)

bench-vr: setup  ## virtual reality with an emulated headset: what the page works, and the way from a pose to its picture (ARGS="--seconds 20")
	@$(BIN)/python -m benchmarks.page.humanoid_vr $(ARGS)

bench-screen: setup  ## the screen in Chromium: response times, and the waveforms of the page Health
	@$(BIN)/python -m benchmarks.page.screen $(ARGS)
	@$(BIN)/python -m benchmarks.page.waveforms
	@$(PAGE) bench

pictures: setup  ## make the pictures of the documentation from the running product (needs Chromium)
	@$(BIN)/python -m benchmarks.page.pictures $(ARGS)

humanoid-figures: setup  ## the figures of CoSiMA from own runs, in webui/pictures
	@$(BIN)/handover humanoid figures webui/pictures

clean:  ## remove what setup made (not your data in .handover)
	rm -rf $(VENV) $(ROS_VENV) $(LOWEST_VENV) $(PEERS_VENV) $(SCHEMATHESIS_VENV) webui/handover_web/page webui/app/node_modules .mypy_cache .ruff_cache .pytest_cache .import_linter_cache
