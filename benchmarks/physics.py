"""The speed of the physics engines and the agreement between them: the tables of docs/physics.md.

    python -m benchmarks.physics --tasks hopper --physics native --num-envs 2048
    python -m benchmarks.physics --tasks hopper humanoid --bare
    python -m benchmarks.physics --tasks hopper --agreement

Prints Markdown. Speed is the fastest of several rollouts with random actions, after one for warm-up; the machine should
otherwise be idle. Steps per second of CPU time (of all threads together) are less sensitive to other load; times the
number of cores, they approach the speed of an idle machine. Compiling MJX on a CPU takes about half a minute per task.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from mujoco.batch import Batch

from benchmarks.machine import describe, machine
from common.cores import usable_cores
from common.errors import ReskpnError
from common.physics.engines import MJX, NATIVE, PHYSICS, require_synchronous_dispatch
from common.physics.environments import BatchedEnvironment, EnvState, Transition, make_environment
from common.physics.models import c_model, load_task
from common.tasks import TASKS

BARE_KEY = 99

MARKS = (1, 10, 50, 100)
"""Numbers of steps after which the drift between the engines is reported."""


@dataclass(frozen=True)
class Speed:
    """Environment steps for a second of time and for one of CPU time; `share` of the time spent in the engine, or
    None if not known."""

    compile_s: float
    steps_s: float
    steps_cpu_s: float
    share: float | None
    diverged: int


def random_actions(env: BatchedEnvironment, key: jax.Array, steps: int) -> jax.Array:
    """Uniform in [-1, 1]: [T, N, A]."""
    return jax.random.uniform(key, (steps, env.num_envs, env.action_size), minval=-1.0)


def speed(env: BatchedEnvironment, steps: int, repeats: int) -> Speed:
    """Time `repeats` rollouts of `steps` steps each; returns the fastest."""

    @jax.jit
    def rollout(state: EnvState, key: jax.Array) -> EnvState:
        state, _ = jax.lax.scan(env.step, state, random_actions(env, key, steps))
        return state

    state = env.reset(jax.random.key(0))
    began_s = time.perf_counter()
    run = rollout.lower(state, jax.random.key(0)).compile()
    compile_s = time.perf_counter() - began_s
    state = jax.block_until_ready(run(state, jax.random.key(1)))
    times = []
    for repeat in range(repeats):
        before = clocks(env)
        state = jax.block_until_ready(run(state, jax.random.key(2 + repeat)))
        times.append(clocks(env) - before)
    seconds, _, engine_s = min(times, key=lambda taken: taken[0])
    cpu_s = min(taken[1] for taken in times)
    total = env.num_envs * steps
    share = None if np.isnan(engine_s) else engine_s / seconds
    return Speed(compile_s, total / seconds, total / cpu_s, share, int(state.diverged.sum()))


def clocks(env: BatchedEnvironment) -> np.ndarray:
    """[3] seconds: wall clock, CPU time of this process, time in the engine (NaN if unknown)."""
    engine_s = env.physics_seconds()
    return np.array([time.perf_counter(), time.process_time(), np.nan if engine_s is None else engine_s])


def speed_table(options: argparse.Namespace) -> Iterator[str]:
    """One row per task and engine."""
    yield "| task | physics | envs | env steps/s | per CPU second | time in the engine | compiling | diverged |"
    yield "|---|---|---|---|---|---|---|---|"
    for task in options.tasks:
        for physics in options.physics:
            env = make_environment(task, physics, num_envs=options.num_envs, threads=options.threads)
            found = speed(env, options.steps, options.repeats)
            share = "" if found.share is None else f"{found.share:.0%}"
            yield (
                f"| {task} | {env.physics} | {env.num_envs} | {found.steps_s:,.0f} "
                f"| {found.steps_cpu_s:,.0f} | {share} | {found.compile_s:.0f} s | {found.diverged} |"
            )


def bare_ratio(task: str, options: argparse.Namespace) -> tuple[float, float, float]:
    """Environment steps/s of the native engine and of `mujoco.batch` alone, and the median ratio over the rounds.

    In each round both make the same rollout in turn: the batch starts from the environments' states and is given the
    same commands. It resets nothing, so that its simulations differ from the environments' after an episode has ended.
    """
    env = make_environment(task, NATIVE, num_envs=options.num_envs, threads=options.threads)
    source = load_task(task)
    batch = Batch(c_model(source), options.num_envs, min(options.threads or usable_cores(), options.num_envs))
    rollout = jax.jit(lambda state, actions: jax.lax.scan(env.step, state, actions)[0])
    state = env.reset(jax.random.key(0))
    total, rounds = env.num_envs * options.steps, []
    for number in range(options.repeats + 1):
        actions = random_actions(env, jax.random.key(BARE_KEY + number), options.steps)
        commands = np.asarray(commands_of(source, actions), np.float64)
        bare_s = bare_seconds(batch, state, commands, source._n_frames)
        began_s = time.perf_counter()
        state = jax.block_until_ready(rollout(state, actions))
        rounds.append((time.perf_counter() - began_s, bare_s))
    own, bare = np.array(rounds[1:]).T  # the first round compiles
    return total / float(np.median(own)), total / float(np.median(bare)), float(np.median(bare / own))


def bare_seconds(batch: Batch, state: EnvState, commands: np.ndarray, substeps: int) -> float:
    """Seconds in which the batch makes the steps under `commands` [T, N, nu] from the environments' states."""
    batch.qpos, batch.qvel = np.asarray(state.bodies.q), np.asarray(state.bodies.qd)
    batch.qacc_warmstart = np.asarray(state.bodies.warmstart)
    began_s = time.perf_counter()
    for command in commands:
        batch.ctrl = command
        batch.step(nstep=substeps)
    return time.perf_counter() - began_s


