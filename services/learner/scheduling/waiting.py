"""A sentence on what a run is waiting for."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from common.wire.report import LATE_S

if TYPE_CHECKING:
    from services.learner.scheduling.slots import Slot


def describe_missing(slots: Sequence[Slot], done: Collection[int], written: Collection[int], now_s: float) -> str:
    """List the slots without a rollout: "slot 1 compiling 12 s, slot 2 has no actor yet".

    Args:
        done: slots with a rollout in the log.
        written: slots with one that is being written to it.
        now_s: the moment; an actor that has missed heartbeats by then is called silent.
    """
    return ", ".join(
        f"slot {slot.number} {'being written to the log' if slot.number in written else _doing(slot, now_s)}"
        for slot in slots
        if slot.number not in done
    )


def _doing(slot: Slot, now_s: float) -> str:
    member = slot.member
    if member is None:
        return "has no actor yet" if slot.reserved else "has lost its actor"
    unheard_s = max(0.0, now_s - member.heard_s)
    silent = f" (silent for {unheard_s:.0f} s)" if unheard_s > LATE_S else ""
    return f"{member.state} {member.state_s + unheard_s:.0f} s{silent}"
