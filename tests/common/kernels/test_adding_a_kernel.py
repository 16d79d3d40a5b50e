"""A new kernel is one file: settings, representations and metrics know it by what the file says."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from common.config.rkhs import impossibility
from common.config.settings import AlgorithmSettings, RkhsSettings, RunSettings
from common.kernels import KERNELS, kernels_in
from common.maths.diagnostics import Diagnostics
from common.maths.functional import FunctionalStep
from common.maths.gram import gram
from common.maths.networks import make_networks
from common.maths.rkhs.make import make_representation
from common.maths.samples import Pairs, Samples
from common.maths.state import initial_state

pytestmark = pytest.mark.usefixtures("in_a_hurry")

NAME = "inverse-multiquadric"


@pytest.fixture(autouse=True)
def added(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel of `added/`, found as those of `common/kernels` are, among them."""
    found = kernels_in([str(Path(__file__).parent / "added")], "added")
    assert list(found) == [NAME]
    monkeypatch.setitem(KERNELS, NAME, found[NAME])


def run_settings(**rkhs: object) -> RunSettings:
    return RunSettings(rkhs=RkhsSettings(kernel=NAME, **rkhs), algorithm=AlgorithmSettings(hidden=(4,)))


def test_settings_know_it_and_what_can_represent_it() -> None:
    """Its spectrum and definiteness admit all representations but the basis, whose refusal says so."""
    for name in ("exact", "cluster", "kmp", "nystrom", "rff"):
        assert impossibility(RkhsSettings(kernel=NAME, representation=name), 64, 16) is None
    refused = impossibility(RkhsSettings(kernel=NAME, representation="basis"), 64, 16)
    assert refused is not None
    assert refused.startswith(f"rkhs.representation basis cannot do the {NAME} kernel")


def test_its_own_spectrum_is_drawn_from() -> None:
    """Fourier features approach (1 + r^2 / bandwidth)^-1/2, at distances of 1 and 2: not another kernel's values."""
    rff = make_representation(run_settings(representation="rff", capacity=8192, bandwidth=0.5))
    x = jnp.asarray([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    phi = rff.activations(rff.empty(3, 1)[0], x)
    expected = [1.0, (1 + 1 / 0.5) ** -0.5, (1 + 4 / 0.5) ** -0.5]
    np.testing.assert_allclose(gram(rff.kernel, x[:1], x)[0], expected, rtol=1e-6)
    np.testing.assert_allclose(phi[0] @ phi.T, expected, atol=5 / np.sqrt(4096))


def test_metrics_hold_its_bandwidth_against_its_distance() -> None:
    """The bandwidth is reported against the squared distances of features, as the formula divides those by it."""
    settings = run_settings(representation="exact", capacity=4)
    networks, parameters = make_networks(3, 2, (4,), 0)
    representation = make_representation(settings)
    state = initial_state(
        networks, parameters, settings.algorithm, representation=representation, slots=1, envs_per_slot=4, seed=0
    )
    rng = np.random.default_rng(0)
    numbers = [jnp.asarray(rng.standard_normal(shape), jnp.float32) for shape in ((8, 3), (8, 2), 8, 8, 8)]
    diagnostics = Diagnostics(FunctionalStep(networks, representation, settings.rkhs, "A", 1))
    batch = Samples(*numbers)
    metrics = jax.jit(diagnostics)(state, state, batch, Pairs(batch[:0], batch[:0]))
    assert float(metrics["rkhs/median_distance"]) > 0
    assert float(metrics["rkhs/bandwidth_ratio"]) == pytest.approx(0.5 / float(metrics["rkhs/median_distance"]))
