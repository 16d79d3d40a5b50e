"""A second learner on the experience of a recorded run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from recorded_runs import UPDATES, Recording, trainer_settings, write_log

from common.errors import SettingsError
from common.runs.directory import SUMMARY
from common.runs.recorded_run import open_run
from services.learner.training.checkpoints import list_checkpoints, read_checkpoint
from services.learner.training.trainer import Trainer
from services.replay.offline import FIXED, require_same_rollouts, train_offline


def test_the_same_learner_comes_by_the_same_state(trainer: Trainer, recording: Recording, tmp_path: Path) -> None:
    """With the settings of the run its experience leads where the run ended: summary, checkpoint and metrics say so."""
    trainer.restore(recording.start)
    updates = open_run(write_log(tmp_path / "x", recording.messages)).updates()
    settings = trainer_settings().model_copy(update={"run_dir": tmp_path / "made"})
    seen: dict[int, dict[str, float]] = {}
    made = train_offline("run-1", settings, trainer, updates, seen.__setitem__)
    assert made == tmp_path / "made"
    assert seen == {update["version"]: update["metrics"] for _, update in recording.of("/update")}
    summary = json.loads((made / SUMMARY).read_text())
    assert summary["state_digest"] == recording.digests[-1]
    assert (summary["experience_of"], summary["updates"], summary["total_steps"]) == ("run-1", UPDATES, 48)
    assert summary["metrics"] == seen[UPDATES]
    kept = read_checkpoint(list_checkpoints(made)[-1])
    assert (kept.version, kept.digest) == (UPDATES, recording.digests[-1])
    assert list((made / "tensorboard").iterdir())


@pytest.mark.parametrize("name", FIXED)
def test_rollouts_are_as_they_were_made(name: str) -> None:
    """What made them cannot be another; what learns from them can."""
    recorded = trainer_settings()
    require_same_rollouts(recorded, recorded.model_copy(update={"learner": "ppo", "seed": 5}))
    other = recorded.model_copy(update={name: "hopper" if name == "task" else 77})
    with pytest.raises(SettingsError, match=f"^{name} is .*, but the recorded rollouts were made with "):
        require_same_rollouts(recorded, other)


def test_mirrored_steps_are_there_or_not() -> None:
    """A run that branched can only teach a learner that takes pairs, and the other way round."""
    plain = trainer_settings()
    rkhs = plain.rkhs.model_copy(update={"estimate": "symmetric"})
    branching = plain.model_copy(update={"rkhs": rkhs})
    require_same_rollouts(branching, branching)
    with pytest.raises(SettingsError, match=r"made with mirrored steps, .* score takes none; .* symmetric$"):
        require_same_rollouts(branching, plain)
    with pytest.raises(SettingsError, match=r"made without mirrored steps, .*symmetric takes them; .* score$"):
        require_same_rollouts(plain, branching)
