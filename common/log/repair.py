"""Repair of a log whose writer was killed: every segment without a footer is rewritten as a whole one."""

from __future__ import annotations

import contextlib
import os
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from common.errors import LogReadError
from common.files import create, open_to_read, require_plain
from common.log.failures import write_failure
from common.log.framing import TornTail
from common.log.lock import LogLock
from common.log.records import CHANNELS
from common.log.segment_reader import SegmentReader
from common.log.segment_writer import SegmentWriter
from common.log.segments import find_segments, sync_directory

_COPY_BYTES = 1 << 20


@dataclass(frozen=True)
class RepairedSegment:
    """A segment that was rewritten with its `messages`.

    `dropped_bytes` of an incomplete record at its end were saved in the file `torn_path`; None if there were none.
    """

    path: Path
    messages: int
    dropped_bytes: int
    torn_path: Path | None


@dataclass(frozen=True)
class RepairReport:
    """The segments that a repair rewrote; empty where all were whole."""

    segments: tuple[RepairedSegment, ...]


def repair(path: Path, lock: LogLock | None = None) -> RepairReport:
    """Rewrite the torn segments of a log from their complete chunks; whole segments are not touched.

    Each is written beside the torn file, synced, and only then renamed over it, so an interruption loses nothing. It
    needs as much free space as the largest torn segment.

    Args:
        path: a run directory, its log directory, or one .mcap file.
        lock: of the log, where the caller holds it.

    Raises:
        LogReadError: there is no log, a torn segment is also damaged before its end, or something in the directory
            is not a regular file of this user.
        LogWriteError: a learner is writing the log, or the repaired file cannot be written.
    """
    directory = find_segments(path)[0].parent
    with nullcontext() if lock is not None else LogLock(directory):
        refuse_links(directory)
        # Looked up again: before it was locked, a writer may have finished or begun a segment.
        segments = [SegmentReader(segment) for segment in find_segments(path)]
        return RepairReport(
            tuple(_repair_segment(segment, segment.torn) for segment in segments if segment.torn is not None)
        )


def describe_repair(report: RepairReport) -> list[str]:
    """A line for each segment that was repaired."""
    lines = []
    for segment in report.segments:
        kept = f", {segment.dropped_bytes:,} bytes of an incomplete record kept aside in {segment.torn_path}"
        lines.append(
            f"repaired {segment.path}: {segment.messages} messages are whole{kept if segment.torn_path else ''}"
        )
    return lines


def refuse_links(directory: Path) -> None:
    """Raise LogReadError unless everything in a directory is a regular file or directory of this user."""
    try:
        require_plain(directory)
    except OSError as error:
        raise LogReadError(
            f"{error.filename or directory} is in the way of resuming or repairing: {error.strerror}; remove it, or "
            "restore the run from a copy"
        ) from None


def _repair_segment(segment: SegmentReader, torn: TornTail) -> RepairedSegment:
    beside = segment.path.with_name(segment.path.name + ".repair")
    try:
        beside.unlink(missing_ok=True)
        messages = _rewrite(segment, beside)
        torn_path = _save_torn_bytes(torn) if torn.dropped_bytes else None
        os.replace(beside, segment.path)
        sync_directory(segment.path.parent)
    except OSError as error:
        failure = write_failure(beside, error)
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)
        raise failure from error
    return RepairedSegment(segment.path, messages, torn.dropped_bytes, torn_path)


def _save_torn_bytes(torn: TornTail) -> Path:
    aside = torn.path.with_name(torn.path.name + ".torn")
    with open_to_read(torn.path) as source, create(aside) as target:
        source.seek(torn.good_bytes)
        while block := source.read(_COPY_BYTES):
            target.write(block)
        target.flush()
        os.fsync(target.fileno())
    return aside


def _rewrite(segment: SegmentReader, beside: Path) -> int:
    copy = SegmentWriter(
        beside,
        compression="none" if segment.compression == "none" else "lz4",
        metadata=segment.metadata(),
        attachments=segment.attachments(),
        t_ns=0,  # MCAP's value for a time that is not known: that of an attachment is not kept
    )
    try:
        for message in segment.messages():
            if message.topic not in CHANNELS:
                raise LogReadError(
                    f"{segment.path} has the channel {message.topic!r}, which this version does not know; repair it "
                    "with the version that wrote it"
                )
            copy.add(message.topic, message.t_ns, message.data)
        copy.finish()
    except (OSError, LogReadError):
        copy.abandon()
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)
        raise
    return copy.messages
