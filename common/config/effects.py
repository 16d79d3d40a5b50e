"""Settings that were changed and have no effect in a run, because of other settings."""

from __future__ import annotations

from collections.abc import Iterator

from common.config.settings import RunSettings
from common.config.tree import leaves, value_of
from common.learners import LEARNERS

KERNELS_OF = {
    "rkhs.bandwidth": ("gaussian", "laplacian"),
    "rkhs.slope": ("sigmoid",),
    "rkhs.offset": ("sigmoid",),
}
REPRESENTATION_OF = {
    "rkhs.landmarks_every": "nystrom",
    "rkhs.radius": "cluster",
    "rkhs.error": "kmp",
    "rkhs.directions": "basis",
}
STEP_OF = {"rkhs.eta": "fixed", "rkhs.kl_target": "trust-region"}


def settings_without_effect(settings: RunSettings) -> str:
    """A sentence that names every setting with a value of its own and no effect, and why; empty if there is none."""
    without = [
        f"{name} ({reason})"
        for name, reason in _without_effect(settings)
        if value_of(settings, name) != leaves()[name].default
    ]
    return f"settings without effect in this run: {', '.join(without)}" if without else ""


def _without_effect(settings: RunSettings) -> Iterator[tuple[str, str]]:
    """The names of all settings that have no effect beside the others, whatever their value, with the reason."""
    if settings.mode == "sync":
        yield "max_staleness", "for mode async"
    if not _uses_drift(settings):
        for name in ("algorithm.dpo_alpha", "algorithm.dpo_beta"):
            yield name, "for the objective dpo"
    if settings.transport.certificates is None and settings.transport.users is None:
        for name in ("transport.actor_names", "transport.viewer_names"):
            yield name, "without certificates or users"
    yield from _without_effect_in_critic(settings)
    if LEARNERS[settings.learner].rkhs:
        yield from _without_effect_in_rkhs(settings)
    else:
        for name in leaves():
            if name.startswith("rkhs."):
                yield name, f"learner {settings.learner} has no RKHS part"


def _without_effect_in_critic(settings: RunSettings) -> Iterator[tuple[str, str]]:
    chosen = settings.critic.representation
    if chosen == "none":
        for name in leaves():
            if name.startswith("critic."):
                yield name, "critic.representation is none"
    elif chosen == "linear":
        for name in ("critic.capacity", "critic.bandwidth"):
            yield name, "for critic.representation rff or nystrom"


def _without_effect_in_rkhs(settings: RunSettings) -> Iterator[tuple[str, str]]:
    rkhs = settings.rkhs
    for name, kernels in KERNELS_OF.items():
        if rkhs.kernel not in kernels:
            yield name, f"for rkhs.kernel {' or '.join(kernels)}"
    for name, representation in REPRESENTATION_OF.items():
        if rkhs.representation != representation:
            yield name, f"for rkhs.representation {representation}"
    for name, step in STEP_OF.items():
        if rkhs.step != step:
            yield name, f"for rkhs.step {step}"


def _uses_drift(settings: RunSettings) -> bool:
    chosen = settings.algorithm.objective
    return chosen == "dpo" or (chosen == "auto" and LEARNERS[settings.learner].objective == "dpo")
