"""Settings of the kernel critic, and which of them go together."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from common.config.kinds import Count, Positive, Section


class CriticSettings(Section):
    """The kernel critic: a closed-form correction of the critic's network (docs/method.md)."""

    representation: Literal["none", "rff", "nystrom", "linear"] = "none"
    """functions that the correction g is a sum of: rff, nystrom, or linear ones as a control; none: no correction"""
    inputs: Literal["features", "observations", "both", "critic"] = "features"
    """what g sees: the policy's features psi(o), observations, both, or the features of the critic's network"""
    capacity: Count = 256
    """Fourier features or landmarks of g (rff, nystrom)"""
    bandwidth: Positive = 0.5
    """sigma squared of the Gaussian kernel exp(-r^2 / bandwidth) of g (rff, nystrom)"""
    ridge: Positive = 0.01
    """penalty on the squared norm of g, as a fraction of the mean eigenvalue of the fit"""
    shrink: bool = True
    """multiply g by its R^2 on held-out environments, so that it vanishes where it does not predict"""
    forgetting: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """weight of the earlier batches in a fit, by update; 0: the newest batch alone"""


def impossibility(critic: CriticSettings, batch: int, num_envs: int) -> str | None:
    """The reason why these settings exclude each other with batches of this size; None where they go together."""
    if critic.representation == "none":
        return None
    if num_envs < 2:
        return "critic.representation needs num_envs of at least 2: one half of the environments judges the other's fit"
    if critic.representation == "rff" and critic.capacity % 2:
        return f"critic.capacity ({critic.capacity}) must be even: Fourier features come as pairs of cosine and sine"
    if critic.representation == "nystrom" and critic.capacity > batch:
        return f"critic.capacity ({critic.capacity}) must be at most the batch of {batch} that landmarks come from"
    if critic.representation == "nystrom" and critic.forgetting:
        return (
            "critic.forgetting needs functions that stay the same, while the landmarks of nystrom are taken from "
            "each batch; choose critic.representation rff or linear, or critic.forgetting 0"
        )
    return None
