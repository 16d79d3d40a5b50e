"""Logs of many segments, as a learner writes them, and their checkpoints."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from samples import RUN, rollout, settings, snapshot, update_record

from common.config.settings import RunSettings
from common.log.chain import Chain
from common.log.writer import LogWriter
from common.runs.tally import Tally
from common.wire.messages import Environment, digest_arrays
from services.learner.training.checkpoints import KeptEnvironments, write_checkpoint, write_environments

EVERY = 3
"""Versions from one checkpoint to the next."""


def long_settings(**changes: object) -> RunSettings:
    """Forty updates, a checkpoint at every third version."""
    log = {"checkpoint_every": EVERY, **dict(changes.pop("log", {}))}  # type: ignore[call-overload]
    return settings(total_steps=480, log=log, **changes)


def keep_checkpoint(run_dir: Path, version: int, kept: int = 3) -> None:
    """A state, and the environments of both slots."""
    write_checkpoint(run_dir, snapshot(version), kept)
    states = {}
    for slot in (0, 1):
        arrays = {"q": np.full(3, version, np.float32)}
        states[slot] = Environment(RUN, slot, "a", 0, version, version, digest_arrays(arrays), arrays).encode()
    write_environments(run_dir, KeptEnvironments(RUN, version, (1, 1), states))


def write_long_log(
    run_dir: Path,
    updates: int,
    given: RunSettings,
    *,
    unused: int = 0,
    after_update: Callable[[int], None] = lambda version: None,
) -> None:
    """Each update is a segment of its own, and ends as many episodes as its number, of that return."""
    metadata = {"run": {"run": RUN}, "settings": {"json": given.model_dump_json()}}
    log = LogWriter(
        run_dir / "log",
        segment_messages=4,
        metadata=metadata,
        attachments={"model.xml": ("application/xml", b"<mujoco/>")},
        repeat_attachments=given.log.keep != "everything",
        chain=Chain(),
        totals=Tally(given.updates),
    )
    with log:
        for version in range(updates):
            pair = [rollout(slot, "ab"[slot], version, version) for slot in (0, 1)]
            for one in pair:
                log.write("/rollout", one.encode())
            count = version + 1
            log.write("/episode", {"version": count, "count": count, "return_mean": float(count)})
            log.write("/update", update_record(count, snapshot(count).digest, pair))
            log.flush(10.0)
            if count % EVERY == 0:
                keep_checkpoint(run_dir, count)
            after_update(count)
        for slot in range(unused):
            log.write("/rollout", rollout(slot, "ab"[slot], updates, updates).encode())
