"""The state that a run began with where its settings alone do not decide it: that of another run, kept in its log."""

from __future__ import annotations

from common.errors import CodecError, LogReadError
from common.log.reader import LogReader
from common.wire.codec import Limits
from common.wire.messages import Snapshot

ATTACHMENT = "initial-state.msgpack"
"""Name of the attachment of the log's first file that has the state, as the learner state of version 0."""

MEDIA_TYPE = "application/vnd.msgpack"

_LIMITS = Limits(max_message=1 << 32, max_bin=1 << 32)


def read_initial_state(log: LogReader) -> Snapshot | None:
    """The state before the first update; None where the settings decide it.

    Raises:
        LogReadError: the log is damaged.
    """
    attached = log.attachments().get(ATTACHMENT)
    if attached is None:
        return None
    try:
        return Snapshot.decode(attached[1], _LIMITS)
    except CodecError as error:
        raise LogReadError(f"the log's {ATTACHMENT} is not a state: {error}; restore the log from a copy") from None
