"""Speed of an engine alone: the product's `native` and `mjx`, and MJX's in Warp where that is installed."""

from __future__ import annotations

import time
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.gpu.cases import WARP
from benchmarks.gpu.rows import plan_of, tell
from benchmarks.physics import speed
from common.physics.engines import require_synchronous_dispatch
from common.physics.environments import make_environment
from common.physics.libraries import mjx
from common.physics.models import c_model, load_task
from common.runtime import enable_compilation_cache

CONTACTS = {"hopper": 8, "humanoid": 24}
"""Contacts of one simulation that there is room for, on average; a hopper has two pairs that can touch the floor."""

ROWS = {"hopper": 48, "humanoid": 160}
"""Rows of constraints of one simulation that there is room for."""


def measure(plan: Mapping[str, Any]) -> None:
    """Tell the one row of this case."""
    task, engine, envs = plan["task"], plan["engine"], plan["sizes"]["num_envs"]
    if engine == WARP:
        found = warp_row(task, envs, plan["steps"], plan["repeats"])
    else:
        timed = speed(make_environment(task, engine, num_envs=envs), plan["steps"], plan["repeats"])
        found = {"steps_s": timed.steps_s, "compile_s": timed.compile_s, "diverged": timed.diverged}
    tell(task=task, engine=engine, envs=envs, **found)


def warp_row(task: str, envs: int, steps: int, repeats: int) -> dict[str, Any]:
    """Environment steps/s of MJX's Warp implementation, without the task's observation, reward and resets."""
    if find_spec("warp") is None:
        return {"note": "not installed: python -m pip install 'mujoco-mjx[warp]'"}
    source = load_task(task)
    model = c_model(source)
    on_device = mjx.put_model(model, impl=WARP)
    substeps = source._n_frames

    def start(key: jax.Array) -> Any:
        data = mjx.make_data(model, impl=WARP, naconmax=envs * CONTACTS[task], njmax=ROWS[task])
        ctrl = jax.random.uniform(key, (model.nu,), minval=-1.0)
        return data.replace(qpos=data.qpos + 0.01 * jax.random.normal(key, (model.nq,)), ctrl=ctrl)

    def step(data: Any, _: None) -> tuple[Any, None]:
        return jax.vmap(mjx.step, in_axes=(None, 0))(on_device, data), None

    data = jax.jit(jax.vmap(start))(jax.random.split(jax.random.key(0), envs))
    began_s = time.perf_counter()
    run = jax.jit(lambda data: jax.lax.scan(step, data, length=steps * substeps)[0])
    data = jax.block_until_ready(run(data))  # Warp compiles its kernels when they are first launched
    compile_s = time.perf_counter() - began_s
    seconds = []
    for _ in range(repeats):
        began_s = time.perf_counter()
        data = jax.block_until_ready(run(data))
        seconds.append(time.perf_counter() - began_s)
    broken = int(np.sum(~np.asarray(jnp.isfinite(data.qpos).all(axis=1))))
    note = "engine alone: no observation, reward or reset"
    return {"steps_s": envs * steps / min(seconds), "compile_s": compile_s, "diverged": broken, "note": note}


if __name__ == "__main__":
    enable_compilation_cache()
    require_synchronous_dispatch()
    measure(plan_of())
