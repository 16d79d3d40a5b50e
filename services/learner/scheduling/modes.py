"""The buffer of each mode."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from common.config.settings import RunSettings
from services.learner.scheduling.async_queue import AsyncQueue
from services.learner.scheduling.buffer import RolloutBuffer
from services.learner.scheduling.slots import Slot
from services.learner.scheduling.sync_batch import SyncBatch


def buffer_factory(settings: RunSettings) -> Callable[[Sequence[Slot]], RolloutBuffer]:
    """The constructor of the buffer that collects rollouts in the run's mode."""
    if settings.mode == "sync":
        return SyncBatch
    return partial(AsyncQueue, max_staleness=settings.staleness, updates=settings.updates)
