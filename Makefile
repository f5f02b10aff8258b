# towtank: `make demo` shows it at work, `make test` runs every check. Both set up .venv by themselves.
PYTHON  ?= python3
WORKERS ?= 3
DEMO    ?=
PEERS   ?=
KERNEL_TESTS := $(addprefix tests/identification/test_, axis_rows.py held_input.py measurements.py motion_state.py transition.py output_error_kernel.py)

BIN   := .venv/bin
RUNS  := .venv/.runs
READY := .venv/.ready
COMPILED := .venv/.compiled
PAGE  := src/towtank/dashboard/static/index.html
# One worker more than two processors have: tests of live sessions wait for most of their time.
# Each worker begins with files of its own, so that what the tests of a file share is mostly made once; who is done first
# takes of what the other has left. Linear algebra in one thread of each: those of more wait for each other by spinning.
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -q -n $(WORKERS) --dist worksteal
SOURCES := $(shell find src/towtank -name '*.py')
WEB   := $(wildcard web/*.json web/*.ts web/*.html web/public/* web/src/*)
SHELL := bash
# Byte code is kept, whatever the caller's environment says: each of the processes that the tests start, and there are
# hundreds, would compile the source anew.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help demo test parts lint types layers tests browser kernels docs bench peers engines lock clean

help:
	@echo 'make demo    a simulated tank session, learned sample by sample   (DEMO="--fast" passes options on)'
	@echo 'make test    every check: lint, types, layers, tests, plain-Python kernels, documentation'
	@echo 'make docs    the documentation, in docs/_build/html'
	@echo 'make bench   speed, beside other libraries'
	@echo 'make peers   live links with real peers, campaigns on dask and S3; sets up their environments   (PEERS="mavsdk")'
	@echo 'make engines exported models in the real engines, each in an environment of its own'
	@echo 'make lock    requirements.lock anew from pyproject.toml'
	@echo 'make clean   removes .venv and everything built or cached'
	@echo 'Set PYTHON=... to choose the interpreter (3.11 or newer) that .venv is made with.'

demo: parts
	@$(BIN)/towtank demo --output demo-output $(DEMO)

# The kernels are compiled while npm builds the page; each is made once, by a make of its own, and told in turn.
parts: $(RUNS)
	@$(MAKE) --silent $(COMPILED) >.venv/.compiling 2>&1 & $(MAKE) --silent $(PAGE); wait; cat .venv/.compiling

# Tests of live sessions wait for most of their time: the other checks run in what that leaves, and are told at the end.
# What the tests use beside what the demo does is compiled before they begin, else each worker would compile it.
test: lint
	@$(MAKE) --silent browser & $(MAKE) --silent parts; for group in free-runs others; do \
	$(BIN)/python -m towtank.app.demo.warm_up $$group >.venv/.compiling-$$group 2>&1 & done; wait; \
	nice -n 19 $(MAKE) --silent --keep-going --old-file=$(PAGE) types layers docs kernels >.venv/.beside 2>&1 & beside=$$!; \
	failed=0; echo 'tests, kernels compiled'; $(PYTEST) || failed=1; \
	wait $$beside || failed=1; cat .venv/.beside; exit $$failed

# $(call told,TITLE,COMMAND): one line with the seconds taken; the output only where the command fails.
define told
printf '%-46s' '$(1)'; start=$$SECONDS; \
if out=$$( { $(2); } 2>&1 ); then printf 'ok %4d s\n' $$((SECONDS - start)); \
else printf 'FAILED after %d s\n%s\n' $$((SECONDS - start)) "$$out"; exit 1; fi
endef
quietly = @$(told)
pip_install = $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --no-deps --requirement $(1)

# $(call from_debian,COMMAND,PACKAGES): where the command is missing, and only as root on a Debian.
from_debian = command -v $(1) >/dev/null || [ "$$(id -u)" != 0 ] || ! command -v apt-get >/dev/null || { \
	echo '$(1) is missing: installing $(2)'; { apt-get -qq update && apt-get -qq install -y --no-install-recommends $(2); } >/dev/null 2>&1 || true; }

# The environment: first what runs, then what checks; each from its lock, again only when that or the project's own metadata
# change. Byte code is made by all processors, where pip would take one, but for half of it that nobody imports: libraries'
# own tests, dialects, pip. What is no Python 3 among the libraries stays as it is.
byte_code = $(BIN)/python -m compileall -qq -j 0 -x "/(tests|dialects|pip|setuptools)/" .venv/lib src || true
$(RUNS): pyproject.toml requirements-run.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	echo "towtank needs Python 3.11 or newer; '$(PYTHON)' is not. Choose another: make PYTHON=python3.12 ..."; exit 1; }
	$(call quietly,setting up .venv (a minute or two),$(PYTHON) -m venv .venv)
	$(call quietly,  libraries from requirements-run.lock,$(call pip_install,requirements-run.lock))
	$(call quietly,  towtank itself,$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .)
	$(call quietly,  byte code,$(byte_code))
	@touch $@

# In an environment that is new, kernels are compiled while the libraries of the checks are installed.
$(READY): $(RUNS) requirements.lock
	@$(MAKE) --silent $(COMPILED) >.venv/.compiling 2>&1 & \
	( $(call told,  libraries from requirements.lock,$(call pip_install,requirements.lock)) ) && \
	( $(call told,  byte code,$(byte_code)) ) && touch $@; made=$$?; wait; cat .venv/.compiling; exit $$made

# The live page. Without npm there is none, and everything else works.
$(PAGE): $(WEB)
	@$(call from_debian,npm,nodejs npm)
	@if command -v npm >/dev/null; then \
	printf '%-46s' 'the live page (npm)'; start=$$SECONDS; \
	if out=$$(cd web && npm ci --loglevel=error 2>&1 && npm run --silent build 2>&1); then touch $@; printf 'ok %4d s\n' $$((SECONDS - start)); \
	else printf 'FAILED after %d s, there is no live page\n%s\n' $$((SECONDS - start)) "$$out"; fi; \
	else echo 'npm is missing (Node 20.19 or newer): there is no live page, everything else works'; fi

# The kernels that demo and tests use most, in two processes. What fails here they compile themselves, or say why not.
$(COMPILED): $(RUNS) $(SOURCES)
	@printf '%-46s' 'kernels, compiled meanwhile'; start=$$SECONDS; compiling=; failed=; \
	for group in filter rest; do \
	$(BIN)/python -m towtank.app.demo.warm_up $$group >.venv/.compiling-$$group 2>&1 & compiling="$$compiling $$group:$$!"; done; \
	for each in $$compiling; do wait $${each#*:} || failed="$$failed $${each%:*}"; done; \
	if [ -z "$$failed" ]; then touch $@; printf 'ok %4d s\n' $$((SECONDS - start)); \
	else printf 'FAILED after %d s; they are compiled where they are used\n' $$((SECONDS - start)); \
	for group in $$failed; do tail -n 1 .venv/.compiling-$$group; done; fi

# A browser for the tests of the page, which are skipped without one.
browser:
	@$(call from_debian,chromium,chromium)

lint: $(READY)
	$(call quietly,style (ruff),$(BIN)/ruff check --quiet .)

types: $(READY)
	$(call quietly,types (mypy --strict),$(BIN)/mypy --strict src)

layers: $(READY)
	$(call quietly,layers (import-linter),$(BIN)/lint-imports)

tests: $(READY) parts browser
	@echo 'tests, kernels compiled'
	@$(PYTEST)

kernels: $(READY)
	@echo 'tests of the kernels, as plain Python'
	@NUMBA_DISABLE_JIT=1 $(PYTEST) tests/core tests/planning/test_guard.py tests/planning/test_space.py $(KERNEL_TESTS)

docs: $(READY) $(PAGE)
	$(call quietly,documentation (sphinx),OPENBLAS_NUM_THREADS=1 $(BIN)/sphinx-build --fail-on-warning --keep-going --quiet docs docs/_build/html)

bench: $(READY)
	@$(BIN)/python -m pytest -p no:xdist benchmarks

# Real peers on loopback, each in an environment of its own; the wheels of ROS 2 are for Python 3.11. Only the environments
# of the peers that are named are made.
peers_of = $(if $(PEERS),$(filter $(1),$(PEERS)),$(1))
PEER_ENVIRONMENTS := $(call peers_of,mavsdk) $(if $(call peers_of,ros2)$(call peers_of,dds),ros2) $(call peers_of,dask) $(call peers_of,s3)
peers: $(READY) $(PEER_ENVIRONMENTS:%=.peers/%/.ready)
	@$(BIN)/python benchmarks/peers/run_peers.py $(PEERS)
	@$(if $(PEERS),,$(MAKE) --silent engines)

.peers/mavsdk/.ready:
	$(call quietly,setting up MAVSDK,$(PYTHON) -m venv .peers/mavsdk && .peers/mavsdk/bin/python -m pip install --quiet --disable-pip-version-check mavsdk==4.1.0)
	@touch $@

.peers/ros2/.ready: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || { \
	echo "the wheels of ROS 2 need Python 3.11; '$(PYTHON)' is not. Choose it: make peers PYTHON=python3.11"; exit 1; }
	$(call quietly,setting up ROS 2,$(PYTHON) -m venv .peers/ros2 && .peers/ros2/bin/python -m pip install --quiet --disable-pip-version-check 'ros-rclpy[fastrtps]==9.1.2' ros-nav-msgs==5.5.1 --editable .)
	@touch $@

# towtank itself, with the libraries of the lock, among them dask.distributed.
.peers/dask/.ready: pyproject.toml requirements.lock
	$(call quietly,setting up dask,$(PYTHON) -m venv .peers/dask && .peers/dask/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --requirement requirements.lock && .peers/dask/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .)
	@touch $@

.peers/s3/.ready:
	$(call quietly,setting up an S3 server,$(PYTHON) -m venv .peers/s3 && .peers/s3/bin/python -m pip install --quiet --disable-pip-version-check 'moto[server]==5.2.5')
	@touch $@

# Exported models in the engines that they are for, each in an environment of its own; one that fails does not keep the
# others from running. PVS: the folder src of a clone of the Python Vehicle Simulator, which is on no package index.
ENGINES := fmu dart mujoco casadi control
PACKAGES_fmu := fmpy==0.3.32 libcosimpy==0.0.6 ecospy==0.7.2 tbb==2023.2.0
PACKAGES_dart := dartpy==6.20.0 numpy
PACKAGES_mujoco := mujoco==4.0.0 mujoco-core==4.0.0 mujoco-studio==4.0.0
PACKAGES_casadi := casadi==3.8.2
PACKAGES_control := control==0.10.2
engines: $(READY) $(ENGINES:%=.peers/%/.ready)
	@$(call from_debian,octave-cli,octave)
	@$(call from_debian,clang,clang)
	@failed=; \
	for each in $(ENGINES); do \
	echo; echo "$$each"; \
	$(BIN)/python benchmarks/peers/engines/$${each}_peer.py .peers/$$each/bin/python || failed="$$failed $$each"; done; \
	echo; $(BIN)/python benchmarks/peers/engines/octave_peer.py || failed="$$failed octave"; \
	echo; $(BIN)/python benchmarks/peers/engines/pvs_peer.py $(PVS) || failed="$$failed pvs"; \
	echo; $(BIN)/python -m pytest -q tests/exporters/test_c.py -k compiler || failed="$$failed compilers"; \
	[ -z "$$failed" ] || { echo "failed:$$failed"; exit 1; }

$(ENGINES:%=.peers/%/.ready): .peers/%/.ready:
	$(call quietly,setting up $*,$(PYTHON) -m venv .peers/$* && .peers/$*/bin/python -m pip install --quiet --disable-pip-version-check $(PACKAGES_$*))
	@touch $@

# Resolved for every platform and Python from 3.11 on: everything, and of that what runs. The files name no index, so they
# install from whichever one pip uses.
lock:
	$(call quietly,setting up .lock-venv,$(PYTHON) -m venv .lock-venv && .lock-venv/bin/python -m pip install --quiet --disable-pip-version-check uv)
	$(call quietly,resolving requirements.lock,$(call resolved,requirements.lock,--all-extras --upgrade))
	$(call quietly,resolving requirements-run.lock,$(call resolved,requirements-run.lock,--extra page --constraint requirements.lock --no-annotate))
resolved = .lock-venv/bin/uv pip compile --quiet --universal --python-version 3.11 --fork-strategy fewest --group editable $(2) --generate-hashes --no-emit-index-url --no-header --output-file $(1) pyproject.toml

clean:
	rm -rf .venv .lock-venv .peers web/node_modules src/towtank/dashboard/static build dist docs/_build .benchmarks .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
