"""A recorded run as a curve, a timeline and a result, read from its log in one pass."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from common.config.settings import RunSettings
from common.errors import LogReadError
from common.log.reader import LogReader
from common.runs.recorded_run import RecordedRun
from common.runs.recorded_updates import RecordedUpdate
from reskpn.study.curves import Curve
from reskpn.study.results import Result, Timing, identity, relevant, revision, score


@dataclass
class Timeline:
    """By update: seconds since the first one was logged, seconds by phase, and staleness."""

    t_s: list[float] = field(default_factory=list)
    seconds: list[Mapping[str, float]] = field(default_factory=list)
    staleness: list[float] = field(default_factory=list)


@dataclass
class RunRecord:
    """The content of a recorded run that a report or a comparison shows."""

    run: str
    settings: RunSettings
    curve: Curve
    timeline: Timeline
    metadata: Mapping[str, Mapping[str, str]]
    digest: str = ""
    evaluations: list[dict[str, Any]] = field(default_factory=list)
    events: list[tuple[float, str]] = field(default_factory=list)

    @property
    def complete(self) -> bool:
        return self.curve.updates == self.settings.updates


def read_run(path: Path) -> RunRecord:
    """Read a run's log.

    Raises:
        LogReadError: there is no log, it is damaged, or it has no update.
        SettingsError: this version has no such settings.
    """
    run = RecordedRun(path)
    if not run.whole:
        raise LogReadError(
            f"{path}: the first {run.before.version} updates were removed from the log (log.keep), so its curve is not "
            "there; give a run that keeps everything"
        )
    record = RunRecord(run.run, run.settings, Curve(run.settings.batch_size), Timeline(), LogReader(path).metadata())
    began_ns = 0
    for message, content in run.messages():
        began_ns = began_ns or message.t_ns
        if isinstance(content, RecordedUpdate):
            _add(record, content, began_ns)
        elif message.topic == "/eval":
            record.evaluations.append(message.json())
        elif message.topic == "/event":
            record.events.append(((message.t_ns - began_ns) / 1e9, str(message.json().get("text", ""))))
    if not record.curve.updates:
        raise LogReadError(f"{path}: the log has no update yet; wait for the run's first, or give another run")
    return record


def result_of(record: RunRecord) -> Result:
    """The record as a result, like one of `reskpn paper run`."""
    settings, curve, times = record.settings, record.curve, record.timeline
    wall_s = max(times.t_s[-1], 1e-9)
    own = [each for each in record.evaluations if each.get("source", "run") == "run"]
    evaluation = {"mean": own[-1]["return_mean"], "std": own[-1]["return_std"]} if own else None
    phases = {name for seconds in times.seconds for name in seconds}
    meta = record.metadata
    return Result(
        identity=identity(settings),
        revision=revision(settings),
        settings=relevant(settings),
        route="service",
        engine=settings.physics,
        curve=curve.table(),
        scores=score(curve, settings.episode_length, evaluation),
        spreads={},
        timing=Timing(
            wall_s=round(wall_s, 3),
            cpu_s=None,
            env_steps_per_s=round(curve.updates * settings.batch_size / wall_s, 1),
            seconds={name: round(sum(s.get(name, 0.0) for s in times.seconds), 3) for name in sorted(phases)},
        ),
        digest=record.digest,
        commit=meta.get("run", {}).get("commit", "unknown"),
        versions=dict(meta.get("versions", {})),
        machine={name: text for name, text in meta.get("hardware", {}).items() if name != "host"},
        finished_at="",
    )


def _add(record: RunRecord, update: RecordedUpdate, began_ns: int) -> None:
    returns = np.concatenate([rollout.episode_return for rollout in update.rollouts])
    reward = float(np.mean([rollout.reward.mean(dtype=np.float64) for rollout in update.rollouts]))
    record.curve.add(returns, reward, update.metrics)
    record.timeline.t_s.append((update.t_ns - began_ns) / 1e9)
    record.timeline.seconds.append(update.seconds)
    record.timeline.staleness.append(float(update.staleness.get("mean", 0.0)))
    record.digest = update.state_digest
