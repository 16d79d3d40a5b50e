# `make train` and `make test` do all their set-up; see README.md.
PYTHON ?= python3.11
BIN := .venv/bin

TASK ?= inverted_pendulum
LEARNER ?= reskpn
STEPS ?=
ACTORS ?= 2
SEED ?= 0
PHYSICS ?= auto
ARGS ?=
UPDATE_ARGS ?=
DEVICE ?= gpu
GPU_ARGS ?=
PEERS_ARGS ?=
# It balances for whole episodes after 4e5 steps.
INVERTED_PENDULUM := --total-steps 6e5
CHAOS_POINTS ?= 20
CHAOS_SEED ?=

.PHONY: help setup train test test-runs test-docs test-install test-chaos test-docker test-hosts test-pages lint bench bench-compare bench-gpu bench-peers paper-smoke peers race-smoke check-statistics lock lock-peers clean

help:  ## what can be made
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 16

setup: .venv/.ready  ## the virtual environment .venv with everything in it

.venv/.ready: requirements/dev.txt pyproject.toml scripts/setup.sh
	@PYTHON=$(PYTHON) sh scripts/setup.sh
	@touch $@

train: setup  ## train; TASK=hopper LEARNER=ppo STEPS=3e6 ACTORS=1 SEED=0 PHYSICS=auto ARGS="--help"
	@$(BIN)/reskpn train --task $(TASK) --learner $(LEARNER) --actors $(ACTORS) --seed $(SEED) --physics $(PHYSICS) \
		$(if $(filter inverted_pendulum,$(TASK)),$(INVERTED_PENDULUM)) $(if $(STEPS),--total-steps $(STEPS)) $(ARGS)

test: setup  ## all tests that fit in a few minutes
	@$(BIN)/python -m pytest -n 2 --dist loadfile

test-runs: setup  ## whole runs: twice with one seed, async, an actor or the learner killed, Ctrl-C
	@$(BIN)/python -m pytest tests/whole_runs -p no:randomly -rA --tb=short

test-docs: setup  ## every reskpn command of README and docs, typed page by page with small sizes
	@$(BIN)/python -m pytest tests/documents_run -p no:randomly -rA --tb=short

test-docker: setup  ## docker-compose.yml for real: build, run, kill, scale; says so where it cannot be run here
	@$(BIN)/python -m scripts.docker_test || [ $$? = 77 ]

test-hosts: setup  ## learner, actors, a viewer and an outsider on hosts of their own (network namespaces; needs root)
	@$(BIN)/python -m pytest tests/hosts -p no:randomly -rA --tb=short --timeout 400

test-install: setup  ## the wheel in an empty environment: train, export and play beside a user's own `common` and `services`
	@$(BIN)/python -m pytest tests/install -p no:randomly --tb=short --timeout 900

test-chaos: setup  ## kill -9 at random and at the worst moments, hostile messages, slow and full disks; CHAOS_POINTS=20, CHAOS_SEED=n to repeat
	@CHAOS_POINTS=$(CHAOS_POINTS) CHAOS_SEED=$(or $(CHAOS_SEED),$$(date +%s)) \
		$(BIN)/python -m pytest tests/chaos -n 2 --dist worksteal -p no:randomly -rfE --tb=short

test-pages: setup  ## the live page in headless Chromium, light and dark, wide and narrow; says so where there is none
	@$(BIN)/python -m pytest tests/pages -p no:randomly --tb=short

lint: setup  ## style, types and import rules
	@$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy && $(BIN)/lint-imports

bench: setup  ## speed of the service, where the time goes, and what the RKHS part costs; ARGS="--task humanoid" UPDATE_ARGS="--only rff"
	@$(BIN)/python -m benchmarks.service $(ARGS)
	@$(BIN)/python -m benchmarks.update $(UPDATE_ARGS)

bench-compare: setup  ## what became slower than the committed results, by ratios within one run
	@$(BIN)/python -m benchmarks.regressions $(ARGS)

bench-gpu: setup  ## physics, updates and runs on a GPU, in under 8 minutes; DEVICE=cpu tries every case small; GPU_ARGS="--only service"
	@$(BIN)/python -m benchmarks.gpu --device $(DEVICE) $(GPU_ARGS)

PEERS := build/peers/.venv

peers: $(PEERS)/.ready  ## the peers (SB3, SBX, EnvPool, rsl_rl, PyTorch) in an environment of their own, build/peers/.venv: 3 GB