def commands_of(source: Any, actions: jax.Array) -> jax.Array:
    """The actuator commands [T, N, nu] for actions [T, N, A], scaled to the actuators' range as brax's tasks do."""
    low, high = source.sys.actuator.ctrl_range.T
    return (actions + 1) * (high - low) * 0.5 + low


def bare_table(options: argparse.Namespace) -> Iterator[str]:
    """One row per task: the native engine in the product beside MuJoCo's batch alone."""
    yield "| task | envs | native, env steps/s | mujoco.batch alone | ratio, median of rounds |"
    yield "|---|---|---|---|---|"
    for task in options.tasks:
        own, bare, ratio = bare_ratio(task, options)
        yield f"| {task} | {options.num_envs} | {own:,.0f} | {bare:,.0f} | {ratio:.2f} |"


def drift(native: BatchedEnvironment, mjx: BatchedEnvironment, actions: jax.Array) -> Iterator[tuple[int, np.ndarray]]:
    """Both engines from one start under the same actions; at each of `MARKS`: the largest difference in the
    observation of each environment [n], for those that are still in their first episode with both."""
    ours = theirs = native.reset(jax.random.key(0))
    alive = np.ones(native.num_envs, bool)
    for step, action in enumerate(actions, start=1):
        ours, by_native = native.step(ours, action)
        theirs, by_mjx = mjx.step(theirs, action)
        if step in MARKS:
            yield step, difference(by_native, by_mjx)[alive]
        for transition in (by_native, by_mjx):
            alive &= ~np.asarray(transition.terminated | transition.truncated)


def single_steps(native: BatchedEnvironment, mjx: BatchedEnvironment, actions: jax.Array) -> np.ndarray:
    """The difference [T * N] after one step from the same state, along a trajectory of the native engine."""
    state, found = native.reset(jax.random.key(0)), []
    for action in actions:
        _, by_mjx = mjx.step(state, action)
        state, by_native = native.step(state, action)
        found.append(difference(by_native, by_mjx))
    return np.concatenate(found)


def difference(one: Transition, other: Transition) -> np.ndarray:
    """[N], the largest over the components of an observation."""
    return np.asarray(jnp.abs(one.next_obs - other.next_obs).max(axis=1))


def agreement_table(options: argparse.Namespace) -> Iterator[str]:
    """One row per task: drift over time, and the error of single steps."""
    marks = " | ".join(f"after {mark}" for mark in MARKS)
    yield f"| task | {marks} | one step, median | one step, 99% | one step, largest |"
    yield "|---" * (len(MARKS) + 4) + "|"
    for task in options.tasks:
        native = make_environment(task, NATIVE, num_envs=options.num_envs)
        mjx = make_environment(task, MJX, num_envs=options.num_envs)
        actions = random_actions(native, jax.random.key(1), MARKS[-1])
        drifts = [
            f"{np.median(found):.0e} / {found.max():.0e} ({len(found)})" if len(found) else "(0)"
            for _, found in drift(native, mjx, actions)
        ]
        errors = single_steps(native, mjx, actions)
        single = [np.median(errors), np.quantile(errors, 0.99), errors.max()]
        yield f"| {task} | {' | '.join(drifts)} | {' | '.join(f'{error:.0e}' for error in single)} |"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=list(TASKS), metavar="TASK", help="default: all eight")
    parser.add_argument("--physics", nargs="+", default=["auto"], choices=PHYSICS)
    parser.add_argument("--num-envs", type=int, default=None, help="default: 2048 for speed, 64 for agreement")
    parser.add_argument("--threads", type=int, default=0, help="of the native engine; 0: one for each core")
    parser.add_argument("--steps", type=int, default=10, help="steps in a rollout")
    parser.add_argument("--repeats", type=int, default=10, help="rollouts that are timed")
    parser.add_argument("--bare", action="store_true", help="compare the native engine with mujoco.batch alone")
    parser.add_argument("--agreement", action="store_true", help="compare the engines instead of timing them")
    options = parser.parse_args(arguments)
    options.num_envs = options.num_envs or (64 if options.agreement else 2048)
    try:
        require_synchronous_dispatch()
        for line in describe(machine()):
            print(line)
        print()
        table = agreement_table if options.agreement else bare_table if options.bare else speed_table
        for line in table(options):
            print(line, flush=True)
    except ReskpnError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
