"""Whether a message of the right form is also of the right sender: CodecError where it is not, with its reason.

The fleet decides about rollouts by itself, since its answer depends on what came before.
"""

from __future__ import annotations

from common.engine_names import PHYSICS
from common.errors import CodecError
from common.wire.keys import Keys
from common.wire.messages import Evaluation, Heartbeat, Join
from services.learner.scheduling.fleet import Fleet


def check_join(join: Join) -> None:
    """Its engine is one there is: it is shown, logged and kept in the summary."""
    if join.physics not in PHYSICS:
        raise CodecError("bad_value", f"physics is {join.physics!r:.80}; allowed: {', '.join(PHYSICS)}")


def check_heartbeat(fleet: Fleet, keys: Keys, key: str, beat: Heartbeat) -> None:
    """It is of who holds its slot."""
    if key != keys.heartbeat(beat.slot):
        raise CodecError("bad_key", f"a heartbeat of slot {beat.slot} on {key}")
    if beat.run != keys.run:
        raise CodecError("run", f"a heartbeat of run {beat.run!r}")
    if not fleet.holds(beat.slot, beat.incarnation):
        raise CodecError("incarnation", f"a heartbeat of {beat.incarnation!r}, who does not hold slot {beat.slot}")


def check_evaluation(fleet: Fleet, keys: Keys, key: str, evaluation: Evaluation) -> None:
    """It was asked for, and is of who holds its slot."""
    sent = (key, evaluation.run, evaluation.version, evaluation.episode_return.size)
    wanted = (keys.evaluation(evaluation.slot), keys.run, fleet.version, fleet.episodes)
    if sent != wanted or not fleet.holds(evaluation.slot, evaluation.incarnation):
        raise CodecError("stale", "this evaluation was not asked for")
