# Each target sets up what it needs by itself: a fresh clone needs Python 3.11 or newer, and make.
.DEFAULT_GOAL := help
SHELL := /bin/bash

PYTHON ?= $(shell for p in python3 python3.11 python3.12 python3.13 python3.14; do \
  $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { echo $$p; break; }; done)
VENV := .venv
BIN := $(VENV)/bin

FIRMWARE_PACKAGES := cmake g++ clang clang-format clang-tidy cppcheck libclang-rt-14-dev gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm \
  gcc-avr avr-libc arduino-core-avr libsimavr-dev

WORLD_PACKAGES := clang lld wasi-libc libclang-rt-14-dev-wasm32

XTENSA_PACKAGES := gcc-xtensa-lx106 picolibc-xtensa-lx106-elf

DEB_PACKAGES := debhelper lintian binutils man-db

COMPILED_PACKAGES := gcc python3-dev gcc-aarch64-linux-gnu libc6-dev-arm64-cross debian-archive-keyring

ROS1_PACKAGES := python3-catkin-pkg python3-roslaunch python3-rospy python3-rosbag python3-rostopic python3-rosservice python3-rosnode python3-rosparam python3-geometry-msgs \
  python3-nav-msgs python3-rosgraph-msgs python3-sensor-msgs python3-std-msgs python3-std-srvs python3-tf2-msgs

WEB := hostlink/components/gateway/web

CHAOS_S ?= 600

MUTANTS ?= 8
MUTANTS_SEED ?= 1

CORES := $(shell nproc)
WORKERS ?= $(shell echo $$((4 * $(CORES))))# of tests that start no program: much of their time is waiting
unexport PYTHONDONTWRITEBYTECODE # the tests start hostlink some hundred times

.PHONY: help demo docs test test-all quick test-pythons coverage mutants check bench fuzz web screenshots firmware world lab chain soak netns ros2-venv ros-mcp-venv release compiled test-compiled weight piuparts arm64 format clean

help:
	@echo "make demo    start the daemon with a simulated robot (ARGS='--api 127.0.0.1:9091 --listen 127.0.0.1:11412': other ports)"
	@echo "make test    run the tests that need Python alone, in two or three minutes with their installation (230 MB in .venv)"
	@echo "make test-all  run every test: installs compilers, emulators, browsers and ROS (5 GB), and runs for half an hour"
	@echo "make quick   run the tests of the core, in less than a minute"
	@echo "make docs    build the site of the documents, into build/docs/index.html"
	@echo "make test-pythons  unit, property and integration tests on each Python from 3.11 that is found (PYTHONS=3.13)"
	@echo "make coverage  which branches of the core no test takes; the pure packages must have none"
	@echo "make mutants  change the core at places that a seed draws: what no test notices (MUTANTS=20 MUTANTS_SEED=7)"
	@echo "make release  wheels, source distribution and Debian packages, tried in empty environments of Python 3.11, 3.12 and 3.13"
	@echo "make piuparts  install, upgrade, remove and purge the Debian package for amd64 (as root)"
	@echo "make arm64   install the Debian package and the wheel in an emulated arm64, drive there and run unit tests (an hour)"
	@echo "make weight  measure what the base, each extra, the packages and other programs weigh (docs/weight.md)"
	@echo "make compiled  wheels of the same sources compiled with mypyc, for amd64 and arm64, into build/release"
	@echo "make test-compiled  tests on the compiled modules (TESTS=tests/unit/core/hub)"
	@echo "make check   format, lint, types, import rules"
	@echo "make bench   measure, write the figures to build/bench*.json"
	@echo "make ros2-venv  rclpy from PyPI and hostlink, into build/ros2-venv"
	@echo "make ros-mcp-venv  ros-mcp from PyPI, a client of rosbridge that the tests run, into build/ros-mcp-venv"
	@echo "make firmware  build the boards' firmware in every way that runs here, and test it"
	@echo "make world   build the firmware in its world as WebAssembly, for simulated robots (hostlink/workbench/sim/firmware.wasm)"
	@echo "make lab     drive the paper's measurements again: causes, tables, claims and pictures, into build/lab"
	@echo "make web     build the browser's page from $(WEB)/src (needs Node 20.19 or newer)"
	@echo "make screenshots  pictures of the page, into build/screenshots"
	@echo "make chain   hostlink, the ESP8266's sketch and the Due's firmware on an emulated Cortex-M3 (NATIVE=1: on the PC;"
	@echo "             WORLD=FILE: in that world)"
	@echo "make soak    ten minutes of driving on the chain, 5000 drives in drawn worlds, a minute of the daemon in each of 1000"
	@echo "             simulated worlds, ten minutes over a link that fails, every message counted, and ten of chaos against the"
	@echo "             daemon (CHAOS_S=3600: an hour, CHAOS_SEED=7: the steps of that seed again)"
	@echo "make netns   host and robot in two network namespaces: loss, delay, a black-out, another address (as root)"
	@echo "make fuzz    the property tests with 5,000 examples each, then a minute of atheris or libFuzzer on each reader of bytes"

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "hostlink needs Python 3.11 or newer: install python3.11, or run make PYTHON=/path/to/python3"; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); echo "no venv module: on Debian and Ubuntu run  sudo apt-get install python3-venv"; exit 1; }

