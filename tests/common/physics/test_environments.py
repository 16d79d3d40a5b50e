"""What a batch of environments adds to brax's tasks: ends, returns, restarts, and nothing else."""

from __future__ import annotations

import dataclasses
import inspect
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from common.errors import PhysicsError, SettingsError
from common.physics.environments import BatchedEnvironment, EnvState, Transition, make_environment
from common.physics.models import c_model
from common.tasks import EPISODE_LENGTH, TASKS

NO_ACTION = jnp.zeros((4, 1))


def with_bodies(state: EnvState, **fields: jax.Array) -> EnvState:
    """The state with other `q` or `qd`."""
    return dataclasses.replace(state, bodies=dataclasses.replace(state.bodies, **fields))


def tilt(state: EnvState, environment: int, angle: float = 0.5) -> EnvState:
    """The state with one pendulum's pole at `angle`; the task ends an episode beyond 0.2 rad."""
    return with_bodies(state, q=state.bodies.q.at[environment, 1].set(angle))


def steps(env: BatchedEnvironment, state: EnvState, count: int) -> tuple[EnvState, list[Transition]]:
    """The state after `count` steps without action, and all transitions."""
    transitions = []
    for _ in range(count):
        state, transition = env.step(state, jnp.zeros((env.num_envs, env.action_size)))
        transitions.append(transition)
    return state, transitions


def avals(tree: Any) -> list[tuple[tuple[int, ...], Any, bool]]:
    """Shape, dtype and weak type of every leaf: what a compiled function is chosen by."""
    return [(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in jax.tree.leaves(tree)]


@pytest.mark.parametrize("task", TASKS)
def test_a_task_has_the_sizes_that_the_table_says(task: str) -> None:
    """Networks and messages are made from `common.tasks`, without a physics engine; the engine must agree."""
    env = make_environment(task, "native", num_envs=2)
    assert (env.observation_size, env.action_size) == (TASKS[task].observation_size, TASKS[task].action_size)
    assert (env.num_envs, env.physics) == (2, "native")
    state = jax.eval_shape(env.reset, jax.random.key(0))
    action = jax.ShapeDtypeStruct((2, env.action_size), jnp.float32)
    after, transition = jax.eval_shape(env.step, state, action)
    assert avals(after) == avals(state)
    assert not any(weak for _, _, weak in avals((after, transition)))
    assert transition.obs.shape == transition.next_obs.shape == (2, TASKS[task].observation_size)


def test_an_episode_has_the_papers_length_unless_told_otherwise() -> None:
    """1,000 steps."""
    assert inspect.signature(make_environment).parameters["episode_length"].default == EPISODE_LENGTH == 1000


def test_each_environment_starts_somewhere_else(pendulum: BatchedEnvironment) -> None:
    """Every environment draws its first state with its own key, and the same key draws the same states."""
    obs = np.asarray(pendulum.reset(jax.random.key(0)).obs)
    assert len(np.unique(obs, axis=0)) == 4
    np.testing.assert_array_equal(obs, pendulum.reset(jax.random.key(0)).obs)
    assert not np.array_equal(obs, pendulum.reset(jax.random.key(1)).obs)


def test_an_episode_is_truncated_at_its_length(pendulum: BatchedEnvironment) -> None:
    """An upright pole earns 1 a step. Five steps are an episode: truncated with a return of 5, then from the start."""
    first = pendulum.reset(jax.random.key(0))
    state, transitions = steps(pendulum, first, 5)
    for transition in transitions[:4]:
        assert not transition.truncated.any()
        np.testing.assert_array_equal(transition.episode_return, [0, 0, 0, 0])
        np.testing.assert_array_equal(transition.episode_length, [0, 0, 0, 0])
        np.testing.assert_array_equal(transition.next_obs, transition.obs)
    last = transitions[4]
    assert last.truncated.all()
    assert not last.terminated.any()
    np.testing.assert_array_equal(last.episode_return, [5, 5, 5, 5])
    np.testing.assert_array_equal(last.episode_length, [5, 5, 5, 5])
    np.testing.assert_array_equal(last.obs, first.obs)
    assert (last.next_obs != last.obs).any(axis=1).all()
    jax.tree.map(np.testing.assert_array_equal, state, first)


def test_an_end_of_the_task_terminates_that_environment_alone(pendulum: BatchedEnvironment) -> None:
    """A pole pushed over after two steps ends its episode in the third: a return of 3, and the first state again."""
    first = pendulum.reset(jax.random.key(0))
    state, _ = steps(pendulum, first, 2)
    state, (transition,) = steps(pendulum, tilt(state, environment=1), 1)
    np.testing.assert_array_equal(transition.terminated, [False, True, False, False])
    assert not transition.truncated.any()
    np.testing.assert_array_equal(transition.reward, [1, 1, 1, 1])
    np.testing.assert_array_equal(transition.episode_return, [0, 3, 0, 0])
    np.testing.assert_array_equal(transition.episode_length, [0, 3, 0, 0])
    assert transition.next_obs[1, 1] > 0.2
    np.testing.assert_array_equal(transition.obs[1], first.obs[1])
    np.testing.assert_array_equal(transition.obs[::2], transition.next_obs[::2])
    np.testing.assert_array_equal(state.steps, [3, 0, 3, 3])
    np.testing.assert_array_equal(state.episode_return, [3, 0, 3, 3])


def test_the_episodes_of_one_environment_repeat_their_start(pendulum: BatchedEnvironment) -> None:
    """Going back to the first state is exact: the same actions give the same episode again, to the last bit."""
    _, transitions = steps(pendulum, pendulum.reset(jax.random.key(0)), 10)
    for earlier, later in zip(transitions[:5], transitions[5:], strict=True):
        jax.tree.map(np.testing.assert_array_equal, earlier, later)


def test_new_initial_states_are_drawn_for_ended_episodes_alone(pendulum: BatchedEnvironment, task_of: Any) -> None:
    """With a key, episodes that end go on where the task's own reset puts them; the others do not notice."""
    state, _ = steps(pendulum, pendulum.reset(jax.random.key(0)), 1)
    state = tilt(state, environment=1)
    key = jax.random.key(7)
    plain, _ = pendulum.step(state, jnp.zeros((4, 1)))
    after, transition = pendulum.step(state, jnp.zeros((4, 1)), key)
    np.testing.assert_array_equal(transition.terminated, [False, True, False, False])
    # Environment i resets with the i-th of N keys, as `reset` does it.
    drawn = pendulum.reset(key)
    np.testing.assert_array_equal(transition.obs[1], drawn.obs[1])
    np.testing.assert_array_equal(after.bodies.q[1], drawn.bodies.q[1])
    assert (transition.obs[1] != state.first_obs[1]).any()
    others = np.array([0, 2, 3])
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[others], b[others]), after, plain)
    other, _ = pendulum.step(state, jnp.zeros((4, 1)), jax.random.key(8))
    assert (other.obs[1] != after.obs[1]).any()


