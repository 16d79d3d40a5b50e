"""Settings of the RKHS part of the policy, and which of them go together."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, field_validator

from common.config.kinds import Count, Natural, NotNegative, Positive, Section, number_or
from common.kernels import KERNELS
from common.kernels.kernel import Property
from common.suggestions import unknown_name

REPRESENTATIONS = ("exact", "nystrom", "rff", "kmp", "cluster", "basis")

PAPER_CENTRES = 2441
"""Centres of the paper's runs: 5e7 steps in updates of 20,480, one centre each."""

USUAL_CAPACITY = 256
"""Landmarks, features or centres of the representations that do not grow with the run."""

_NEEDS: dict[str, Property] = {
    "rff": "spectrum",
    "basis": "orthonormal basis",
    "nystrom": "positive semi-definite",
    "kmp": "positive semi-definite",
}
"""The property that a representation needs of its kernel; those that are not named work with every kernel."""

_REASONS: dict[Property, str] = {
    "spectrum": "random Fourier features exist only for kernels of x - y",
    "orthonormal basis": "the orthonormal basis that is used is that of the Gaussian kernel's space",
    "positive semi-definite": "it is not positive semi-definite, and there is no projection",
}


class RkhsSettings(Section):
    """The RKHS part h of the policy and its functional gradient step (paper, section 3 and Table 1)."""

    kernel: str = "gaussian"
    """kernel over features z/sqrt(d): gaussian, laplacian, linear, sigmoid"""
    bandwidth: Positive = 0.5
    """sigma squared of the Gaussian kernel exp(-r^2 / bandwidth), s of the Laplacian exp(-r / bandwidth)"""
    slope: Positive = 1.0
    """g of the sigmoid kernel tanh(g x.y + c)"""
    offset: Annotated[float, Field(allow_inf_nan=False)] = 0.0
    """c of the sigmoid kernel tanh(g x.y + c)"""
    representation: str = "exact"
    """how h is kept: exact, nystrom, rff, kmp (kernel matching pursuit), cluster, basis"""
    capacity: Count | None = None
    """centres, landmarks or features of h; default: room for every step, at most 2,441 (exact), else 256"""
    samples: Annotated[int | Literal["batch"], BeforeValidator(number_or("batch", "for the whole batch"))] = 1
    """transitions drawn for one functional gradient (n), or batch for all of them"""
    estimate: Literal["score", "symmetric"] = "score"
    """functional gradient from actions as taken, or from pairs of mirrored actions stepped from one state"""
    step: Literal["fixed", "trust-region"] = "fixed"
    """size of the functional step: fixed by eta, or such that it changes the policy by kl_target"""
    eta: NotNegative = 0.1
    """step size of the functional gradient (fixed)"""
    kl_target: Positive = 0.002
    """mean KL divergence of one functional step (trust-region)"""
    agreement: bool = False
    """multiply kl_target by the squared cosine of the gradients of two halves of the batch (rff, basis)"""
    feature_gradient: bool = True
    """gradients of the networks' objective flow through h into the features psi"""
    momentum: Annotated[float, Field(ge=0, lt=1)] = 0.9
    """moving average of the functional gradient"""
    shrinkage: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """part of h that is given up at each step: regularisation in the RKHS"""
    clip: Positive = 1.0
    """clip of the ratio in the functional gradient"""
    drift: Literal["paper", "derivative", "none"] = "paper"
    """drift in the functional gradient: paper (A - D), derivative (of r A - D, as the networks have it), none"""
    drift_alpha: Positive = 1.0
    """drift of the functional gradient for positive advantages"""
    drift_beta: Positive = 0.6
    """drift of the functional gradient for negative advantages"""
    landmarks_every: Natural = 0
    """updates between two choices of landmarks (nystrom); 0: those of the first batch stay"""
    radius: NotNegative = 0.1
    """distance within which a transition joins an existing centre (cluster); 0: never"""
    error: NotNegative = 0.0
    """RKHS distance that a step may move h to save centres (kmp); 0: centres go only when there is no room"""
    directions: Count = 8
    """directions of feature space that the basis functions see (basis)"""
    variance_every: Natural = 0
    """updates between two measurements of the functional gradient's variance (equation 10); 0: none"""

    @field_validator("kernel")
    @classmethod
    def _known_kernel(cls, kernel: str) -> str:
        if kernel not in KERNELS:
            raise ValueError(unknown_name("kernel", kernel, KERNELS))
        return kernel

    @field_validator("representation")
    @classmethod
    def _known_representation(cls, representation: str) -> str:
        if representation not in REPRESENTATIONS:
            raise ValueError(unknown_name("representation", representation, REPRESENTATIONS))
        return representation

    def room(self, updates: int, samples: int, batch: int) -> int:
        """Centres, landmarks or features of a run of so many updates by `samples` out of `batch` transitions."""
        if self.capacity is not None:
            return self.capacity
        if self.representation == "exact":
            return max(min(updates * samples, PAPER_CENTRES), samples)
        return min(USUAL_CAPACITY, batch) if self.representation == "nystrom" else USUAL_CAPACITY


def impossibility(rkhs: RkhsSettings, batch: int, num_envs: int) -> str | None:
    """The reason for which these settings exclude one another at this batch size; None where they do not."""
    pairs = rkhs.estimate == "symmetric"
    name, samples = rkhs.representation, rkhs.samples
    if samples == "batch":
        samples = num_envs if pairs else batch
    needed = _NEEDS.get(name)
    if needed and needed not in KERNELS[rkhs.kernel].properties:
        able = [other for other, kernel in KERNELS.items() if needed in kernel.properties]
        return (
            f"rkhs.representation {name} cannot do the {rkhs.kernel} kernel: {_REASONS[needed]}; choose rkhs.kernel "
            f"{' or '.join(able)}, or rkhs.representation exact"
        )
    if samples > batch:
        return f"rkhs.samples ({samples}) must be at most the batch of {batch} transitions; 'batch' takes all of them"
    if pairs and samples > num_envs:
        return (
            f"rkhs.samples ({samples}) must be at most the {num_envs} pairs of a symmetric estimate, one for each "
            "environment (num_envs); 'batch' takes all of them"
        )
    if rkhs.agreement and (rkhs.step != "trust-region" or name not in ("rff", "basis") or samples < 2):
        return (
            f"rkhs.agreement scales kl_target by what two halves of a step's transitions have in common: it needs "
            f"rkhs.step trust-region (given: {rkhs.step}), rkhs.representation rff or basis (given: {name}) and "
            f"rkhs.samples of at least 2 (given: {samples})"
        )
    if rkhs.capacity is None:
        return None
    if name == "exact" and rkhs.capacity < samples:
        return (
            f"rkhs.capacity ({rkhs.capacity}) must hold at least one step's rkhs.samples ({samples}): each is a new "
            "centre; rkhs.representation nystrom or rff takes any number of samples at a fixed size"
        )
    if name == "nystrom" and rkhs.capacity > batch:
        return f"rkhs.capacity ({rkhs.capacity}) must be at most the batch of {batch} that the landmarks are taken from"
    if name == "rff" and rkhs.capacity % 2:
        return f"rkhs.capacity ({rkhs.capacity}) must be even: Fourier features come as pairs of cosine and sine"
    return None
