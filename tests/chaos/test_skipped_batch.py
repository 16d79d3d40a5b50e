"""A run whose next logged batch makes an update that is not finite."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from common.log.chain import METADATA as CHAIN
from common.log.chain import Chain
from common.log.reader import LogMessage, LogReader
from common.log.totals import METADATA as TOTALS
from common.log.writer import LogWriter
from common.runs.recorded_run import open_run
from common.runs.tally import Tally
from common.wire.rollout import Rollout
from tests.chaos.interruptions import Processes, small_options, summary, train_until, updates_seen, verified

pytestmark = pytest.mark.timeout(900)  # three processes load and compile at every start

UPDATES = 14
OPTIONS = [*small_options(UPDATES, episodes=2), "--learner", "ppo"]


def test_a_run_goes_past_a_batch_that_cannot_be_used(started: Processes, tmp_path: Path) -> None:
    """A logged batch that no update can be made of ends the run with a sentence, each time, and `--skip-batch` finishes
    it. The batch is as an earlier release let it in: its log-probabilities make the importance ratio infinite. The run
    ends complete, evaluated and verified; the batch is in the log and in no update."""
    run_dir = tmp_path / "run"
    train_until(started, run_dir, OPTIONS, lambda: updates_seen(run_dir) >= 7)
    version = replace_what_follows(run_dir)
    for _ in range(2):
        printed = started.start("train", "--resume", run_dir).end(7)
        assert f"update {version + 1} made the" in printed
        assert "not finite; it was not applied" in printed
        assert "--skip-batch" in printed
    printed = started.start("train", "--resume", run_dir, "--skip-batch").end()
    assert f"set aside: the 2 rollouts for the update after {version}" in printed
    assert summary(run_dir)["complete"] is True
    assert summary(run_dir)["eval_episodes"] == 2
    (set_aside,) = [message.json() for message in LogReader(run_dir).messages(["/set_aside"])]
    unused: list[Rollout] = []
    updates = list(open_run(run_dir).updates(on_unused=unused.append))
    assert [update.version for update in updates] == list(range(1, UPDATES + 1))
    forged = {(one["slot"], one["incarnation"], one["seq"]) for one in set_aside["rollouts"]}
    assert forged <= {made.key for made in unused}
    assert not forged & {made.key for update in updates for made in update.rollouts}
    verified(started, run_dir)
    assert "this run has finished" in started.start("train", "--resume", run_dir).end()


def replace_what_follows(run_dir: Path) -> int:
    """Cut the log after its last update and add a batch that makes the next one infinite; returns its version."""
    last = list(open_run(run_dir).updates())[-1]
    reader = LogReader(run_dir)
    metadata = {name: values for name, values in reader.metadata().items() if name not in (CHAIN, TOTALS)}
    log = LogWriter(
        run_dir / "changed",
        metadata=metadata,
        attachments=reader.attachments(),
        chain=Chain(),
        totals=Tally(UPDATES),
    )
    with log:
        for message in up_to(reader, last.data):
            if message.topic != "/seal":
                log.write(message.topic, message.data, t_ns=message.t_ns)
        for made in last.rollouts:
            low = np.full_like(made.log_prob, -1e6)
            forged = dataclasses.replace(made, seq=made.seq + 1, policy_version=last.version, log_prob=low)
            log.write("/rollout", forged.encode())
    shutil.rmtree(run_dir / "log")
    (run_dir / "changed").rename(run_dir / "log")
    return last.version


def up_to(reader: LogReader, data: bytes) -> Iterator[LogMessage]:
    """The messages up to the one with these bytes."""
    for message in reader.messages():
        yield message
        if message.data == data:
            return