$(VENV)/.hostlink: pyproject.toml | $(BIN)/python
	@echo "installing hostlink into $(VENV) ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[sim]'
	@touch $@

# What is only tested is compiled when it is imported: half of the time of an installation.
$(VENV)/.test: pyproject.toml | $(BIN)/python
	@echo "installing hostlink and what its tests need into $(VENV): about 45 Python packages, 230 MB; nothing outside of it ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -e '.[test]'
	@touch $@ $(VENV)/.hostlink

$(VENV)/.dev: pyproject.toml | $(BIN)/python
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@ $(VENV)/.hostlink $(VENV)/.test

demo: $(VENV)/.hostlink
	@exec $(BIN)/hostlink demo $(ARGS)

# rclpy and its messages from PyPI, 240 MB, in a venv of their own: no other test may depend on them.
ROS2_VENV := build/ros2-venv
ROS2_PACKAGES := mcap 'ros-rclpy[fastrtps]' ros-std-msgs ros-std-srvs ros-geometry-msgs ros-nav-msgs ros-sensor-msgs ros-diagnostic-msgs

$(ROS2_VENV)/.installed: pyproject.toml
	@test -n "$(PYTHON)" || { echo "hostlink needs Python 3.11 or newer"; exit 1; }
	@echo "installing rclpy and hostlink into $(ROS2_VENV) ..."
	@test ! -L $(ROS2_VENV) || { echo "$(ROS2_VENV) is a link: venv --clear would empty the directory that it names"; exit 1; }
	@$(PYTHON) -m venv --clear $(ROS2_VENV)
	@$(ROS2_VENV)/bin/python -m pip install --quiet --disable-pip-version-check -e '.[ros2]' $(ROS2_PACKAGES) \
	  || { echo "rclpy cannot be installed from PyPI: the tests of hostlink ros2 (tests/system/ros2) need it"; exit 1; }
	@touch $@

ros2-venv: $(ROS2_VENV)/.installed

# ros-mcp, 430 MB with what it wants, in a venv of its own, which no other test needs.
ROS_MCP_VENV := build/ros-mcp-venv

$(ROS_MCP_VENV)/.installed:
	@test -n "$(PYTHON)" || { echo "hostlink needs Python 3.11 or newer"; exit 1; }
	@echo "installing ros-mcp into $(ROS_MCP_VENV) ..."
	@test ! -L $(ROS_MCP_VENV) || { echo "$(ROS_MCP_VENV) is a link: venv --clear would empty the directory that it names"; exit 1; }
	@$(PYTHON) -m venv --clear $(ROS_MCP_VENV)
	@$(ROS_MCP_VENV)/bin/python -m pip install --quiet --disable-pip-version-check ros-mcp==3.1.2 \
	  || { echo "ros-mcp cannot be installed from PyPI: tests/system/test_ros_mcp.py needs it"; exit 1; }
	@touch $@

ros-mcp-venv: $(ROS_MCP_VENV)/.installed

# promtool out of Debian's package, which when installed would start a server on port 9090.
PROMTOOL := build/promtool/usr/bin/promtool
DOWNLOADS := $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/hostlink-tests# of all clones, as pip and npm keep theirs

$(PROMTOOL):
	@mkdir -p build/promtool
	@mkdir -p $(DOWNLOADS)
	@cd $(DOWNLOADS) && { ls prometheus_*.deb >/dev/null 2>&1 || apt-get -qq download prometheus \
	  || { apt-get -o DPkg::Lock::Timeout=300 -qq update && apt-get -qq download prometheus; }; }
	@dpkg -x $$(ls $(DOWNLOADS)/prometheus_*.deb | tail -1) build/promtool && touch $@

