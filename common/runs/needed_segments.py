"""The segments of a log that a run needs to go on from a version."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from common.log import chain, totals
from common.log.segment_reader import SegmentReader
from common.runs.tally import Tally


def first_needed(segments: Sequence[Path], version: int, staleness: int) -> int:
    """The index of the last segment that has, with those after it, the update to `version` and all that followed.

    Records of version v are not written before the update to v - 1, rollouts not before that to v - 1 - staleness. Only
    a segment that names the totals and the chain of those before it will do; else it is the first one.

    Raises:
        LogReadError: a segment is damaged at its beginning.
    """
    for index in range(len(segments) - 1, 0, -1):
        metadata = SegmentReader(segments[index]).metadata()
        if totals.METADATA not in metadata or chain.METADATA not in metadata:
            continue
        if Tally.of(metadata[totals.METADATA], updates=1).version < version - 1 - staleness:
            return index
    return 0


def read_tally(segment: Path, updates: int) -> Tally:
    """The totals of the segments before this one; of none where it does not name them. LogReadError as above."""
    found = SegmentReader(segment).metadata().get(totals.METADATA)
    return Tally(updates) if found is None else Tally.of(found, updates)
