"""Factors of model fields: each environment has its own, which its simulation feels and its state carries."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from common.config.settings import RunSettings
from common.config.sources import load
from common.errors import SettingsError
from common.maths.trees import from_arrays, to_arrays
from common.physics.bodies import FrameLayout
from common.physics.environments import make_environment
from common.physics.native import NativeEngine
from common.physics.randomisation import DRAW, draw, scaled_fields
from common.physics.state_shapes import state_shapes
from common.tasks import TASKS

SLIDER = """
<mujoco><option gravity="0 0 0" timestep="0.01"/><worldbody><body>
  <joint name="x" type="slide" axis="1 0 0" damping="3"/><geom size=".1" mass="2" friction=".5 .1 .2"/>
</body></worldbody><actuator><position joint="x" kp="5"/></actuator></mujoco>"""


def step(scales: dict[str, float], velocity: float = 0.0, ctrl: float = 1.0) -> float:
    """The velocity of the slider after a step of 10 ms from position 0."""
    model = mujoco.MjModel.from_xml_string(SLIDER)
    engine = NativeEngine(model, 1, 1, 1, FrameLayout(model))
    factors = {name: jnp.full(1, value) for name, value in scales.items()}
    first = jax.vmap(engine.reset)(jnp.zeros((1, 1)), jnp.full((1, 1), velocity), factors)
    return float(jax.vmap(engine.step)(first, jnp.full((1, 1), ctrl)).qd[0, 0])


@pytest.mark.parametrize(
    ("scales", "velocity", "ctrl", "expected"),
    [
        # A force of kp * ctrl = 5 on 2 kg for 0.01 s.
        ({}, 0.0, 1.0, 0.025 / (1 + 0.015)),
        ({"mass": 2.0}, 0.0, 1.0, 0.0125 / (1 + 0.0075)),
        ({"gain": 3.0}, 0.0, 1.0, 0.075 / (1 + 0.015)),
        # Damping 3 is integrated implicitly: v / (1 + dt d / m).
        ({}, 1.0, 0.0, 1 / (1 + 0.015)),
        ({"damping": 2.0}, 1.0, 0.0, 1 / (1 + 0.03)),
        ({"damping": 2.0, "mass": 2.0}, 1.0, 0.0, 1 / (1 + 0.015)),
    ],
)
def test_a_factor_is_felt(scales: dict[str, float], velocity: float, ctrl: float, expected: float) -> None:
    """By the native engine, as worked out by hand for a slider."""
    assert step(scales, velocity, ctrl) == pytest.approx(expected, rel=1e-5)


def test_the_fields_that_a_factor_changes() -> None:
    """Friction is the sliding one alone; a servo's bias follows its gain; with masses, what derives from them."""
    model = mujoco.MjModel.from_xml_string(SLIDER)
    factors = {"friction": np.array([2.0]), "gain": np.array([3.0]), "mass": np.array([4.0])}
    fields = {name: values[0] for name, values in scaled_fields(model, factors, np)}
    assert fields["geom_friction"][0].tolist() == [1.0, 0.1, 0.2]
    assert (fields["actuator_gainprm"][0, 0], fields["actuator_biasprm"][0, 1]) == (15.0, -15.0)
    assert (fields["body_mass"][1], fields["body_subtreemass"][0]) == (8.0, 8.0)
    assert fields["dof_invweight0"][0] == pytest.approx(1 / 8)


def test_constants_that_derive_from_masses_are_mujocos_own() -> None:
    """As `mj_setConst` computes them for a model with other masses."""
    model, other = (mujoco.MjModel.from_xml_string(SLIDER) for _ in range(2))
    other.body_mass *= 4
    other.body_inertia *= 4
    mujoco.mj_setConst(other, mujoco.MjData(other))
    for name, values in scaled_fields(model, {"mass": np.array([4.0])}, np):
        np.testing.assert_allclose(values[0], getattr(other, name), err_msg=name)


def test_factors_are_in_their_ranges_and_follow_from_the_key() -> None:
    """Each environment has its own; each name has its own stream; a range alone does not move another's."""
    ranges = {"mass": (0.8, 1.2), "damping": (0.5, 0.6)}
    one, again = draw(jax.random.key(3), ranges, 64), draw(jax.random.key(3), {"damping": (0.5, 0.6)}, 64)
    assert set(one) == {"mass", "damping"}
    assert float(one["mass"].min()) >= 0.8
    assert float(one["mass"].max()) <= 1.2
    assert len(np.unique(one["mass"])) == 64
    np.testing.assert_array_equal(one["damping"], again["damping"])
    assert DRAW


def test_environments_keep_their_factors_in_their_state() -> None:
    """Through steps and ends of episodes; the state's arrays are as announced, and start the same future again."""
    ranges = {"mass": (0.5, 2.0), "gain": (0.5, 2.0)}
    environment = make_environment(
        "inverted_pendulum", "native", num_envs=3, threads=1, episode_length=2, randomised=ranges
    )
    first = environment.reset(jax.random.key(1))
    found = {path: (array.dtype.name, array.shape) for path, array in to_arrays(first).items()}
    assert found == state_shapes(TASKS["inverted_pendulum"], 3, ranges)
    action = jnp.full((3, 1), 0.1)
    state, _ = environment.step(first, action)
    kept = from_arrays(state, to_arrays(state))
    after, ended = environment.step(state, action, jax.random.key(2))
    assert ended.truncated.all()
    for name in ranges:
        np.testing.assert_array_equal(after.bodies.scales[name], first.bodies.scales[name])
    again, _ = environment.step(kept, action, jax.random.key(2))
    jax.tree.map(np.testing.assert_array_equal, after, again)


def test_without_ranges_the_state_has_no_factors(pendulum: Any) -> None:
    """As before there were any: the same arrays, and so the same bits."""
    assert not any("scales" in path for path in to_arrays(pendulum.reset(jax.random.key(0))))


def test_ranges_are_settings() -> None:
    """Of the file, the environment or the command line; off, they are not even written."""
    settings = load(environment={"RESKPN_RANDOMISATION__MASS": "0.8,1.2"})
    assert settings.randomisation.ranges() == {"mass": (0.8, 1.2)}
    assert "randomisation" not in RunSettings().model_dump()
    for wrong, sentence in (("1.2,0.8", "write 0.8,1.2"), ("1", "randomisation.mass"), ("0,1", "randomisation.mass")):
        with pytest.raises(SettingsError, match=sentence):
            load(environment={"RESKPN_RANDOMISATION__MASS": wrong})
