"""The native engine against MuJoCo stepped by hand, and that nothing but its arguments decides its results."""

from __future__ import annotations

import dataclasses
import sys
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from common.errors import PhysicsError
from common.physics.bodies import Bodies
from common.physics.libraries import log_instead_of_printing
from common.physics.models import c_model
from common.physics.native import NativeEngine

N, SUBSTEPS = 8, 4

# Contacts of the box need more memory than the model allows itself, so that MuJoCo raises once it touches the floor.
TOO_LITTLE_MEMORY = """
<mujoco>
  <size memory="6K"/>
  <worldbody>
    <geom type="plane" size="5 5 1"/>
    <body pos="0 0 1">
      <freejoint/>
      <geom type="box" size=".1 .1 .1"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def model(task_of: Any) -> mujoco.MjModel:
    """The hopper: 6 joints, 3 motors, contacts with the floor."""
    return c_model(task_of("hopper"))


class Simulations:
    """An engine's calls on a whole batch, compiled."""

    def __init__(self, model: mujoco.MjModel, substeps: int, num_envs: int, threads: int) -> None:
        engine = NativeEngine(model, substeps, num_envs, threads)
        self.seconds = engine.seconds
        self.reset, self.step = jax.jit(jax.vmap(engine.reset)), jax.jit(jax.vmap(engine.step))


@pytest.fixture(scope="module")
def engine(model: mujoco.MjModel) -> Simulations:
    """Eight hoppers on one thread."""
    return Simulations(model, SUBSTEPS, num_envs=N, threads=1)


def starts(model: mujoco.MjModel, num_envs: int = N) -> tuple[jax.Array, jax.Array]:
    """Positions and velocities of `num_envs` hoppers near their default."""
    random = np.random.default_rng(0)
    q = model.qpos0 + random.uniform(-0.05, 0.05, (num_envs, model.nq))
    return jnp.asarray(q, jnp.float32), jnp.asarray(random.uniform(-1, 1, (num_envs, model.nv)), jnp.float32)


def commands(model: mujoco.MjModel, seed: int) -> jax.Array:
    """Motor commands [N, nu], some of them beyond the limits of the motors."""
    return jnp.asarray(np.random.default_rng(seed).uniform(-2, 2, (N, model.nu)), jnp.float32)


def run(engine: Simulations, model: mujoco.MjModel, steps: int = 5) -> Bodies:
    """The hoppers after `steps` steps."""
    bodies = engine.reset(*starts(model))
    for seed in range(steps):
        bodies = engine.step(bodies, commands(model, seed))
    return bodies


def assert_identical(one: Bodies, other: Bodies) -> None:
    jax.tree.map(np.testing.assert_array_equal, one, other)


def test_a_step_is_mujocos_own_repeated(engine: Simulations, model: mujoco.MjModel) -> None:
    """One step is `mj_step` as often as the task says, to the last bit, with commands limited as MuJoCo limits them."""
    before = run(engine, model)
    after = engine.step(before, commands(model, 9))
    for i in range(N):
        data = mujoco.MjData(model)
        data.qpos, data.qvel, data.qacc_warmstart = before.q[i], before.qd[i], before.warmstart[i]
        data.ctrl = commands(model, 9)[i]
        for _ in range(SUBSTEPS):
            mujoco.mj_step(model, data)
        np.testing.assert_array_equal(after.q[i], data.qpos.astype(np.float32))
        np.testing.assert_array_equal(after.qd[i], data.qvel.astype(np.float32))
        np.testing.assert_array_equal(after.warmstart[i], data.qacc_warmstart.astype(np.float32))
        np.testing.assert_array_equal(after.x.pos[i], data.xpos[1:].astype(np.float32))
        np.testing.assert_array_equal(after.x.rot[i], data.xquat[1:].astype(np.float32))


def test_velocities_are_those_of_the_bodies_frames(engine: Simulations, model: mujoco.MjModel) -> None:
    """`xd` is the velocity of each body's own frame, along the world's axes, as `mj_objectVelocity` gives it."""
    q, qd = starts(model)
    bodies = engine.reset(q, qd)
    data = mujoco.MjData(model)
    data.qpos, data.qvel = q[0], qd[0]
    mujoco.mj_forward(model, data)
    for body in range(1, model.nbody):
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 0)
        np.testing.assert_allclose(bodies.xd.ang[0, body - 1], velocity[:3], atol=1e-5)
        np.testing.assert_allclose(bodies.xd.vel[0, body - 1], velocity[3:], atol=1e-5)


def test_the_same_arguments_give_the_same_results(engine: Simulations, model: mujoco.MjModel) -> None:
    """A call remembers nothing of earlier ones, not even of one in which simulations diverged."""
    before, ctrl = run(engine, model), commands(model, 9)
    first = engine.step(before, ctrl)
    engine.step(dataclasses.replace(before, qd=before.qd * jnp.nan, q=-before.q), -ctrl)
    assert_identical(engine.step(before, ctrl), first)


@pytest.mark.parametrize("threads", [0, 2, 3, 50])
def test_the_number_of_threads_changes_no_result(engine: Simulations, model: mujoco.MjModel, threads: int) -> None:
    """One thread, all cores, more threads than cores or than simulations: the same bits."""
    other = Simulations(model, SUBSTEPS, num_envs=N, threads=threads)
    assert_identical(run(other, model), run(engine, model))


