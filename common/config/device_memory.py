"""Settings of the memory that processes may take of a GPU."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator

from common.config.kinds import Section
from common.device_memory import ON_DEMAND


def _share(value: Any) -> Any:
    """A number in (0, 1], also where it is written as text, or `on-demand`; one sentence for whatever else there is."""
    if value == ON_DEMAND:
        return value
    try:
        share = float(value) if not isinstance(value, bool) else 0.0
    except (TypeError, ValueError):
        share = 0.0
    if not 0.0 < share <= 1.0:
        raise ValueError(f"must be a share of the GPU's memory, above 0 and at most 1, or {ON_DEMAND} to reserve none")
    return share


Share = Annotated[float | Literal["on-demand"], BeforeValidator(_share)]


class DeviceMemorySettings(Section):
    """Memory that a process reserves on a GPU when JAX starts; on a CPU nothing here has an effect. A share is also
    the most that the process can have; on demand, it takes what its programs need."""

    learner: Share = ON_DEMAND
    """share of the GPU's memory for the learner, such as 0.4; on-demand: none is reserved"""
    actor: Share = ON_DEMAND
    """the same for each actor or evaluator with physics mjx; those with physics native stay off the GPU"""