CLIENTS := tests/clients/node_modules/.package-lock.json

$(CLIENTS): tests/clients/package.json tests/clients/package-lock.json
	@{ command -v node && command -v npm; } >/dev/null || tools/require.sh nodejs npm
	@echo "installing the JavaScript clients that the tests run ..."
	@cd tests/clients && npm ci --ignore-scripts --no-progress --loglevel=error
	@touch $@

.PHONY: test-packages
test-packages:
	@tools/require.sh tmux zsh procps systemd man-db chromium-headless-shell firefox-esr openssl mosquitto mosquitto-clients $(FIRMWARE_PACKAGES) $(WORLD_PACKAGES) $(ROS1_PACKAGES)

# Lanes that are installed side by side. What cannot be installed here does not end the run: the table at its end lists the
# tests that need it (tests/support/requirements.py).
.PHONY: test-requirements
test-requirements: | $(BIN)/python
	@$(PYTHON) tools/install_for_tests.py --lane $(VENV)/.dev $(ROS2_VENV)/.installed $(ROS_MCP_VENV)/.installed \
	  --lane test-packages $(CLIENTS) $(PROMTOOL)

test: $(VENV)/.test
	$(BIN)/python tools/run_tests.py python --workers $(WORKERS)

test-all: test-requirements
	$(BIN)/python tools/run_tests.py all --workers $(WORKERS)

quick: $(VENV)/.test
	$(BIN)/python -m pytest -q --workers $(WORKERS) --python-only -m "not slow and not quiet and not alone and not long" tests/unit/core

coverage: $(VENV)/.dev
	HYPOTHESIS_PROFILE=ci $(BIN)/coverage run -m pytest --workers $(CORES) tests/unit tests/property tests/integration
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report
	$(BIN)/python tools/run_tests.py branches

release: $(VENV)/.dev
	@tools/require.sh $(DEB_PACKAGES) $(COMPILED_PACKAGES)
	$(BIN)/python -m tools.release

piuparts: $(VENV)/.dev
	@tools/require.sh $(DEB_PACKAGES) piuparts debootstrap
	tools/try_piuparts.sh

arm64: $(VENV)/.dev
	@tools/require.sh $(DEB_PACKAGES) $(COMPILED_PACKAGES) debootstrap proot qemu-user-static
	tools/try_arm64.sh

weight: $(VENV)/.dev
	$(BIN)/python -m tools.measure_weight

compiled: $(VENV)/.dev
	@tools/require.sh $(COMPILED_PACKAGES)
	$(BIN)/python -m tools.compiled --into build/release

TESTS ?= tests/unit tests/property tests/integration tests/system
test-compiled: $(VENV)/.dev
	@tools/require.sh $(COMPILED_PACKAGES)
	tools/test_compiled.sh $(TESTS)

mutants: $(VENV)/.dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[mutants]'
	$(BIN)/python tools/mutants.py --seed $(MUTANTS_SEED) --count $(MUTANTS)

test-pythons:
	tools/test_pythons.sh $(PYTHONS)

check: $(VENV)/.dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/python tools/built_stale.py

# A venv of its own, 220 MB: the test tools, which the site does not need, are 750 MB more.
DOCS_VENV := build/docs-venv

$(DOCS_VENV)/.installed: pyproject.toml
	@test -n "$(PYTHON)" || { echo "hostlink needs Python 3.11 or newer"; exit 1; }
	@echo "installing hostlink and sphinx into $(DOCS_VENV), 220 MB ..."
	@test ! -L $(DOCS_VENV) || { echo "$(DOCS_VENV) is a link: venv --clear would empty the directory that it names"; exit 1; }
	@$(PYTHON) -m venv --clear $(DOCS_VENV)
	@$(DOCS_VENV)/bin/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	@touch $@

docs: $(DOCS_VENV)/.installed
	$(DOCS_VENV)/bin/sphinx-build -q --keep-going -W -b html docs build/docs
	@echo "open build/docs/index.html"

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/.dev $(ROS2_VENV)/.installed
	@tools/require.sh $(ROS1_PACKAGES)
	@status=0; for part in link api crowd messages micro_ros black_box recording ros2 ros1; do \
	  echo "== $$part"; $(BIN)/python tools/bench_$$part.py || status=1; done; exit $$status

