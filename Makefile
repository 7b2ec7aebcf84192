# zerodrift: every target sets up what it needs. `make help` lists them.
.DEFAULT_GOAL := help
SHELL := /bin/bash

VENV ?= .venv
PYTHON ?= python3
RUN := $(VENV)/bin/python
PIP := $(RUN) -m pip install --quiet --disable-pip-version-check
SENSOR ?= examples/ft40
READY := $(VENV)/.ready
# Where there is no C compiler, the clang inside the ziglang wheel is one.
HOST_CC := $(shell command -v cc || command -v gcc || command -v clang)
CMAKE = $(if $(HOST_CC),,CC="$(abspath $(RUN)) -m ziglang cc") $(VENV)/bin/cmake -S . -G Ninja \
  -DCMAKE_MAKE_PROGRAM=$(abspath $(VENV))/bin/ninja
# PyTorch with two threads is a hundred times slower on such small networks than with one.
export OMP_NUM_THREADS ?= 1
# Without byte code each process of the tests compiles all modules again, and rewrites every assert.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: same-as setup-newest test-newest test-oldest lock setup-frama-c frama-c test-long setup-peers setup-record readme-picture bench-numbers test-faults setup-formats mutated-logs test-worlds test-wheel bench-paper bench-foreign setup-browser test-browser tutorial help setup setup-qemu setup-fuzz test-boards flash-image fuzz check format schemas test test-all firmware-model golden sizes bench bench-hidden c-test docs demo clean

help: ## list the targets
	@grep -hE '^[a-z][a-z-]*:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | sort | column -t -s "$$(printf '\t')"

setup: $(READY) ## create .venv with the pinned dependencies and zerodrift itself

$(READY): requirements.lock requirements-torch.lock pyproject.toml proof/pyproject.toml lab/pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "zerodrift needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version 2>&1). Set PYTHON=."; exit 2; }
	@echo "installing into $(VENV): some minutes, and on Linux 6 GB, most of it PyTorch's"
	$(PYTHON) -m venv $(VENV)
	$(PIP) --require-hashes -r requirements.lock
	$(PIP) -r requirements-torch.lock
	$(PIP) --no-deps --no-build-isolation -e . -e proof -e lab
	@touch $@

setup-qemu: ## QEMU and the GNU cross-compilers, by apt (root): the second opinion on every core
	.ci/apt-install qemu-system-arm qemu-system-misc gcc-arm-none-eabi libnewlib-arm-none-eabi \
	  gcc-riscv64-unknown-elf gcc-avr avr-libc arduino-core-avr simavr

setup-fuzz: $(READY) ## what fuzzing needs: clang with libFuzzer by apt (root), and atheris
	$(RUN) -m tests.fuzz --have-clang || .ci/apt-install clang libclang-rt-dev? libc6-dev
	$(PIP) --require-hashes -r requirements-fuzz.lock

setup-frama-c: ## Frama-C, by apt (root): an outside witness of the overflow certificate
	.ci/apt-install frama-c-base

setup-formats: $(READY) ## what reads Excel, HDF5, MCAP, rosbag2, ULog and ArduPilot logs
	$(PIP) --require-hashes -r requirements-formats.lock

setup-newest: ## a Debian of its own with the newest Python, in build/newest, by debootstrap (root)
	.ci/in-debian sid build/newest/debian true

setup-peers: $(READY) ## the other methods that benchmarks.bench_peers compares with: PySINDy, pyoperon, gplearn
	$(PIP) --require-hashes --no-deps -r requirements-peers.lock

setup-record: ## an MQTT broker, by apt (root), for the tests of `zerodrift record`
	.ci/apt-install mosquitto

mutated-logs: $(READY) ## 2,000 mutated logs of every format: each read or refused, none a traceback (MUTATED=--count=260)
	$(RUN) -m tests.fuzz.mutated_logs $(MUTATED)

setup-browser: $(READY) ## what the browser tests need: Playwright, and Chromium from the system's packages
	$(PIP) --require-hashes -r requirements-browser.lock
	@command -v chromium >/dev/null || command -v google-chrome >/dev/null || { \
	  SUDO=$$([ "$$(id -u)" = 0 ] || echo sudo); \
	  $$SUDO apt-get update -q && $$SUDO apt-get install -y -q --no-install-recommends chromium; }

readme-picture: $(READY) ## docs/assets/loop.svg: the loop walked by its commands on simulated logs
	$(RUN) -m manual.loop_picture

docs: $(READY) ## the manual as a site, in build/site
	$(PIP) --require-hashes -r requirements-docs.lock
	NO_MKDOCS_2_WARNING=1 DISABLE_MKDOCS_2_WARNING=true $(RUN) -m mkdocs build --quiet --strict
	@echo "build/site/index.html; for its search, serve it: $(RUN) -m http.server -b 127.0.0.1 -d build/site"

firmware-model: $(READY) ## logs -> trained, quantized, generated and host-checked C (SENSOR=examples/ft40)
	@test ! -f $(SENSOR)/twin.json || $(VENV)/bin/zerodrift twin --example -C $(SENSOR)
	$(VENV)/bin/zerodrift firmware -C $(SENSOR)

flash-image: $(READY) ## ELF and BIN of the example firmware for QEMU's Cortex-M4 board (SENSOR=examples/ft40)
	@test -f $(SENSOR)/build/model.json || $(MAKE) --no-print-directory firmware-model
	$(RUN) examples/firmware/build.py $(SENSOR)

test: $(READY) ## what is run before each commit: each module's behaviour, golden bytes, the loop (minutes)
	$(RUN) -m pytest -q -n 2 -m "not slow and not long" tests