def test_an_end_at_the_last_step_is_the_tasks_not_the_clocks(pendulum: BatchedEnvironment) -> None:
    """Terminated and truncated exclude each other: what was terminated has no value to bootstrap from."""
    state, _ = steps(pendulum, pendulum.reset(jax.random.key(0)), 4)
    _, (transition,) = steps(pendulum, tilt(state, environment=2), 1)
    np.testing.assert_array_equal(transition.terminated, [False, False, True, False])
    np.testing.assert_array_equal(transition.truncated, [True, True, False, True])


@pytest.mark.parametrize(("field", "value"), [("q", np.nan), ("qd", np.inf), ("qd", 1e30)])
def test_a_simulation_that_diverged_is_ended_and_counted(
    pendulum: BatchedEnvironment, field: str, value: float
) -> None:
    """It ends with reward 0 and the last observation there was; it restarts; its neighbours do not notice."""
    first = pendulum.reset(jax.random.key(0))
    state, (before,) = steps(pendulum, first, 1)
    undisturbed, (expected,) = steps(pendulum, state, 1)
    broken = with_bodies(state, **{field: getattr(state.bodies, field).at[3, 0].set(value)})
    after, (transition,) = steps(pendulum, broken, 1)

    np.testing.assert_array_equal(transition.terminated, [False, False, False, True])
    np.testing.assert_array_equal(transition.reward, [1, 1, 1, 0])
    np.testing.assert_array_equal(transition.episode_return, [0, 0, 0, 1])
    np.testing.assert_array_equal(transition.episode_length, [0, 0, 0, 2])
    np.testing.assert_array_equal(transition.next_obs[3], before.obs[3])
    np.testing.assert_array_equal(transition.obs[3], first.obs[3])
    np.testing.assert_array_equal(after.diverged, [0, 0, 0, 1])
    np.testing.assert_array_equal(transition.obs[:3], expected.obs[:3])
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((after, transition)))
    again, _ = steps(pendulum, after, 1)
    np.testing.assert_array_equal(again.diverged, [0, 0, 0, 1])
    np.testing.assert_array_equal(undisturbed.diverged, [0, 0, 0, 0])


def test_an_action_that_is_not_a_number_ends_the_episode(pendulum: BatchedEnvironment) -> None:
    """A policy's NaN is counted like a simulation's, and goes no further."""
    state = pendulum.reset(jax.random.key(0))
    after, transition = pendulum.step(state, NO_ACTION.at[0].set(jnp.nan))
    np.testing.assert_array_equal(after.diverged, [1, 0, 0, 0])
    np.testing.assert_array_equal(transition.terminated, [True, False, False, False])
    assert np.isfinite(transition.next_obs).all()


