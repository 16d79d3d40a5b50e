"""Checks of JAX and the physics engines. Imports are inside the checks, since a failing import is a finding."""

from __future__ import annotations

import time

from common.config.settings import RunSettings
from common.printable import printable
from reskpn.doctor.findings import Finding

TASK = "inverted_pendulum"
STEPPED = 4
"""Environments of the trial step."""


def check_jax() -> Finding:
    """Start JAX and name its devices."""
    from common.physics.engines import require_synchronous_dispatch

    require_synchronous_dispatch()
    import jax

    devices = jax.devices()
    kinds = sorted({device.device_kind for device in devices})
    text = f"{jax.__version__} on {len(devices)} {jax.default_backend()} ({printable(', '.join(kinds))})"
    return Finding("jax", "ok", text, figures={"devices": float(len(devices))})


def check_native() -> Finding:
    """Take a step of a small task with MuJoCo's C engine."""
    seconds = step_once("native")
    return Finding("native", "ok", f"steps {TASK} (first step {seconds:.1f} s)", figures={"first_step_s": seconds})


def check_mjx(*, full: bool) -> Finding:
    """Import MJX; with `full` also compile and take a step, which may take a minute."""
    if not full:
        from common.physics import libraries

        return Finding("mjx", "ok", f"{libraries.mjx.__name__} can be imported; --full also compiles a step")
    seconds = step_once("mjx")
    return Finding("mjx", "ok", f"steps {TASK} (first step {seconds:.1f} s)", figures={"first_step_s": seconds})


def step_once(physics: str) -> float:
    """Seconds to reset a few environments and step them once; PhysicsError if they do not move plausibly."""
    import jax
    import jax.numpy as jnp

    from common.errors import PhysicsError
    from common.physics.environments import make_environment
    from common.tasks import TASKS

    began_s = time.perf_counter()
    environment = make_environment(TASK, physics, num_envs=STEPPED)

    def one(key: jax.Array) -> tuple[jax.Array, jax.Array]:
        state = environment.reset(key)
        after, _ = environment.step(state, jnp.ones((STEPPED, TASKS[TASK].action_size), jnp.float32))
        return state.obs, after.obs

    before, after = jax.device_get(jax.jit(one)(jax.random.key(0)))
    finite = bool(abs(after).max() < 1e6)  # false for NaN, too
    if not finite or bool((before == after).all()):
        raise PhysicsError(f"physics '{physics}' gives no plausible motion; reinstall mujoco and brax")
    return time.perf_counter() - began_s


def state_sizes(settings: RunSettings) -> tuple[int, int]:
    """Bytes of the arrays of a policy, and of the whole state, of a run with these settings."""
    from services.learner.training.trainer import Trainer

    trainer = Trainer(settings)
    policy, state = trainer.policy_arrays(), trainer.state_arrays()
    return sum(array.nbytes for array in policy.values()), sum(array.nbytes for array in state.values())
