"""The audit of a recorded run: records that can be computed again, and what should be there."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_runs import UPDATES, Message, batch, made_up
from samples import RUN

from common.log.chain import Chain, ChainCheck
from common.log.writer import LogWriter
from common.runs.recorded_run import open_run
from common.wire.messages import Snapshot, digest_arrays
from services.learner.reporting.statistics import Episodes
from services.learner.training.checkpoints import write_checkpoint
from services.replay.audit import Audit

ARRAYS = {"w": np.ones(3, np.float32)}
POLICY = digest_arrays(ARRAYS)
EVALUATION = {"version": 4, "source": "run", "episodes": 2, "return_mean": 20.0, "return_std": 10.0}


def complete_log() -> list[Message]:
    """Of four updates: the episodes of update 2, a policy at every second version, the final evaluation."""
    messages: list[Message] = []
    for topic, content in made_up().messages:
        if topic == "/spec" and isinstance(content, dict):
            content["settings"]["log"]["policy_every"] = 2
        if topic == "/update" and isinstance(content, dict):
            version = content["version"]
            if version % 2 == 0:
                messages.append(("/policy", Snapshot(RUN, version, POLICY, ARRAYS).encode()))
            if record := Episodes.of(batch(version)).record(version):
                messages.append(("/episode", record))
        messages.append((topic, content))
    return [*messages, ("/eval", {"version": 4, "source": "e1", "return_mean": 1.0}), ("/eval", EVALUATION)]


def write(run_dir: Path, messages: list[Message], chain: Chain | None = None) -> Path:
    with LogWriter(run_dir / "log", chain=chain) as log:
        for topic, content in messages:
            log.write(topic, content)
            log.flush(10.0)
    return run_dir


def summarise(run_dir: Path, **changes: Any) -> None:
    summary = {
        "run": RUN,
        "updates": UPDATES,
        "total_steps": 12 * UPDATES,
        "state_digest": f"state-{UPDATES}",
        "train_return_mean": 8.0,
        "train_return_over": "newest episodes",
        "train_episodes": 2,
        "eval_return_mean": 20.0,
        "eval_return_std": 10.0,
        "eval_episodes": 2,
    }
    (run_dir / "summary.json").write_text(json.dumps(summary | changes))


def audited(run_dir: Path, policy: str = POLICY) -> list[str]:
    """The findings of a run whose states all come out as recorded."""
    audit = Audit(open_run(run_dir), ChainCheck(), lambda: policy)
    for update in audit.updates(None):
        audit.check(update, exact=True)
    audit.conclude()
    return [*audit.chain.findings, *audit.findings]


def changed(topic: str, number: int, **changes: Any) -> list[Message]:
    """The log with fields of the message with that number among those of its topic changed."""
    messages = complete_log()
    place = [place for place, (name, _) in enumerate(messages) if name == topic][number]
    content = messages[place][1]
    assert isinstance(content, dict)
    messages[place] = (topic, content | changes)
    return messages


def test_a_run_as_its_learner_left_it(tmp_path: Path) -> None:
    """Nothing is found, with summary and checkpoint beside the log."""
    run_dir = write(tmp_path, complete_log(), Chain())
    summarise(run_dir)
    write_checkpoint(run_dir, Snapshot(RUN, 4, "state-4", ARRAYS))
    found = audited(run_dir)
    # The digest of a checkpoint is one of its arrays, which no made-up state has.
    assert len(found) == 1
    assert "is damaged" in found[0]


@pytest.mark.parametrize(
    ("messages", "finding"),
    [
        (changed("/update", 2, env_steps=360), "the env_steps of update 3 is 360; it should be 36"),
        (
            changed("/update", 0, staleness={"min": 0, "mean": 0.5, "max": 0}),
            "the mean of the staleness of update 1 is 0.5; it should be 0.0",
        ),
        (
            changed("/episode", 0, return_mean=1e9),
            "the return_mean of the episodes of update 2 is 1000000000.0; it should be 8.0",
        ),
        (
            [one for one in complete_log() if one[0] != "/episode"],
            "the episodes that ended in update 2 are not in the log",
        ),
        ([one for one in complete_log() if one[0] != "/policy"], "the policy of version 2 is not in the log"),
        (
            changed("/eval", 1, return_mean=1e9),
            "the eval_return_mean in summary.json is 20.0; it should be 1000000000.0",
        ),
        (complete_log()[:-1], "the eval_return_mean in summary.json is 20.0; it should be None"),
    ],
    ids=["env_steps", "staleness", "episodes", "no episodes", "no policies", "evaluation", "no evaluation"],
)
def test_a_record_that_was_changed_or_removed(tmp_path: Path, messages: list[Message], finding: str) -> None:
    """Is found without a chain, by what it must be."""
    run_dir = write(tmp_path, messages)
    summarise(run_dir)
    assert finding in audited(run_dir)


def test_policies_are_those_of_the_updates(tmp_path: Path) -> None:
    """One that others could be given is compared with the state that the update led to."""
    found = audited(write(tmp_path, complete_log()), policy="another")
    assert found == [
        f"the policy of version {version} in the log is not the one that the update leads to" for version in (2, 4)
    ]


def test_a_log_without_its_end(tmp_path: Path) -> None:
    """Counted against the summary and the checkpoints: the last updates are missing."""
    messages = complete_log()
    third = [place for place, (topic, _) in enumerate(messages) if topic == "/update"][2]
    run_dir = write(tmp_path, messages[: third + 1])
    summarise(run_dir)
    write_checkpoint(run_dir, Snapshot(RUN, 4, POLICY, ARRAYS))
    assert audited(run_dir) == [
        "the log ends at update 3, but there is a checkpoint of version 4: the end of the log is missing",
        "the updates in summary.json is 4; it should be 3",
    ]


def test_a_checkpoint_of_another_state(tmp_path: Path) -> None:
    """Its digest is compared with that of the update."""
    run_dir = write(tmp_path, complete_log())
    write_checkpoint(run_dir, Snapshot(RUN, 4, POLICY, ARRAYS))
    assert audited(run_dir) == [f"the state digest in 00000004.ckpt is '{POLICY}'; it should be 'state-4'"]


def test_a_summary_that_is_none(tmp_path: Path) -> None:
    """Said, and no traceback."""
    run_dir = write(tmp_path, complete_log())
    (run_dir / "summary.json").write_text("[" * 100_000)
    (finding,) = audited(run_dir)
    assert finding.startswith("summary.json cannot be read: ")


@pytest.mark.parametrize(
    ("changes", "finding"),
    [
        ({"train_return_mean": 9.5}, "the train_return_mean in summary.json is 9.5; it should be 8.0"),
        ({"train_episodes": 200}, "the train_episodes in summary.json is 200; it should be 2"),
    ],
)
def test_training_figures_of_the_summary(tmp_path: Path, changes: dict[str, Any], finding: str) -> None:
    """Follow from the episodes that ended in the rollouts: two in update 2, of returns 7 and 9. A summary of an earlier
    release, which took the mean over other episodes, is let pass where the log has no chain."""
    summarise(write(tmp_path / "a", complete_log(), Chain()), **changes)
    assert audited(tmp_path / "a") == [finding]
    summarise(write(tmp_path / "b", complete_log()), **changes)
    text = (tmp_path / "b" / "summary.json").read_text().replace("train_return_over", "_")
    (tmp_path / "b" / "summary.json").write_text(text)
    assert audited(tmp_path / "b") == []