def test_actions_are_clipped(hopper: BatchedEnvironment) -> None:
    """Beyond [-1, 1] an action does, and costs, as much as at the border: the hopper pays 0.001 for its square."""
    state = hopper.reset(jax.random.key(0))
    inside = jnp.array([[1.0, -1.0, 0.5]] * 3)
    outside = jnp.array([[7.0, -1.5, 0.5]] * 3)
    jax.tree.map(np.testing.assert_array_equal, hopper.step(state, outside), hopper.step(state, inside))


def test_observation_and_reward_are_the_tasks(hopper: BatchedEnvironment, task_of: Any) -> None:
    """One step of the hopper by hand, from MuJoCo stepped alone.

    Observation: height of the torso (as of the last substep), the other five joints' positions without x, six
    velocities clipped to 10. Reward: 1 for being up, plus x-velocity over 4 steps of 0.002 s, minus 0.001 |a|^2.
    """
    state = hopper.reset(jax.random.key(3))
    action = jnp.array([[0.5, -0.25, 1.0]] * 3)
    _, transition = hopper.step(state, action)
    model = c_model(task_of("hopper"))
    data = mujoco.MjData(model)
    data.qpos, data.qvel, data.ctrl = state.bodies.q[1], state.bodies.qd[1], action[1]
    mujoco.mj_forward(model, data)
    x_before = data.xpos[1, 0]
    for _ in range(4):
        mujoco.mj_step(model, data)
    obs = [data.xpos[1, 2], *data.qpos[2:], *np.clip(data.qvel, -10, 10)]
    reward = 1 + (data.xpos[1, 0] - x_before) / 0.008 - 0.001 * (0.25 + 0.0625 + 1)
    np.testing.assert_allclose(transition.obs[1], obs, atol=1e-6)
    np.testing.assert_allclose(transition.reward[1], reward, atol=1e-4)


def test_a_fallen_hopper_ends_and_its_return_is_the_sum_of_its_rewards(hopper: BatchedEnvironment) -> None:
    """Over the 60 steps in which hoppers without a policy fall, each return is what its rewards add up to."""
    state, total, ended = hopper.reset(jax.random.key(0)), np.zeros(3), np.zeros(3, int)
    for _ in range(60):
        state, transition = hopper.step(state, jnp.ones((3, 3)))
        total += np.asarray(transition.reward)
        for i in np.flatnonzero(transition.terminated):
            np.testing.assert_allclose(transition.episode_return[i], total[i], rtol=1e-5)
            total[i] = 0
        ended += np.asarray(transition.terminated)
    assert (ended > 0).all()


def test_a_scan_gives_what_steps_give(pendulum: BatchedEnvironment) -> None:
    """`step` may stand inside compiled code; the simulation is the same."""
    state = tilt(pendulum.reset(jax.random.key(0)), environment=0, angle=0.15)

    @jax.jit
    def scan(state: EnvState) -> Any:
        return jax.lax.scan(lambda carry, _: pendulum.step(carry, NO_ACTION), state, length=7)

    _, scanned = scan(state)
    _, stepped = steps(pendulum, state, 7)
    jax.tree.map(np.testing.assert_array_equal, scanned, jax.tree.map(lambda *leaves: jnp.stack(leaves), *stepped))


def test_a_step_is_compiled_once(pendulum: BatchedEnvironment) -> None:
    """The state of `reset` and the state of `step` look alike to JAX, so that no second compilation is paid for."""
    compiled = jax.jit(lambda state, action: pendulum.step(state, action))
    state = pendulum.reset(jax.random.key(0))
    for _ in range(3):
        state, _ = compiled(state, NO_ACTION)
    assert compiled._cache_size() == 1


def test_time_in_physics_is_told(pendulum: BatchedEnvironment) -> None:
    """The native engine says how long MuJoCo has run."""
    before = pendulum.physics_seconds()
    assert before is not None
    steps(pendulum, pendulum.reset(jax.random.key(0)), 1)
    assert pendulum.physics_seconds() > before


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"task": "hoper"}, r"'hoper' is not a task; did you mean 'hopper'"),
        ({"physics": "warp"}, r"'warp' is not a physics engine.*auto, mjx, native"),
        ({"num_envs": 0}, "num_envs is 0; it must be at least 1"),
        ({"episode_length": 0}, "episode_length is 0; it must be at least 1"),
        ({"threads": -1}, "threads is -1; it must be at least 0"),
    ],
)
def test_impossible_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    """Each says what was given and what is allowed."""
    with pytest.raises(SettingsError, match=message):
        make_environment(**{"task": "hopper", "physics": "native", "num_envs": 1, **settings})


def test_a_jax_that_could_hang_is_refused_before_anything_is_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    """`make_environment` checks what `require_synchronous_dispatch` prepares."""

    def refuse() -> None:
        raise PhysicsError("started otherwise")

    monkeypatch.setattr("common.physics.environments.require_synchronous_dispatch", refuse)
    monkeypatch.setattr("common.physics.environments.load_task", lambda task: pytest.fail("loaded"))
    with pytest.raises(PhysicsError, match="started otherwise"):
        make_environment("hopper", "native", num_envs=1)
