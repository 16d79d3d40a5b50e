"""One engine's physics steps per second of wall time, as one JSON object.

    python -m benchmarks.peers.engines native --task hopper --num-envs 2048 --steps 100

`envpool` runs in the peers' environment. Heavy imports are inside the functions, so that each side needs only its own.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from common.errors import ReskpnError

Rollout = Callable[[], None]


def native(task: str, environment: str, num_envs: int, steps: int, cores: int) -> tuple[Rollout, dict[str, str]]:
    """This project's environments: physics, observations, rewards, ends of episodes, new starts."""
    import jax

    from benchmarks.physics import random_actions
    from common.physics.engines import NATIVE, require_synchronous_dispatch
    from common.physics.environments import EnvState, make_environment

    require_synchronous_dispatch()
    env = make_environment(task, NATIVE, num_envs=num_envs, threads=cores)
    actions = random_actions(env, jax.random.key(0), steps)
    run = jax.jit(lambda state, actions: jax.lax.scan(env.step, state, actions)[0])
    state: list[EnvState] = [env.reset(jax.random.key(1))]

    def rollout() -> None:
        state[0] = jax.block_until_ready(run(state[0], actions))

    return rollout, _versions("mujoco", "jax")


def mujoco_rollout(
    task: str, environment: str, num_envs: int, steps: int, cores: int
) -> tuple[Rollout, dict[str, str]]:
    """`mujoco.rollout`: physics alone, from given states under given commands; nothing is observed, ended or reset."""
    import gymnasium
    import mujoco
    from mujoco.rollout import Rollout as Threads

    env: Any = gymnasium.make(environment).unwrapped
    model, substeps = env.model, env.frame_skip
    random = np.random.default_rng(0)
    data = [mujoco.MjData(model) for _ in range(cores)]
    mujoco.mj_resetData(model, data[0])
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data[0], state, full)
    start = np.tile(state, (num_envs, 1))
    low, high = model.actuator_ctrlrange.T
    commands = random.uniform(low, high, (num_envs, steps, model.nu)).repeat(substeps, axis=1)
    threads = Threads(nthread=cores)
    return lambda: _nothing(threads.rollout(model, data, start, commands)), _versions("mujoco")


def envpool(task: str, environment: str, num_envs: int, steps: int, cores: int) -> tuple[Rollout, dict[str, str]]:
    """EnvPool: physics, observations, rewards, ends of episodes, new starts; one call from Python a step."""
    import envpool as pool

    envs = pool.make(environment, env_type="gymnasium", num_envs=num_envs, num_threads=cores)
    envs.reset()
    space = envs.action_space
    shape = (steps, num_envs, *space.shape)
    actions = np.random.default_rng(0).uniform(space.low, space.high, shape)

    def rollout() -> None:
        for action in actions:
            envs.step(action)

    return rollout, _versions("envpool")


ENGINES = {"native": native, "rollout": mujoco_rollout, "envpool": envpool}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers.engines", description=__doc__)
    parser.add_argument("engine", choices=sorted(ENGINES), help="engine")
    parser.add_argument("--task", default="hopper-v5", help="task of this project")
    parser.add_argument("--environment", default="Hopper-v5", help="the same in Gymnasium")
    parser.add_argument("--num-envs", type=int, default=2048, metavar="N", help="environments")
    parser.add_argument("--steps", type=int, default=100, metavar="T", help="steps of each in a rollout")
    parser.add_argument("--repeats", type=int, default=5, metavar="N", help="rollouts that are timed, after one")
    given = parser.parse_args()
    cores = len(os.sched_getaffinity(0))
    try:
        rollout, versions = ENGINES[given.engine](given.task, given.environment, given.num_envs, given.steps, cores)
        rollout()
        times = []
        for _ in range(given.repeats):
            began_s = time.perf_counter()
            rollout()
            times.append(time.perf_counter() - began_s)
    except ReskpnError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    steps_per_s = given.num_envs * given.steps / float(np.median(times))
    print(json.dumps({"steps_per_s": steps_per_s, "versions": versions, "cores": cores}))
    return 0


def _versions(*packages: str) -> dict[str, str]:
    from importlib import metadata

    return {package: metadata.version(package) for package in packages}


def _nothing(_: object) -> None:
    return None


if __name__ == "__main__":
    sys.exit(main())