test-long: $(READY) ## what `make test` leaves out, but for the proofs marked slow (SHARE=1/6: a sixth of it)
	$(RUN) -m pytest -q -n 2 --share=$(or $(SHARE),1/1) -m "long and not slow" tests

same-as: $(READY) ## what this tree does held against another tree, byte for byte (OLD=PATH, with its own .venv)
	$(RUN) -m tests.house.same_as $(OLD)

test-boards: $(READY) ## every core on QEMU's boards, in short; says what could not run
	$(RUN) -m pytest -q -m "board and not slow" tests/chips

test-browser: $(READY) ## after setup-browser: the page in Chromium, pictures in build/screenshots (BROWSER="-m slow")
	$(RUN) -m pytest -q -n 2 $(BROWSER) tests/workbench

test-worlds: $(READY) ## after setup-formats: the sessions of the pages on where logs come from, as CI runs them
	$(RUN) -m pytest -q -n 2 -rs tests/loop/test_worlds.py

test-wheel: $(READY) ## build the wheel, install it elsewhere, and go from a log to checked C with it
	$(RUN) -m pytest -q tests/house/test_wheel.py tests/house/test_extras.py

# Folders and files in which another version of Python or of a library shows first.
FIRST := tests/config tests/twin tests/frozen tests/fixed_point/test_model_files.py tests/dataset \
  tests/main_job tests/physics tests/face tests/apply
VERSIONS := -q -n $(if $(SHORT),1,2) -m "not slow and not board$(if $(SHORT),, and not long)" $(if $(SHORT),$(FIRST),--ignore=tests/chips tests)

test-newest: ## the tests, boards and browser left out, on Debian's newest Python and the newest libraries (SHORT=1)
	.ci/test-newest $(VERSIONS)

test-oldest: ## the same on Python 3.11 and the lowest versions that pyproject.toml allows (SHORT=1)
	.ci/test-oldest $(VERSIONS)

test-all: $(READY) ## every test: test, test-long and the proofs marked slow
	$(RUN) -m pytest -q -n 2 tests

check: $(READY) ## formatting, lint, types, C format and static analysis
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/ruff check .
	$(VENV)/bin/mypy
	$(VENV)/bin/clang-format --dry-run --Werror c_runtime/include/zerodrift/*.h c_runtime/tests/*.c
	$(RUN) -m zerodrift.c_runtime.analyse

frama-c: $(READY) ## after setup-frama-c: golden models under Frama-C's Eva, no alarm (FRAMA_C="ordinary lstm")
	$(RUN) -m tests.certificate.eva $(FRAMA_C)

format: $(READY) ## rewrite Python and C in the project's format
	$(VENV)/bin/ruff format .
	$(VENV)/bin/ruff check --fix .
	$(VENV)/bin/clang-format -i c_runtime/include/zerodrift/*.h c_runtime/tests/*.c

lock: ## write the hashes in requirements*.lock again, after a version was changed; read the diff
	.ci/lock

schemas: $(READY) ## write the JSON Schemas of what the commands print again
	$(RUN) -m zerodrift.cli.schemas

golden: $(READY) ## write the golden vectors and the runtime's table again; read the diff
	$(RUN) -m zerodrift.c_runtime.write_table
	$(RUN) -m tests.golden.regenerate

c-test: $(READY) ## build the C runtime with CMake and run its ctest programs, sanitized too
	$(CMAKE) -B build/cmake
	$(VENV)/bin/cmake --build build/cmake
	$(VENV)/bin/ctest --test-dir build/cmake --output-on-failure
	$(CMAKE) -B build/cmake-sanitized -DZD_SANITIZE=ON
	$(VENV)/bin/cmake --build build/cmake-sanitized
	$(VENV)/bin/ctest --test-dir build/cmake-sanitized --output-on-failure

sizes: $(READY) ## against main: lines and modules of each folder; flash, RAM and instructions of the golden models
	$(RUN) -m tests.house.lines --against main
	$(RUN) -m benchmarks.sizes

bench: $(READY) ## the figures of the documentation, but for the targets bench-... (BENCH=--quick)
	$(RUN) -m benchmarks $(BENCH)

test-faults: $(READY) ## faults in every command that writes: all of them, hours; FAULTS="--share 0.1 --seconds 90" for less
	$(RUN) -m tests.faults $(FAULTS)

fuzz: $(READY) ## fuzz the generated C and the readers of files, 10 CPU minutes per target (FUZZ=--seconds=20)
	$(RUN) -m tests.fuzz $(FUZZ)

bench-hidden: $(READY) ## effects hidden in simulated logs and found again (BENCH=--quick)
	$(RUN) -m benchmarks.bench_hidden $(BENCH)

bench-numbers: $(READY) ## one number, one place: page, report, terminal and JSON of 20 projects compared
	$(RUN) -m benchmarks.bench_numbers $(BENCH)

bench-foreign: $(READY) ## the diagnosis judged by a second simulator (BENCH=--quick)
	$(RUN) -m benchmarks.foreign $(BENCH)

bench-paper: $(READY) ## the default against the paper's methods on the six-axis twin (BENCH=--quick); resumable
	$(RUN) -m benchmarks.bench_paper $(BENCH)

tutorial: $(READY) ## run the tutorials' commands again and write their output into the pages
	$(RUN) tests/loop/regenerate_tutorial.py

clean: ## remove what was built, keep the virtual environment
	rm -rf build examples/*/build examples/*/firmware .mypy_cache .ruff_cache .pytest_cache
