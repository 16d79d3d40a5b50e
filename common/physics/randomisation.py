"""Domain randomisation: fields of a model multiplied by factors that each environment has of its own.

The factors belong to the state of an environment: they are drawn when it is created, from its key, and stay with it for
all its episodes. A run that is resumed, or verified, therefore has the same ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from common.physics.bodies import Scales

DRAW = 0x5CA1E
"""Folded into the key of `reset` to draw the factors."""

Ranges = Mapping[str, tuple[float, float]]
"""Lowest and highest factor by name."""


@dataclass(frozen=True)
class Scaled:
    """A field of the model that a factor changes: its leading `columns` (None for all), times factor ** power.

    `beside`: a field that is a part of it and stays as it is.
    """

    field: str
    power: int = 1
    columns: int | None = None
    beside: str | None = None


FIELDS: dict[str, tuple[Scaled, ...]] = {
    # The constants that MuJoCo derives from masses follow exactly where joints have no armature.
    "mass": (
        Scaled("body_mass"),
        Scaled("body_inertia"),
        Scaled("body_subtreemass"),
        # The inertia that the C engine takes for joints of simple bodies.
        Scaled("dof_M0", beside="dof_armature"),
        Scaled("body_invweight0", power=-1),
        Scaled("dof_invweight0", power=-1),
    ),
    "friction": (Scaled("geom_friction", columns=1),),
    # Gain and bias together: a servo keeps its target and becomes stronger or weaker.
    "gain": (Scaled("actuator_gainprm"), Scaled("actuator_biasprm")),
    "damping": (Scaled("dof_damping"),),
}


def draw(key: jax.Array, ranges: Ranges, num_envs: int) -> Scales:
    """Factors [N] by name, uniform in their ranges."""
    return {
        name: jax.random.uniform(jax.random.fold_in(key, DRAW + number), (num_envs,), minval=low, maxval=high)
        for number, name in enumerate(FIELDS)
        if name in ranges
        for low, high in [ranges[name]]
    }


def scaled_fields(model: Any, scales: Mapping[str, Any], xp: Any) -> Iterator[tuple[str, Any]]:
    """The changed fields of a model by name, of the factors' shape [...] followed by the field's.

    `xp`: `numpy` or `jax.numpy`, in which they are computed.
    """
    for name, factor in scales.items():
        for scaled in FIELDS[name]:
            nominal = getattr(model, scaled.field)
            power = xp.asarray(factor) ** scaled.power
            power = power.reshape(*power.shape, *[1] * nominal.ndim)
            if scaled.columns is not None:
                power = xp.where(np.arange(nominal.shape[-1]) < scaled.columns, power, 1.0)
            rest = 0.0 if scaled.beside is None else getattr(model, scaled.beside)
            yield scaled.field, rest + (nominal - rest) * power
