"""Functions of JAX as ONNX models: both compute the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import onnxruntime
import pytest
from jax import Array, export

from common.config.settings import RunSettings
from common.kernels import KERNELS
from common.learners import LEARNERS
from common.maths.policy import Policy
from reskpn.export.graph import NotTranslatable
from reskpn.export.policy import clipped
from reskpn.export.translate import to_onnx
from services.worker.policy_reader import PolicyReader

pytestmark = pytest.mark.usefixtures("in_a_hurry")

EXACT = "exact"
POLICIES = [
    *[(learner, EXACT, "gaussian") for learner in LEARNERS],
    *[("reskpn", EXACT, kernel) for kernel in KERNELS if kernel != "gaussian"],
    ("reskpn", "nystrom", "gaussian"),
    ("reskpn", "kmp", "laplacian"),
    ("reskpn", "cluster", "gaussian"),
    ("reskpn", "rff", "gaussian"),
    ("reskpn", "rff", "laplacian"),
    ("reskpn", "basis", "gaussian"),
]
SMALL = {"hidden": (8, 8)}


def bent(policy: Policy) -> Policy:
    """Other numbers in the same arrays, so that every part of the policy shows in its actions."""
    rng = np.random.default_rng(0)
    moved = jax.tree.map(lambda x: x + rng.normal(0.0, 0.3, x.shape).astype(np.float32), policy)
    moments = replace(moved.observations, variance=jnp.abs(moved.observations.variance))
    return replace(moved, observations=moments)


def run(model: Any, **inputs: np.ndarray) -> list[np.ndarray]:
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    found: list[np.ndarray] = session.run(None, inputs)
    return found


@pytest.mark.parametrize(("learner", "representation", "kernel"), POLICIES)
def test_policies_of_every_learner_kernel_and_representation(learner: str, representation: str, kernel: str) -> None:
    """For batches of one, three and forty observations, to 1e-5; some actions are clipped and some are not."""
    rkhs = {"representation": representation, "kernel": kernel, "capacity": 64}
    settings = RunSettings(
        task="hopper", learner=learner, rkhs=rkhs, algorithm=SMALL, num_envs=64, num_steps=8, total_steps=4096, actors=1
    )  # fmt: skip
    reader = PolicyReader(settings)
    policy = bent(reader.initial())

    def act(observation: Array) -> list[Array]:
        return [clipped(reader.mode(policy, observation))]

    (batch,) = export.symbolic_shape("batch")
    inputs = {"observation": jax.ShapeDtypeStruct((batch, 11), jnp.float32)}
    model = to_onnx(act, inputs, ["action"], name="policy")
    observations = np.random.default_rng(1).normal(0.0, 2.0, (40, 11)).astype(np.float32)
    wanted = np.asarray(act(jnp.asarray(observations))[0])
    for count in (1, 3, 40):
        (actions,) = run(model, observation=observations[:count])
        np.testing.assert_allclose(actions, wanted[:count], atol=1e-5, rtol=0)
    assert np.abs(wanted).min() < 1.0


X = np.array([[0.5, -1.5, 2.0], [3.0, 0.25, -0.75]], np.float32)

FUNCTIONS: dict[str, Callable[[Array], Array]] = {
    "powers and roots": lambda x: x**3 + jnp.sqrt(jnp.abs(x)) + jnp.log1p(x * x),
    "angles": lambda x: jnp.sin(x) * jnp.cos(x) + jnp.arctan(x),
    "remainder": lambda x: jnp.remainder(x, 0.7),
    "choice": lambda x: jnp.where(x > 0.0, x, jnp.where(x != -1.5, -x, 7.0)),
    "truth": lambda x: jnp.array([jnp.all(x > -2.0), jnp.any(x > 5.0), jnp.isfinite(x).all()]),
    "bits": lambda x: (x.astype(jnp.int32) & 1) ^ 3,
    "column set": lambda x: x.at[:, 1].set(9.0),
    "number added": lambda x: x.at[1, 2].add(x[0, 0]),
    "columns taken": lambda x: x[:, jnp.array([2, 0, 2])],
    "reversed": lambda x: x[::-1, ::2],
    "products": lambda x: jnp.einsum("ij,kj->ik", x, x) @ x,
    "of three axes": lambda x: jnp.einsum("bij,bjk->bik", jnp.stack([x, 2 * x]), jnp.stack([x.T, x.T])),
    "outer product": lambda x: jnp.outer(x[0], x[1]),
    "greatest": lambda x: jnp.max(x, axis=0) - jnp.min(x),
    "joined": lambda x: jnp.concatenate([x, jnp.zeros((1, 3)), jnp.tile(x, (2, 1))]),
    "broadcast then reduced": lambda x: jnp.sum(jnp.broadcast_to(x[:1], (4, 3)), axis=0),
    "a constant": lambda x: jnp.arange(3.0) * 2.0,
    "compiled inside": jax.jit(lambda x: jax.nn.relu(jnp.clip(x, -1.0, 1.0))),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_operations_of_tasks(name: str) -> None:
    """What observations and rewards are made of."""
    function = FUNCTIONS[name]
    model = to_onnx(lambda x: [function(x)], {"x": jax.ShapeDtypeStruct(X.shape, jnp.float32)}, ["y"], name="f")
    np.testing.assert_allclose(run(model, x=X)[0], np.asarray(function(jnp.asarray(X))), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("function", "reason"),
    [
        (lambda x: jax.lax.while_loop(lambda y: jnp.sum(y) < 9.0, lambda y: y * 2.0, x), "the operation while"),
        (lambda x: x[:, jnp.argmax(x[0])], "the operation argmax"),
        (lambda x: x.at[jnp.array([0, 0]), 0].add(x[:, 0]), "several numbers added at one place"),
    ],
)
def test_what_has_no_translation(function: Callable[[Array], Array], reason: str) -> None:
    """The operation is named."""
    with pytest.raises(NotTranslatable, match=reason):
        to_onnx(lambda x: [function(jnp.abs(x))], {"x": jax.ShapeDtypeStruct(X.shape, jnp.float32)}, ["y"], name="f")
