"""Sizes of messages that are known before a run begins."""

from __future__ import annotations

from common.config.settings import RunSettings
from common.errors import SettingsError
from common.runs.rollout_shape import rollout_shape


def check_rollout_size(settings: RunSettings) -> None:
    """Raises SettingsError where a rollout of these settings could be larger than a message, or than the queue.

    Zenoh drops a message that is too large without a word, and its sender would try for ever.
    """
    shape, transport = rollout_shape(settings), settings.transport
    size = shape.max_bytes
    what = (
        f"a rollout of {shape.num_envs:,} environments and {shape.num_steps} steps takes up to {size:,} bytes "
        f"({settings.num_envs:,} environments over {settings.actors} actors)"
    )
    remedy = "take fewer environments or steps, or more actors"
    if size > transport.max_message_bytes:
        raise SettingsError(
            f"{what}; transport.max_message_bytes allows {transport.max_message_bytes:,}: raise it, here and for the "
            f"actors, or {remedy}"
        )
    if size > transport.queue_bytes:
        raise SettingsError(
            f"{what}; transport.queue_bytes, the memory for rollouts that wait for the log, is "
            f"{transport.queue_bytes:,}: raise it to two rollouts or more, or {remedy}"
        )


def check_snapshot_size(size: int, settings: RunSettings) -> None:
    """Raises SettingsError for a policy of `size` bytes that is larger than a message."""
    if size > (allowed := settings.transport.max_message_bytes):
        raise SettingsError(
            f"the policy takes {size:,} bytes; transport.max_message_bytes allows {allowed:,}, so no actor could fetch "
            "it: raise it, here and for the actors, or take a smaller network or representation"
        )
