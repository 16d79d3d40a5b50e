"""The totals of a log, by which a run is read from the middle of its log."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from common.errors import LogReadError
from common.log.chain import Chain
from common.log.segments import list_segments
from common.log.writer import LogWriter
from common.runs.needed_segments import first_needed, read_tally
from common.runs.tally import Ended, Tally


def record(topic: str, **content: Any) -> tuple[str, int, bytes]:
    return topic, 7, json.dumps(content).encode()


def update(version: int, *generations: int) -> tuple[str, int, bytes]:
    used = [{"slot": slot, "generation": generation} for slot, generation in enumerate(generations)]
    return record("/update", version=version, rollouts=used)


def episode(version: int, count: int, mean: float) -> tuple[str, int, bytes]:
    return record("/episode", version=version, count=count, return_mean=mean)


def test_what_is_counted() -> None:
    """The newest version, all episodes, the newest generation of every slot, and the time of the first record."""
    tally = Tally(updates=30)
    for message in (("/rollout", 5, b"\x80"), episode(1, 3, 0.1), update(1, 0, 2), update(2, 1, 0)):
        tally.add(*message)
    assert (tally.version, tally.episodes, tally.began_ns) == (2, 3, 5)
    assert tally.generations == {0: 1, 1: 2}
    assert list(tally.window) == [Ended(1, 3, 0.1)]


def test_the_window_has_what_means_depend_on() -> None:
    """The newest records that make 200 episodes, and all of the last tenth: of 30 updates, from 28 on.

    150 + 100 + 120: without the first, 220 are left, so it goes. Of the last tenth nothing goes.
    """
    tally = Tally(updates=30)
    for version, count in ((1, 150), (2, 100), (3, 120)):
        tally.add(*episode(version, count, 1.0))
    assert [ended.version for ended in tally.window] == [2, 3]
    assert tally.earlier_episodes == 150
    for version in (28, 29, 30):
        tally.add(*episode(version, 500, 1.0))
    assert [ended.version for ended in tally.window] == [28, 29, 30]


def test_it_goes_on_from_its_metadata() -> None:
    """Written at the beginning of a segment and read back, it is the same, to the bit of a mean."""
    tally = Tally(updates=30)
    for message in (episode(1, 3, 0.1 + 0.2), update(1, 4, 0)):
        tally.add(*message)
    again = Tally.of(tally.metadata(), updates=30)
    assert again.metadata() == tally.metadata()
    assert again.window == tally.window
    assert again.earlier_episodes == 0


@pytest.mark.parametrize("change", [{"window": "7"}, {"window": "[" * 100_000}, {"version": "x"}, {"window": "[[1]]"}])
def test_metadata_that_is_none(change: dict[str, str]) -> None:
    """Is damage, with a sentence."""
    with pytest.raises(LogReadError, match="names no totals of those before it"):
        Tally.of(Tally(3).metadata() | change, 3)


def write_segments(directory: Path, updates: int, *, chain: bool = True) -> list[Path]:
    """A log with one update in each segment."""
    tally = Tally(updates)
    with LogWriter(directory, segment_messages=1, chain=Chain() if chain else None, totals=tally) as log:
        for version in range(1, updates + 1):
            log.write("/update", update(version, 0)[2])
            log.flush(10.0)
    return list_segments(directory)


def test_every_segment_names_what_was_before(tmp_path: Path) -> None:
    """The first names nothing, the next one update, and so on; the closing seal is in the last."""
    segments = write_segments(tmp_path, 4)
    assert [read_tally(path, 4).version for path in segments] == [0, 1, 2, 3]


def test_the_segments_that_a_version_needs(tmp_path: Path) -> None:
    """To go on from version 5, rollouts of version 5 are needed, which are not written before update 4 is: the segment
    of update 4, before which there are 3. With staleness 1, rollouts of version 4 as well."""
    segments = write_segments(tmp_path, 6)
    assert first_needed(segments, 5, 0) == 3
    assert first_needed(segments, 5, 1) == 2
    assert first_needed(segments, 1, 0) == 0


def test_a_log_that_does_not_say_is_needed_whole(tmp_path: Path) -> None:
    """One of an earlier release: without totals or without a chain."""
    assert first_needed(write_segments(tmp_path, 6, chain=False), 5, 0) == 0
