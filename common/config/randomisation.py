"""Settings of domain randomisation: ranges of the factors by which fields of the model are multiplied."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, BeforeValidator

from common.config.kinds import Positive, Section, split_list


def _ordered(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[0] > limits[1]:
        raise ValueError(f"the lower limit comes first: write {limits[1]:g},{limits[0]:g}")
    return limits


Range = Annotated[tuple[Positive, Positive], BeforeValidator(split_list), AfterValidator(_ordered)]

UNCHANGED = (1.0, 1.0)


class RandomisationSettings(Section):
    """Domain randomisation: each environment multiplies fields of its model by factors of its own, drawn uniformly
    from these ranges when it is created. Evaluations use the model as it is."""

    mass: Range = UNCHANGED
    """factor of the masses and inertias of all bodies, lowest and highest"""
    friction: Range = UNCHANGED
    """factor of the sliding friction of all geoms"""
    gain: Range = UNCHANGED
    """factor of the strength of all actuators: gain and bias"""
    damping: Range = UNCHANGED
    """factor of the damping of all joints"""

    def ranges(self) -> dict[str, tuple[float, float]]:
        """The ranges that are not a single 1, by name."""
        named = {"mass": self.mass, "friction": self.friction, "gain": self.gain, "damping": self.damping}
        return {name: limits for name, limits in named.items() if limits != UNCHANGED}

    def is_off(self) -> bool:
        """True if nothing is randomised."""
        return not self.ranges()


NOT_RANDOMISED = RandomisationSettings()