# So many examples last longer than the two minutes that other tests have.
FUZZ_TEST_S := 3600
fuzz: $(VENV)/.dev
	@tools/require.sh $(FIRMWARE_PACKAGES)
	HYPOTHESIS_PROFILE=fuzz $(BIN)/python -m pytest --workers $(CORES) --timeout $(FUZZ_TEST_S) tests/property
	HYPOTHESIS_PROFILE=fuzz $(BIN)/python -m pytest --workers $(CORES) --timeout $(FUZZ_TEST_S) tests/unit tests/firmware -m hypothesis
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[fuzz]'
	@tools/require.sh clang libclang-rt-14-dev
	$(BIN)/python tools/fuzz.py --seconds 60

web: $(VENV)/.dev
	@command -v npm >/dev/null || { echo "make web needs Node 20.19 or newer, with npm"; exit 1; }
	cd $(WEB) && npm ci --no-progress && npm run check && npm run build
	$(BIN)/python tools/built_stale.py --write web

screenshots: $(VENV)/.dev
	@tools/require.sh chromium-headless-shell
	HOSTLINK_PICTURE_RAD=2.6 $(BIN)/python -m pytest tests/system/test_page_states.py -k right
	HOSTLINK_PICTURES=1 $(BIN)/python -m pytest tests/system/test_page_layout.py -k fits
	cp build/screenshots/page-desk-light.png docs/page.png

firmware: $(VENV)/.dev
	@tools/require.sh $(FIRMWARE_PACKAGES) $(XTENSA_PACKAGES) $(WORLD_PACKAGES)
	cd firmware && for preset in native native-asan cortex-m3; do \
	  cmake --preset $$preset >/dev/null && cmake --build --preset $$preset && ctest --preset $$preset -E python || exit 1; done
	firmware/tests/avr_gate.sh
	$(BIN)/python tools/board_sizes.py
	$(BIN)/python -m pytest tests/firmware

world: $(VENV)/.dev
	@tools/require.sh $(WORLD_PACKAGES)
	$(BIN)/python tools/build_world.py
	$(BIN)/python tools/built_stale.py --write world

lab: $(VENV)/.dev
	@mkdir -p build/lab
	set -o pipefail; $(BIN)/hostlink lab tables | tee build/lab/tables.md
	set -o pipefail; $(BIN)/hostlink lab claims | tee build/lab/claims.md
	set -o pipefail; $(BIN)/hostlink lab causes | tee build/lab/causes.md
	$(BIN)/hostlink lab pictures -o build/lab/paths.png
	HOSTLINK_LAB_RUNS=30 $(BIN)/python -m pytest tests/firmware/test_laboratory.py

chain: $(VENV)/.hostlink
	@tools/require.sh cmake g++ gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm
	@exec $(BIN)/python tools/chain.py $(if $(NATIVE),--native) $(if $(WORLD),--world $(WORLD))

soak: $(VENV)/.dev
	@tools/require.sh $(FIRMWARE_PACKAGES)
	HOSTLINK_SOAK_S=600 $(BIN)/python -m pytest tests/firmware/test_due_soak.py
	HOSTLINK_DRIVES=5000 HOSTLINK_DRIVES_M3=100 $(BIN)/python -m pytest tests/firmware/test_due_sweep.py
	HOSTLINK_SEEDS=30 $(BIN)/python -m pytest tests/firmware/test_due_calibration.py
	$(BIN)/python tools/measure_calibration.py
	$(BIN)/python -m tests.support.simulation 0-999 --processes $(CORES)
	$(BIN)/python tools/soak_link.py --seconds 600
	$(BIN)/python tools/soak_recording.py
	HOSTLINK_RECORDING_KILLS=50 $(BIN)/python -m pytest tests/system/test_record_and_play.py -k killed
	$(BIN)/python tools/chaos_daemon.py --seconds $(CHAOS_S) $(if $(CHAOS_SEED),--seed $(CHAOS_SEED))
	$(BIN)/python tools/measure_damage.py --frames 10000000
	HOSTLINK_KILLS=1000 $(BIN)/python -m pytest -s tests/system/test_guardian_kills.py

netns: $(VENV)/.dev
	@tools/require.sh iproute2
	$(BIN)/python tools/netns.py
	$(BIN)/python tools/netns_fleet.py

clean:
	rm -rf $(VENV) build dist docs/reference .mypy_cache .ruff_cache .pytest_cache .hypothesis
