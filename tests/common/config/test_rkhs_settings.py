"""Settings of h that cannot go together are refused with the reason."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from common.config.settings import RunSettings


def settings(**rkhs: object) -> RunSettings:
    return RunSettings.model_validate({"num_envs": 64, "num_steps": 10, "rkhs": rkhs})


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"representation": "rff", "kernel": "sigmoid"}, "rff cannot do the sigmoid kernel.*gaussian or laplacian"),
        ({"representation": "rff", "kernel": "linear"}, "rff cannot do the linear kernel"),
        ({"representation": "basis", "kernel": "laplacian"}, "basis cannot do the laplacian kernel.*choose.*gaussian"),
        ({"representation": "nystrom", "kernel": "sigmoid"}, "not positive semi-definite"),
        ({"representation": "kmp", "kernel": "sigmoid"}, "not positive semi-definite"),
        ({"representation": "nystroem"}, "'nystroem' is not a representation; did you mean 'nystrom'"),
        ({"kernel": "laplace"}, "'laplace' is not a kernel; did you mean 'laplacian'"),
        ({"capacity": 0}, "greater than or equal to 1"),
        ({"capacity": 4, "samples": 5}, r"rkhs.capacity \(4\) must hold.*rkhs.samples \(5\)"),
        ({"capacity": 4, "samples": "batch"}, r"rkhs.capacity \(4\) must hold.*\(640\)"),
        ({"bandwidth": -1.0}, "greater than 0"),
        ({"samples": "many"}, "must be a whole number of at least 1, or 'batch'"),
        ({"samples": 0}, "must be a whole number of at least 1, or 'batch'"),
        ({"samples": 641}, r"rkhs.samples \(641\) must be at most the batch of 640"),
        ({"samples": 65, "estimate": "symmetric"}, r"\(65\) must be at most the 64 pairs.*num_envs"),
        ({"estimate": "antithetic"}, "'score' or 'symmetric'"),
        ({"representation": "nystrom", "capacity": 641}, r"\(641\) must be at most the batch of 640"),
        ({"representation": "rff", "capacity": 7}, r"\(7\) must be even"),
        ({"kl_target": 0.0}, "greater than 0"),
        ({"step": "trust_region"}, "'fixed' or 'trust-region'"),
    ],
)
def test_refused_with_the_reason(given: dict[str, object], reason: str) -> None:
    """What was given, what is allowed, and why."""
    with pytest.raises(ValidationError, match=f"(?i){reason}"):
        settings(**given)


def test_sizes_by_default() -> None:
    """Exact has room for the run, the others 256; the whole batch is so many samples."""
    assert settings().capacity == 2441  # 3e6 / 640 = 4,687 updates
    assert settings(samples="batch").samples == 640
    pairs = settings(samples="batch", estimate="symmetric")
    assert (pairs.samples, pairs.branches, settings().branches) == (64, 64, 0)
    assert RunSettings.model_validate({"learner": "ppo", "rkhs": {"estimate": "symmetric"}}).branches == 0
    assert settings(representation="rff", samples="batch").capacity == 256
    assert (
        RunSettings.model_validate({"num_envs": 8, "num_steps": 8, "rkhs": {"representation": "nystrom"}}).capacity
        == 64
    )  # no more landmarks than a batch has transitions
