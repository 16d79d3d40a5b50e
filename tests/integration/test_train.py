"""What a whole run promises: learner and actors as processes, Zenoh between them, the log on disk."""

from __future__ import annotations

import itertools
import subprocess
import sys

import pytest

from common.config.sources import parse_json
from common.log.reader import LogReader
from services.learner.training.checkpoints import list_checkpoints, read_checkpoint
from services.learner.training.trainer import Trainer
from tests.integration.small_runs import (
    ACTORS,
    BATCH,
    ENVS,
    STEPS,
    Training,
    replayed_digests,
    small_run,
    used_rollouts,
)

UPDATES = 12
pytestmark = pytest.mark.timeout(400)  # three processes load and compile for each run


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Training:
    """A run that was left alone to its end."""
    with small_run(tmp_path_factory.mktemp("run") / "a", updates=UPDATES) as training:
        code, output = training.finish()
    assert code == 0, output
    return training


def test_summary(finished: Training) -> None:
    """A run ends with its figures in summary.json."""
    summary = finished.summary
    assert summary["complete"] is True
    assert (summary["task"], summary["learner"], summary["physics"]) == ("inverted_pendulum", "reskpn", "native")
    assert summary["total_steps"] == UPDATES * BATCH
    assert summary["updates"] == UPDATES
    assert summary["eval_episodes"] == 32
    # Every step of inverted_pendulum is worth 1 and an episode is cut at 40.
    assert isinstance(summary["eval_return_mean"], float)
    assert 1.0 <= summary["eval_return_mean"] <= 40.0
    assert isinstance(summary["env_steps_per_s"], float)
    assert summary["env_steps_per_s"] > 0


def test_log_holds_exactly_what_updates_used(finished: Training) -> None:
    """The log holds every transition that an update used, once, and no other; and they give the same states."""
    updates = used_rollouts(finished.run_dir)
    assert len(updates) == UPDATES
    for version, rollouts in enumerate(updates):
        assert [rollout.slot for rollout in rollouts] == list(range(ACTORS))
        assert {rollout.policy_version for rollout in rollouts} == {version}
        assert sum(rollout.reward.size for rollout in rollouts) == BATCH
        assert {rollout.obs.shape for rollout in rollouts} == {(STEPS, ENVS // ACTORS, 4)}
    assert LogReader(finished.run_dir).counts()["/rollout"] == UPDATES * ACTORS
    logged = [update["state_digest"] for update in finished.updates()]
    assert replayed_digests(finished.run_dir) == logged
    assert logged[-1] == finished.summary["state_digest"]


def test_environments_go_on_from_rollout_to_rollout(finished: Training) -> None:
    """A rollout starts at the observation where its slot's last one ended: no step is lost between them."""
    updates = used_rollouts(finished.run_dir)
    for before, after in itertools.pairwise(updates):
        for old, new in zip(before, after, strict=True):
            assert (old.last_obs == new.obs[0]).all()


def test_log_explains_itself(finished: Training) -> None:
    """The log carries settings, versions and the model, and ends without a torn tail."""
    reader = LogReader(finished.run_dir)
    assert not reader.torn
    assert {"run", "settings", "versions", "hardware"} <= set(reader.metadata())
    assert reader.metadata()["versions"]["jax"] != "absent"
    kind, model = reader.attachments()["inverted_pendulum.xml"]
    assert kind == "application/xml"
    assert b"<mujoco" in model
    counts = reader.counts()
    assert counts["/spec"] == 1
    assert counts["/eval"] == 1
    assert counts["/policy"] == 2  # version 10 and the last


def test_checkpoints_are_states_of_the_run(finished: Training) -> None:
    """A checkpoint's digest is the one the log has for its version, and a learner can go on from it."""
    logged = {update["version"]: update["state_digest"] for update in finished.updates()}
    kept = [read_checkpoint(path) for path in list_checkpoints(finished.run_dir)]
    assert [state.version for state in kept] == [5, 10, 12]
    assert [state.digest for state in kept] == [logged[5], logged[10], logged[12]]
    trainer = Trainer(parse_json(LogReader(finished.run_dir).metadata()["settings"]["json"]))
    trainer.restore(kept[1].arrays)
    for rollouts in used_rollouts(finished.run_dir)[10:]:
        trainer.update(rollouts)
    assert trainer.digest() == finished.summary["state_digest"]


def test_a_run_is_verified_from_its_log(finished: Training) -> None:
    """`reskpn replay --verify` in a process of its own comes by every state that the run recorded."""
    command = [sys.executable, "-m", "reskpn", "replay", str(finished.run_dir), "--verify"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert f"all {UPDATES} updates agree, bit for bit" in done.stdout