$(PEERS)/.ready: benchmarks/peers/requirements.txt benchmarks/peers/zoo.txt benchmarks/peers/requirements.in
	@echo "peers: installing the pinned peers in $(PEERS) (some minutes)"
	@$(PYTHON) -m venv $(PEERS)
	@$(PEERS)/bin/python -m pip install -q --disable-pip-version-check $$(grep '^torch==' benchmarks/peers/requirements.in)
	@$(PEERS)/bin/python -m pip install -q --disable-pip-version-check --no-deps --require-hashes \
		-r benchmarks/peers/requirements.txt -r benchmarks/peers/zoo.txt
	@touch $@

race-smoke: setup peers  ## each entrant of the race for half a minute, and the table: whether all of it works
	@$(BIN)/python -m benchmarks.race --smoke --seeds 0 --entrants default reference sb3 sbx
	@$(BIN)/python -m benchmarks.race.draw --results build/race-smoke --out build/race-smoke/drawn

bench-peers: setup peers  ## physics and training beside EnvPool, mujoco.rollout, Brax, SB3, SBX and rsl_rl; hours; PEERS_ARGS="--smoke" for minutes
	@$(BIN)/python -m benchmarks.peers $(PEERS_ARGS)

RLIABLE := build/rliable/.venv

check-statistics: setup $(RLIABLE)/.ready  ## the study's statistics beside rliable's, in an environment of its own
	@$(BIN)/python -m benchmarks.statistics

$(RLIABLE)/.ready: benchmarks/statistics/requirements.txt
	@$(PYTHON) -m venv $(RLIABLE)
	@$(RLIABLE)/bin/python -m pip install -q --disable-pip-version-check --no-deps --require-hashes -r benchmarks/statistics/requirements.txt
	@touch $@

# Most of its time is XLA's: without optimisation and fusion emitters it is half.
QUICK_COMPILER := JAX_DISABLE_MOST_OPTIMIZATIONS=1 \
	XLA_FLAGS="--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"

paper-smoke: setup  ## every experiment of the paper, very small, run and drawn: whether all of it works, in a few minutes
	@rm -rf build/paper-smoke
	@$(QUICK_COMPILER) $(BIN)/reskpn paper run --scale smoke --warm --jobs 2 --results build/paper-smoke/results
	@$(BIN)/reskpn paper draw --scale smoke --results build/paper-smoke/results --out build/paper-smoke/drawn

LOCK_PEERS := --python-version 3.11 --python-platform x86_64-unknown-linux-gnu --generate-hashes --no-emit-index-url --no-header --no-annotate

lock: COMPILE := $(BIN)/uv pip compile -q --python-version 3.11 --universal --generate-hashes --no-emit-index-url --no-header
lock:  ## pin the requirements anew
	@$(COMPILE) pyproject.toml -o requirements/run.txt
	@$(COMPILE) --extra dev -c requirements/run.txt pyproject.toml -o requirements/dev.txt
	@$(COMPILE) --extra cuda -c requirements/run.txt pyproject.toml -o requirements/cuda.txt
	@$(COMPILE) --extra tensorboard -c requirements/run.txt pyproject.toml -o requirements/tensorboard.txt
	@printf 'setuptools\nwheel\n' | $(COMPILE) -c requirements/dev.txt - -o requirements/build.txt

lock-peers:  ## pin the peers anew; torch and what its CUDA build brings are left out
	@$(BIN)/uv pip compile -q $(LOCK_PEERS) -c requirements/run.txt pyproject.toml benchmarks/peers/requirements.in \
		-o benchmarks/peers/all.txt
	@$(BIN)/uv pip compile -q $(LOCK_PEERS) -c requirements/run.txt pyproject.toml benchmarks/peers/requirements.in \
		$$(grep -oE '^(nvidia|cuda|triton|torch)[a-z0-9-]*==' benchmarks/peers/all.txt | sed 's/==//; s/^/--no-emit-package /') \
		-o benchmarks/peers/requirements.txt
	@$(BIN)/uv pip compile -q $(LOCK_PEERS) --no-deps benchmarks/peers/zoo.in -o benchmarks/peers/zoo.txt
	@rm benchmarks/peers/all.txt
	@$(BIN)/uv pip compile -q $(LOCK_PEERS) benchmarks/statistics/requirements.in -o benchmarks/statistics/requirements.txt

clean:  ## remove the environment and caches, not the runs
	@rm -rf .venv .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
