"""The answers that the learner's endpoints have in common."""

from __future__ import annotations

from common.wire.messages import PushReply

QUEUE_FULL = PushReply.busy("queue_full", "the learner's queue is full")

LOG_FAILED = PushReply.busy("log_failed", "the log cannot be written any more: the run stops")
"""The answer while the run is ending; the failure itself is reported by the learner's loop."""
