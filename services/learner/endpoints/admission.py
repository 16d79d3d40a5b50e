"""Checks of well-formed messages against the run: is the message of the right sender, and was it asked for.

The fleet checks rollouts by itself, since whether one is used depends on what was delivered before.
"""

from __future__ import annotations

from common.engine_names import PHYSICS
from common.errors import CodecError
from common.printable import quoted, shortened
from common.wire.divergence import Divergence
from common.wire.keys import Keys
from common.wire.messages import Environment, Evaluation, Heartbeat, Join
from services.learner.scheduling.fleet import Fleet
from services.learner.scheduling.slots import Member


def check_join(join: Join) -> None:
    """Raises CodecError for an unknown physics engine: its name is shown, logged and kept in the summary."""
    if join.physics not in PHYSICS:
        raise CodecError("bad_value", f"physics is {quoted(join.physics)}; allowed: {', '.join(PHYSICS)}")


def check_holder(fleet: Fleet, run: str, sent: Environment | Divergence) -> Member:
    """The member that holds the message's slot. Raises CodecError where its sender does not, or is of another run."""
    member = fleet.holder(sent.slot, sent.incarnation)
    if member is None or sent.run != run:
        shown = quoted(shortened(sent.incarnation))
        raise CodecError("incarnation", f"slot {sent.slot} is not held by {shown}; join again")
    return member


def check_heartbeat(fleet: Fleet, keys: Keys, key: str, beat: Heartbeat) -> None:
    """Raises CodecError unless the heartbeat is of the actor that holds its slot."""
    if key != keys.heartbeat(beat.slot):
        raise CodecError("bad_key", f"a heartbeat of slot {beat.slot} on {key}")
    if beat.run != keys.run:
        raise CodecError("run", f"a heartbeat of run {beat.run!r}")
    if not fleet.holds(beat.slot, beat.incarnation):
        shown = quoted(shortened(beat.incarnation))
        raise CodecError("incarnation", f"a heartbeat of {shown}, which does not hold slot {beat.slot}")


def check_evaluation(fleet: Fleet, keys: Keys, key: str, evaluation: Evaluation) -> None:
    """Raises CodecError unless the evaluation was asked for, and is of the actor that holds its slot."""
    sent = (key, evaluation.run, evaluation.version, evaluation.episode_return.size)
    wanted = (keys.evaluation(evaluation.slot), keys.run, fleet.version, fleet.episodes)
    if sent != wanted or not fleet.holds(evaluation.slot, evaluation.incarnation):
        raise CodecError("stale", "this evaluation was not asked for")