def test_a_simulation_does_not_depend_on_its_neighbours(engine: Simulations, model: mujoco.MjModel) -> None:
    """The first three of eight hoppers move as three hoppers alone do."""
    three = Simulations(model, SUBSTEPS, num_envs=3, threads=2)
    alone = three.reset(*(start[:3] for start in starts(model)))
    alone = three.step(alone, commands(model, 0)[:3])
    together = run(engine, model, steps=1)
    assert_identical(alone, jax.tree.map(lambda leaf: leaf[:3], together))


@pytest.mark.parametrize(("field", "value"), [("q", np.nan), ("q", np.inf), ("qd", -np.inf), ("qd", 1e12)])
def test_a_simulation_that_mujoco_gave_up_is_nan(
    engine: Simulations, model: mujoco.MjModel, field: str, value: float
) -> None:
    """MuJoCo resets such a simulation and goes on with it; here it shows, and it alone."""
    before, ctrl = run(engine, model), commands(model, 9)
    broken = dataclasses.replace(before, **{field: getattr(before, field).at[2, 1].set(value)})
    after = engine.step(broken, ctrl)
    lost = np.array([bool(np.isnan(after.q[i]).all() and np.isnan(after.x.pos[i]).all()) for i in range(N)])
    np.testing.assert_array_equal(lost, np.arange(N) == 2)
    others = [i for i in range(N) if i != 2]
    np.testing.assert_array_equal(after.q[others, :], engine.step(before, ctrl).q[others, :])


def test_a_command_that_is_not_a_number_shows(engine: Simulations, model: mujoco.MjModel) -> None:
    """MuJoCo answers it with no command at all, which a policy would never notice."""
    after = engine.step(run(engine, model), commands(model, 9).at[5, 0].set(jnp.nan))
    np.testing.assert_array_equal(np.isnan(after.q).all(axis=1), np.arange(N) == 5)


def test_a_simulation_in_which_mujoco_raised_is_nan() -> None:
    """An error in some simulations is not an error of the call: they are lost and the others go on."""
    model = mujoco.MjModel.from_xml_string(TOO_LITTLE_MEMORY)
    engine = Simulations(model, 1, num_envs=2, threads=1)
    high, low = [0, 0, 1, 1, 0, 0, 0], [0, 0, 0.05, 1, 0, 0, 0]
    zeros = jnp.zeros((2, model.nv))
    bodies = engine.reset(jnp.array([high, high], jnp.float32), zeros)
    bodies = dataclasses.replace(bodies, q=jnp.array([high, low], jnp.float32))
    after = engine.step(bodies, jnp.zeros((2, 0)))
    np.testing.assert_array_equal(np.isnan(after.q).all(axis=1), [False, True])


# A body that moves freely but for damping: its velocity shrinks by the same factor in every step.
SLIDER = """
<mujoco>
  <option gravity="0 0 0" timestep="0.01"/>
  <worldbody>
    <body>
      <joint type="slide" damping="2"/>
      <geom type="sphere" size=".1" mass="1"/>
    </body>
  </worldbody>
</mujoco>
"""


def test_denormal_numbers_are_treated_alike_on_all_threads() -> None:
    """64 equal simulations on two threads stay equal while they pass the smallest normal float64, 2.2e-308.

    Two simulations side by side on the calling thread and on the batch's own differ there if only one of the threads
    flushes denormals to zero. Float32 states cannot get that small, so the batch is set on the host.
    """
    model = mujoco.MjModel.from_xml_string(SLIDER)
    engine = NativeEngine(model, substeps=1, num_envs=64, threads=2)
    jax.jit(jax.vmap(engine.reset))(jnp.zeros((64, 1)), jnp.zeros((64, 1)))  # makes the batch
    batch = engine._arrays.batch
    found: list[np.ndarray] = []

    def decay(x: Any) -> np.ndarray:
        batch.qpos, batch.qvel = 0.0, 1e-307
        for _ in range(20):
            # 200 steps divide the velocity by (1 + 0.01 * 2) ** 200 = 52 in exact arithmetic: below 2.2e-308.
            batch.step(nstep=10)
            found.append(np.concatenate([batch.qpos, batch.qvel], axis=1))
        return np.zeros(1, np.float32)

    call = jax.jit(lambda x: jax.pure_callback(decay, jax.ShapeDtypeStruct((1,), jnp.float32), x))
    jax.block_until_ready(call(jnp.zeros(1)))
    for states in found:
        np.testing.assert_array_equal(states, np.broadcast_to(states[0], states.shape))


def test_time_in_physics_is_counted(engine: Simulations, model: mujoco.MjModel) -> None:
    """The seconds inside MuJoCo grow with every call, and by no more than the call took."""
    before = engine.seconds()
    run(engine, model, steps=1)
    assert engine.seconds() > before


def test_mujocos_warnings_leave_no_file_behind(
    engine: Simulations, model: mujoco.MjModel, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MuJoCo's own way is a file MUJOCO_LOG.TXT in the current folder; ours is the logger "mujoco"."""
    log_instead_of_printing()
    monkeypatch.chdir(tmp_path)
    bodies = run(engine, model, steps=1)
    engine.step(dataclasses.replace(bodies, q=bodies.q * jnp.nan), commands(model, 0))
    assert list(tmp_path.iterdir()) == []


def test_a_mujoco_without_the_engine_is_named_with_what_to_do(
    model: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An older MuJoCo is an error with two ways out, not an ImportError."""
    monkeypatch.setitem(sys.modules, "mujoco.batch", None)
    with pytest.raises(PhysicsError, match=r"needs MuJoCo's batch engine.*install mujoco 4.*physics 'mjx'"):
        NativeEngine(model, SUBSTEPS, num_envs=1, threads=1)
