"""Re-execution of a recorded run: what agrees, and where it first does not."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from recorded_runs import UPDATES, Message, Recording, write_log

from common.errors import LogReadError
from common.runs.recorded_run import open_run
from common.wire.rollout import Rollout
from services.learner.training.trainer import Trainer
from services.replay.verify import MetricDifference, Verdict, metric_differences, verify


class Verifier:
    """Verifies logs with the same trainer, from its first state each time; `seen` are the versions that agreed."""

    def __init__(self, trainer: Trainer, start: dict[str, np.ndarray], folder: Path) -> None:
        self._trainer = trainer
        self._start = start
        self._folder = folder
        self.seen: list[int] = []

    def __call__(self, messages: list[Message], *, until: int | None = None, allow_other_bits: bool = False) -> Verdict:
        self._trainer.restore(self._start)
        self.seen.clear()
        updates = open_run(write_log(self._folder / "run", messages)).updates(until=until)
        return verify(
            updates,
            self._trainer,
            allow_other_bits=allow_other_bits,
            on_update=lambda update: self.seen.append(update.version),
        )


@pytest.fixture
def verified(trainer: Trainer, recording: Recording, tmp_path: Path) -> Verifier:
    return Verifier(trainer, recording.start, tmp_path)


def nudged(rollout: Rollout) -> Rollout:
    """The rollout with one number of one observation a thousandth larger."""
    obs = rollout.obs.copy()
    obs[0, 0, 0] *= 1.001
    return dataclasses.replace(rollout, obs=obs)


def test_a_whole_log_agrees(verified: Verifier, recording: Recording) -> None:
    """Every update, bit for bit; a rollout that no update used does not matter."""
    verdict = verified(recording.messages)
    assert verdict.agrees
    assert (verdict.updates, verdict.tolerance_from, verdict.divergence) == (UPDATES, None, None)
    assert verified.seen == [1, 2, 3, 4]


def test_until_a_version(verified: Verifier, recording: Recording) -> None:
    """What comes after it is not looked at."""
    place, update = recording.of("/update")[2]
    messages = [
        *recording.messages[:place],
        ("/update", update | {"state_digest": "00"}),
        *recording.messages[place + 1 :],
    ]
    assert verified(messages, until=2).updates == 2
    messages = messages[: place + 1]
    assert verified(messages, until=2).agrees


def test_speed_is_held_against_the_loop_of_the_run(trainer: Trainer, recording: Recording, tmp_path: Path) -> None:
    """Without the first update, and without what the run did beside its loop: 3 updates of one second each."""
    trainer.restore(recording.start)
    ticks = iter([0.0, 100.0, 102.0])  # start, end of the first update, end of all
    verdict = verify(
        open_run(write_log(tmp_path, recording.messages)).updates(),
        trainer,
        allow_other_bits=False,
        on_update=lambda _: None,
        clock_s=lambda: next(ticks),
    )
    assert (verdict.live_s, verdict.replay_s, verdict.speed) == (3.0, 2.0, 1.5)


@pytest.mark.parametrize(("number", "version"), [(0, 1), (3, 2), (7, 4)])
def test_a_tampered_rollout_is_found_at_its_update(
    verified: Verifier, recording: Recording, number: int, version: int
) -> None:
    """One observation a little off, in either slot: the digests of the update that used it differ."""
    verdict = verified(recording.with_rollout(number, nudged))
    divergence = verdict.divergence
    assert divergence is not None
    assert not verdict.agrees
    assert verdict.updates == version - 1
    assert verified.seen == list(range(1, version))
    assert (divergence.version, divergence.recorded_digest) == (version, recording.digests[version - 1])
    assert len(divergence.recomputed_digest) == 32
    assert divergence.recomputed_digest != divergence.recorded_digest


def test_metrics_that_differ_are_named(verified: Verifier, recording: Recording) -> None:
    """With both values; those that are equal are left out."""
    verdict = verified(
        recording.with_rollout(2, lambda rollout: dataclasses.replace(rollout, reward=rollout.reward + 10))
    )
    assert verdict.divergence is not None
    assert verdict.divergence.version == 2
    _, update = recording.of("/update")[1]
    found = {metric.name: metric for metric in verdict.divergence.metrics}
    assert found["train/value_loss"].recorded == update["metrics"]["train/value_loss"]
    assert found["train/value_loss"].recomputed != update["metrics"]["train/value_loss"]
    assert "rkhs/centres" not in found


def test_an_update_that_cannot_be_applied_diverges(verified: Verifier, recording: Recording) -> None:
    """A reward so large that the update is not finite: said at that update, without a digest."""
    verdict = verified(
        recording.with_rollout(
            4, lambda rollout: dataclasses.replace(rollout, reward=np.full_like(rollout.reward, 3e38))
        )
    )
    assert verdict.divergence is not None
    assert (verdict.divergence.version, verdict.divergence.recomputed_digest) == (3, "")
    assert "not finite" in verdict.divergence.reason


def test_other_bits_are_compared_in_their_metrics(verified: Verifier, recording: Recording) -> None:
    """Where they are allowed: an observation a little off makes other states from there on, and metrics much alike."""
    verdict = verified(recording.with_rollout(2, nudged), allow_other_bits=True)
    assert verdict.agrees
    assert (verdict.updates, verdict.tolerance_from) == (UPDATES, 2)


def test_other_metrics_are_not_other_bits(verified: Verifier, recording: Recording) -> None:
    """A rollout with other rewards is found by the metrics too; those named are out of tolerance."""
    verdict = verified(
        recording.with_rollout(2, lambda rollout: dataclasses.replace(rollout, reward=rollout.reward * 100)),
        allow_other_bits=True,
    )
    assert verdict.divergence is not None
    assert verdict.divergence.version == 2
    assert verdict.divergence.metrics


def test_a_log_without_its_beginning_cannot_be_verified(verified: Verifier, recording: Recording) -> None:
    """There is no state to start from."""
    first, _ = recording.of("/update")[0]
    with pytest.raises(LogReadError, match=r"the log begins with update 2: .* restore the removed segments"):
        verified(recording.without(first))


@pytest.mark.parametrize(
    ("new", "exact", "loose"),
    [(1.0, True, True), (1.0000001, False, True), (1.249, False, True), (1.251, False, False), (None, False, False)],
)
def test_metrics_within_tolerance(new: float | None, exact: bool, loose: bool) -> None:
    """1 may come out as 0.75 to 1.25, 0.05 and a fifth of it; a number never as none."""
    recomputed = {"kl": float("nan") if new is None else new}
    assert (not metric_differences({"kl": 1.0}, recomputed, exact=True)) is exact
    assert (not metric_differences({"kl": 1.0}, recomputed, exact=False)) is loose


def test_metrics_that_are_not_there() -> None:
    """A metric of one side only differs; what was not finite in the run and is not now does not."""
    recorded: dict[str, float | None] = {"a": 1.0, "c": None}
    recomputed = {"b": 2.0, "c": float("inf")}
    expected = (MetricDifference("a", 1.0, None), MetricDifference("b", None, 2.0))
    for exact in (True, False):
        assert metric_differences(recorded, recomputed, exact=exact) == expected
