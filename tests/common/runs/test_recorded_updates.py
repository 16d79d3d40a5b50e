"""Updates joined out of the messages of a log."""

from __future__ import annotations

from pathlib import Path

import pytest
from samples import rollout, settings, update_record

from common.errors import LogReadError
from common.log.records import LogMessage, encode_json
from common.runs.recorded_updates import RecordedUpdate, read_updates
from common.wire.rollout import Rollout


def logged(*made: Rollout) -> list[LogMessage]:
    return [LogMessage("/rollout", 0, 0, one.encode()) for one in made]


def update(version: int, *used: Rollout) -> LogMessage:
    return LogMessage("/update", 0, 0, encode_json(update_record(version, f"d{version}", used)))


def read(messages: list[LogMessage], after: int) -> list[RecordedUpdate]:
    return list(read_updates(messages, Path("log"), settings(), after=after))


def pair(version: int) -> list[Rollout]:
    """The rollouts of two slots whose actors have been there since version 0."""
    return [rollout(slot, "ab"[slot], version, version) for slot in (0, 1)]


def test_updates_come_with_the_rollouts_they_name() -> None:
    """Those after the checkpoint, in the order of their names, also where the next version's came before the record."""
    first, second = pair(3), pair(4)
    log = [*logged(*pair(2)), update(3, *pair(2)), *logged(*first, second[1]), update(4, *first), *logged(second[0])]
    log.append(update(5, *second))
    found = read(log, 3)
    assert [(one.version, one.state_digest) for one in found] == [(4, "d4"), (5, "d5")]
    assert [[made.id for made in one.rollouts] for one in found] == [[(0, 0, 3), (1, 0, 3)], [(0, 0, 4), (1, 0, 4)]]
    assert (found[1].rollouts[0].obs == second[0].obs).all()


def test_an_update_without_its_rollout_is_an_error() -> None:
    """Written ahead, it must be there: such a log was tampered with."""
    with pytest.raises(LogReadError, match=r"update 4 names the rollout of slot 1, .* seq 3, which is not among"):
        read([*logged(pair(3)[0]), update(4, *pair(3))], 3)
