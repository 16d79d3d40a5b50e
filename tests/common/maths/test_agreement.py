"""How far a kernel step goes by what its batch agrees on, and where its gradient does not flow."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pydantic import ValidationError
from small_learners import probe_learner, random_batch, same_bits, small_learner
from test_step_size import NO_PAIRS, functional, transitions

from common.config.settings import RunSettings
from common.maths import trees
from common.maths.agreement import squared_cosine


def agreement(phi: list[list[float]], alpha: list[float]) -> float:
    return float(squared_cosine(jnp.asarray(phi, jnp.float32), jnp.asarray(alpha, jnp.float32)[:, None]))


def test_squared_cosine_by_hand() -> None:
    """Even rows sum to (2, 0), odd ones to (1, 1): cos = 2 / (2 sqrt 2), cos^2 = 1/2."""
    assert agreement([[1, 0], [1, 1], [1, 0], [0, 0]], [1, 1, 1, 1]) == pytest.approx(0.5, rel=1e-6)


def test_halves_that_contradict_each_other_leave_no_step() -> None:
    """(1, 0) against (-1, 1) points apart: 0, not the square of a negative number. A gradient of zero is 0 as well."""
    assert agreement([[1, 0], [1, -1]], [1, -1]) == 0.0
    assert agreement([[1, 0], [1, 0]], [0, 0]) == 0.0


def test_the_step_spends_the_target_times_the_squared_cosine() -> None:
    """KL(s v) = s^2 KL(v): with the agreement s is that of the whole target times the cosine."""
    rkhs: dict[str, Any] = {"representation": "rff", "capacity": 16, "samples": "batch", "step": "trust-region"}

    def step(**changes: Any) -> tuple[Any, Any]:
        functional_step, state = functional(**rkhs, **changes)
        function, _, metrics = jax.jit(functional_step)(
            state.expansion,
            state.representation_state,
            state.parameters["policy"],
            transitions(0),
            NO_PAIRS,
            jax.random.key(0),
        )
        return function.weights, metrics

    whole, _ = step()
    scaled, metrics = step(agreement=True)
    assert 0.0 < metrics["rkhs/agreement"] < 1.0
    np.testing.assert_allclose(scaled, np.sqrt(metrics["rkhs/agreement"]) * whole, rtol=1e-4)


@pytest.mark.parametrize(
    "rkhs",
    [
        {"representation": "rff", "samples": "batch"},
        {"representation": "exact", "samples": 4, "step": "trust-region"},
        {"representation": "rff", "samples": 1, "step": "trust-region"},
    ],
)
def test_agreement_needs_what_it_scales(rkhs: dict[str, Any]) -> None:
    """A fixed step, functions that are not orthonormal and a single transition are refused with a sentence."""
    with pytest.raises(ValidationError, match=r"rkhs\.agreement scales kl_target"):
        RunSettings.model_validate({"rkhs": rkhs | {"agreement": True}})


def test_without_feature_gradient_h_is_a_constant_to_the_networks() -> None:
    """With h = 0 its derivative alone is missing, and it is 0: the networks move as before. With h they move elsewhere,
    while those of the critic move alike up to the clip of the joint norm, which is off here."""
    settings = probe_learner("reskpn").settings
    algorithm = settings.algorithm.model_copy(update={"max_grad_norm": 1e6, "minibatches": 1, "epochs": 1})
    learners = [
        small_learner(
            settings.model_copy(
                update={
                    "algorithm": algorithm,
                    "rkhs": settings.rkhs.model_copy(update={"feature_gradient": feature_gradient}),
                }
            ),
            1,
            1,
        )
        for feature_gradient in (True, False)
    ]
    flows, held = ([learner.start] for learner in learners)
    for seed in range(2):
        batch = random_batch(learners[0], seed)
        for learner, states in zip(learners, (flows, held), strict=True):
            states.append(learner.step(states[-1], batch)[0])
    first, second = ([trees.to_arrays(states[i].parameters["policy"]) for states in (flows, held)] for i in (1, 2))
    for name, array in first[0].items():
        np.testing.assert_allclose(array, first[1][name], atol=1e-6)
    assert not same_bits(*second)


@pytest.mark.parametrize("learner", ["kpn", "advkpn"])
def test_features_that_nothing_would_train_are_refused(learner: str) -> None:
    """kpn and advkpn train psi through h alone."""
    with pytest.raises(ValidationError, match="leaves nothing that trains the features"):
        RunSettings.model_validate({"learner": learner, "rkhs": {"feature_gradient": False}})
