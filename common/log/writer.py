"""The writer of a run's log: its own thread, group commits, and an acknowledgement once a message is in the file."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from common.errors import LogWriteError
from common.log.chain import Chain
from common.log.failures import write_failure
from common.log.lock import LogLock
from common.log.records import CHANNELS, encode_json
from common.log.segment_sequence import SegmentSequence
from common.log.segment_writer import Attachments, Compression, Metadata
from common.log.signatures import Signer
from common.log.totals import Totals
from common.suggestions import unknown_name

_GROUP_BYTES = 32 << 20
"""Most bytes of one commit: bounds the wait for an acknowledgement, and by how much a segment exceeds its size."""

SEGMENT_MESSAGES = 1 << 14
"""mcap keeps an index of all chunks until a segment is finished, half a KB each: of small messages, committed one by
one, a segment of 1 GiB would hold so many that a learner's memory grew for hours."""


@dataclass(frozen=True, slots=True)
class _Entry:
    topic: str
    data: bytes
    t_ns: int
    on_durable: Callable[[], None] | None


class LogWriter:
    """Appends messages to the segments in `directory`, which is made if need be; existing segments are kept.

    Callers only enqueue. The writer's own thread takes the queued messages, writes them as a group, hands them to the
    operating system and then acknowledges each. An acknowledged message survives the end of
    this process; it survives a loss of power once synced, which happens at most every `sync_period_s`, and when a
    segment is finished.

    The first failure ends the log: acknowledged messages are readable, all others are not in the files, nothing more
    is acknowledged, and `write`, `flush` and `close` raise.

    Args:
        directory: the log directory of the run.
        segment_bytes: a segment that has reached this size is finished and the next one begun; so is one with
            `segment_messages` messages.
        compression: of the chunks.
        sync_period_s: least seconds between two syncs to the disk.
        clock_ns: nanoseconds for messages that are written without a time.
        metadata: by name, put at the start of every segment, so that each can be read alone.
        attachments: name -> (media type, content), put into the first segment that this writer begins;
            `repeat_attachments`: into all.
        chain: names in every `/update` the digest of what was written before, and seals the log when it is closed; None
            for a log without.
        signer: signs those digests.
        totals: named at the beginning of every segment; None for a log without.
        lock: of the log, where the caller holds it, and goes on holding it after `close`; else the writer takes it.
        on_error: called once, from the writer's thread, with the failure that ended the log. It must not call
            `close`, which waits for that thread.

    Raises:
        LogWriteError: the directory cannot be made or written, or another process writes it.
    """

    def __init__(
        self,
        directory: Path,
        *,
        segment_bytes: int = 1 << 30,
        segment_messages: int = SEGMENT_MESSAGES,
        compression: Compression = "none",
        sync_period_s: float = 1.0,
        clock_ns: Callable[[], int] = time.time_ns,
        metadata: Metadata | None = None,
        attachments: Attachments | None = None,
        repeat_attachments: bool = False,
        chain: Chain | None = None,
        signer: Signer | None = None,
        totals: Totals | None = None,
        lock: LogLock | None = None,
        on_error: Callable[[LogWriteError], None] | None = None,
    ) -> None:
        self._directory = directory
        self._sync_period_s = sync_period_s
        self._clock_ns = clock_ns
        self._on_error = on_error

        self._changed = threading.Condition()
        # Under the condition, from here
        self._queue: deque[_Entry] = deque()
        self._pending_bytes = 0
        self._accepted = self._acknowledged = 0
        self._busy_s = 0.0
        self._stopping = False
        self._failure: LogWriteError | None = None
        # to here; what follows belongs to the thread.
        self._sync_due_s: float | None = None

        self._lock = LogLock(directory) if lock is None else None
        try:
            self._segments = SegmentSequence(
                directory,
                segment_bytes=segment_bytes,
                segment_messages=segment_messages,
                compression=compression,
                clock_ns=clock_ns,
                metadata=metadata or {},
                attachments=attachments or {},
                repeat_attachments=repeat_attachments,
                chain=chain,
                signer=signer,
                totals=totals,
            )
        except OSError as error:
            self._unlock()
            raise write_failure(directory, error) from error
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="log-writer", daemon=True)
        self._thread.start()

    @property
    def pending_bytes(self) -> int:
        """Bytes of the messages that are not in the file yet."""
        with self._changed:
            return self._pending_bytes

    @property
    def busy_s(self) -> float:
        """Seconds the writer's thread has spent so far on commits, their acknowledgements and syncs."""
        with self._changed:
            return self._busy_s

    def write(
        self,
        topic: str,
        data: bytes | Mapping[str, Any],
        *,
        t_ns: int | None = None,
        on_durable: Callable[[], None] | None = None,
    ) -> None:
        """Enqueue one message; returns at once. Messages are in the log in the order of the calls.

        Args:
            topic: one of `CHANNELS`.
            data: the bytes of the message; for a JSON channel also a mapping, whose numbers become null where they
                are not finite.
            t_ns: its time; by default that of the writer's clock.
            on_durable: called in the writer's thread once the message is the operating system's. It must be quick,
                and neither wait for the writer nor raise.

        Raises:
            LogWriteError: the log has failed or is closed, or has no such channel.
            TypeError: `data` is not bytes, or is a mapping with values that JSON has not.
        """
        content = _encode(topic, data)
        entry = _Entry(topic, content, self._clock_ns() if t_ns is None else t_ns, on_durable)
        with self._changed:
            self._raise_if_failed()
            if self._stopping:
                raise LogWriteError(f"the log {self._directory} is closed; write before close()")
            self._queue.append(entry)
            self._pending_bytes += len(content)
            self._accepted += 1
            self._changed.notify_all()

    def flush(self, timeout_s: float) -> None:
        """Wait until every message written before this call is acknowledged.

        Raises:
            LogWriteError: an earlier write failed, or `timeout_s` passed first.
        """
        with self._changed:
            target = self._accepted
            done = self._changed.wait_for(lambda: self._failure is not None or self._acknowledged >= target, timeout_s)
            self._raise_if_failed()
            if not done:
                raise LogWriteError(
                    f"the log {self._directory} was not written within {timeout_s:g} s: {self._pending_bytes} bytes "
                    "wait; the disk is slower than the run, or stuck"
                )

    def close(self) -> None:
        """Write the queued messages and finish the file. A second call does nothing.

        Raises:
            LogWriteError: the log has failed, now or earlier.
        """
        if self._closed:
            return
        self._closed = True
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        self._thread.join()
        self._unlock()
        self._raise_if_failed()

    def __enter__(self) -> LogWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
        else:
            # The error being raised matters more; a failure of the log was reported to `on_error`.
            with contextlib.suppress(LogWriteError):
                self.close()

    def _raise_if_failed(self) -> None:
        if self._failure is not None:
            raise LogWriteError(str(self._failure)) from self._failure

    def _unlock(self) -> None:
        if self._lock is not None:
            self._lock.release()

    def _run(self) -> None:
        try:
            while (group := self._next_group()) is not None:
                if group:
                    self._commit(group)
                self._sync_if_due()
            self._segments.finish()
        except OSError as error:
            self._fail(write_failure(self._segments.path, error), error)
        except Exception as error:
            # Of whatever kind the failure is, the service must not go on without its log.
            self._fail(LogWriteError(f"the log {self._segments.path} stopped: {error!r}"), error)

    def _next_group(self) -> list[_Entry] | None:
        """The queued messages, up to the bytes of one commit; empty when a sync is due; None at the end."""
        with self._changed:
            wait_s = None if self._sync_due_s is None else max(0.0, self._sync_due_s - time.monotonic())
            self._changed.wait_for(lambda: self._queue or self._stopping, wait_s)
            if self._stopping and not self._queue:
                return None
            group: list[_Entry] = []
            size = 0
            while self._queue and size < _GROUP_BYTES:
                group.append(self._queue.popleft())
                size += len(group[-1].data)
            return group

    def _commit(self, group: list[_Entry]) -> None:
        began_s = time.monotonic()
        self._segments.append((entry.topic, entry.t_ns, entry.data) for entry in group)
        if self._sync_due_s is None:
            self._sync_due_s = self._segments.synced_s + self._sync_period_s
        with self._changed:
            self._pending_bytes -= sum(len(entry.data) for entry in group)
        for entry in group:
            if entry.on_durable is not None:
                entry.on_durable()
        with self._changed:
            self._acknowledged += len(group)
            self._busy_s += time.monotonic() - began_s
            self._changed.notify_all()

    def _sync_if_due(self) -> None:
        began_s = time.monotonic()
        if self._sync_due_s is not None and began_s >= self._sync_due_s:
            self._segments.sync()
            self._sync_due_s = None
            with self._changed:
                self._busy_s += time.monotonic() - began_s

    def _fail(self, failure: LogWriteError, cause: BaseException) -> None:
        failure.__cause__ = cause
        self._segments.abandon()
        with self._changed:
            self._failure = failure
            self._queue.clear()
            self._pending_bytes = 0
            self._changed.notify_all()
        if self._on_error is not None:
            self._on_error(failure)


def _encode(topic: str, data: bytes | Mapping[str, Any]) -> bytes:
    if topic not in CHANNELS:
        raise LogWriteError(unknown_name("channel of the log", topic, CHANNELS))
    if isinstance(data, bytes):
        return data
    if CHANNELS[topic].encoding != "json":
        raise TypeError(f"{topic} holds msgpack: give its bytes, not {type(data).__name__}")
    if not isinstance(data, Mapping):
        raise TypeError(f"{topic} holds JSON: give a mapping or its bytes, not {type(data).__name__}")
    return encode_json(data)
