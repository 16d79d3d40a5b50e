"""The log of a small run as a learner writes it, made in this process: no physics, the learner's own updates."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from samples import RUN, rollout, settings

from common.config.settings import RunSettings
from common.log.chain import Chain
from common.log.writer import LogWriter
from common.runtime import hardware, software_versions, source_commit
from common.wire.messages import Snapshot, digest_arrays
from common.wire.rollout import Rollout
from services.learner.training.trainer import Trainer

UPDATES = 4
SECONDS = {"wait": 0.5, "learner": 0.25, "publish": 0.125, "record": 0.125, "log": 9.0}
"""Of every update; the loop's phases make one second."""

Message = tuple[str, bytes | dict[str, Any]]


def trainer_settings() -> RunSettings:
    """Of the run below: 12 transitions an update; one epoch, which compiles sooner."""
    algorithm = {"hidden": (8, 8), "minibatches": 2, "epochs": 1}
    return settings(learner="reskpn", total_steps=12 * UPDATES, algorithm=algorithm)


def batch(version: int) -> list[Rollout]:
    """The two rollouts that update `version` uses; at update 2 an episode ends in each of the two ways."""
    slots = [rollout(slot, incarnation=f"life-{slot}", seq=version - 1, policy_version=version - 1) for slot in (0, 1)]
    if version != 2:
        return slots
    terminated, truncated = np.zeros((2, 3, 2), bool)
    terminated[0, 0], truncated[2, 1] = True, True
    ended = {"terminated": terminated, "truncated": truncated, "truncated_obs": np.ones((1, 4), np.float32)}
    episodes = {"episode_return": np.array([7, 9], np.float32), "episode_length": np.array([7, 9], np.int32)}
    first = rollout(0, incarnation="life-0", seq=1, policy_version=1, **ended, **episodes)
    return [first, slots[1]]


@dataclass(frozen=True)
class Recording:
    """What a learner logged, message by message, and the trainer's arrays before the first update."""

    messages: list[Message]
    start: dict[str, np.ndarray]

    @property
    def digests(self) -> list[str]:
        return [content["state_digest"] for _, content in self.of("/update")]

    def of(self, topic: str) -> list[tuple[int, Any]]:
        """The messages of a topic with their places."""
        return [(place, content) for place, (name, content) in enumerate(self.messages) if name == topic]

    def without(self, *places: int) -> list[Message]:
        return [message for place, message in enumerate(self.messages) if place not in places]

    def with_rollout(self, number: int, change: Callable[[Rollout], Rollout]) -> list[Message]:
        """The messages with the rollout that was logged as that number changed."""
        place, data = self.of("/rollout")[number]
        return [
            *self.messages[:place],
            ("/rollout", change(Rollout.decode(data)).encode()),
            *self.messages[place + 1 :],
        ]


def record(trainer: Trainer) -> Recording:
    """Train on made-up rollouts, and log them as a learner does."""
    start = trainer.state_arrays()

    def update(version: int) -> dict[str, Any]:
        metrics = trainer.update(batch(version))
        return {"metrics": metrics, "state_digest": trainer.digest()}

    messages = list(_messages(update))
    arrays = trainer.policy_arrays()
    snapshot = Snapshot(RUN, UPDATES, digest_arrays(arrays), arrays)
    return Recording([*messages, ("/policy", snapshot.encode())], start)


def made_up() -> Recording:
    """A log whose states are names, "state-1" and on; the metric `train/kl` is a tenth of the version."""

    def update(version: int) -> dict[str, Any]:
        return {"metrics": {"train/kl": version / 10}, "state_digest": f"state-{version}"}

    return Recording(list(_messages(update)), {})


def _messages(update: Callable[[int], dict[str, Any]]) -> Iterator[Message]:
    """Of each update its rollouts, the later slot first, then its record; at the end a rollout that came too late."""
    spec = {"run": RUN, "commit": "", "settings": trainer_settings().model_dump(mode="json"), "versions": {}}
    yield "/spec", spec
    yield "/event", {"level": "info", "name": "begun", "text": "begun"}
    for version in range(1, UPDATES + 1):
        rollouts = batch(version)
        yield from (("/rollout", rollout.encode()) for rollout in reversed(rollouts))
        yield "/update", _facts(version, rollouts) | update(version)
    yield "/rollout", rollout(1, incarnation="late", seq=0, policy_version=0).encode()


def _facts(version: int, rollouts: Sequence[Rollout]) -> dict[str, Any]:
    names = ("slot", "incarnation", "seq", "policy_version")
    return {
        "version": version,
        "env_steps": 12 * version,
        "rollouts": [{name: getattr(rollout, name) for name in names} for rollout in rollouts],
        "seconds": SECONDS,
        "staleness": {"min": 0, "mean": 0.0, "max": 0},
    }


def write_log(
    run_dir: Path,
    messages: Iterable[Message],
    *,
    segment_bytes: int = 1 << 30,
    links: Chain | None = None,
    **metadata: dict[str, str],
) -> Path:
    """A run directory with these messages in its log, a tenth of a second apart; `metadata` goes over the usual."""
    usual = {"run": {"run": RUN, "commit": source_commit()}, "versions": software_versions(), "hardware": hardware()}
    with LogWriter(
        run_dir / "log", segment_bytes=segment_bytes, metadata=usual | metadata, chain=links, clock_ns=lambda: 0
    ) as writer:
        for number, (topic, content) in enumerate(messages):
            writer.write(topic, content, t_ns=10**18 + number * 10**8)
            writer.flush(timeout_s=10.0)
    return run_dir
