"""A run whose first segments were removed by retention: what is still verified, and what is said of the rest."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_runs import RUN, UPDATES, batch, made_up, trainer_settings

from common.errors import LogReadError, SettingsError
from common.log.chain import Chain, ChainCheck
from common.log.segments import list_segments
from common.log.writer import LogWriter
from common.runs.needed_segments import read_tally
from common.runs.recorded_run import RecordedRun, open_run
from common.runs.tables import extract
from common.runs.tally import Tally
from common.wire.messages import Snapshot, digest_arrays
from reskpn.commands.replay import updates_to_read
from reskpn.commands.verdicts import describe_retention
from services.learner.reporting.statistics import Episodes
from services.learner.training.checkpoints import write_checkpoint
from services.replay.audit import Audit
from services.replay.beginning import read_beginning


def state(version: int) -> Snapshot:
    arrays = {"w": np.full(3, version, np.float32)}
    return Snapshot(RUN, version, digest_arrays(arrays), arrays)


def write_run(run_dir: Path, keep: int | str = 1) -> Path:
    """Four updates in several segments, a checkpoint of version 3; the segments that begin before update 1 removed."""
    settings = trainer_settings()
    settings = settings.model_copy(update={"log": settings.log.model_copy(update={"keep": keep})})
    metadata = {"run": {"run": RUN}, "settings": {"json": settings.model_dump_json()}}
    log = LogWriter(run_dir / "log", segment_messages=3, metadata=metadata, chain=Chain(), totals=Tally(UPDATES))
    with log:
        for topic, content in made_up().messages:
            if topic == "/event":
                continue
            if topic == "/update" and isinstance(content, dict):
                content["state_digest"] = state(content["version"]).digest
                if record := Episodes.of(batch(content["version"])).record(content["version"]):
                    log.write("/episode", record)
            log.write(topic, content)
            if topic != "/spec":
                log.flush(10.0)
    write_checkpoint(run_dir, state(3))
    for path in list_segments(run_dir / "log"):
        if read_tally(path, UPDATES).version < 1:
            path.unlink()
    return run_dir


def audited(run_dir: Path) -> tuple[Audit, list[int]]:
    run = open_run(run_dir)
    audit = Audit(run, ChainCheck(), lambda: "", read_beginning(run))
    versions = []
    for update in audit.updates(None):
        audit.check(update, exact=False)
        versions.append(update.version)
    audit.conclude()
    return audit, versions


def test_it_is_read_from_where_it_is_whole(tmp_path: Path) -> None:
    """Update 1 was removed, perhaps with rollouts of update 3, which are not logged before it: the first that is whole
    for certain is 4."""
    run = open_run(write_run(tmp_path))
    assert (run.whole, run.before.version, run.first, run.newest, run.count_updates()) == (False, 1, 4, 4, 1)
    assert run.settings.task == "inverted_pendulum"
    assert [update.version for update in run.updates()] == [4]
    assert updates_to_read(run, None) == 1
    with pytest.raises(SettingsError, match="has updates 4 to 4; give one of them"):
        updates_to_read(run, 2)
    assert extract(run, tmp_path / "tables", lambda update: None)["metrics.parquet"] == 1


def test_what_is_verified(tmp_path: Path) -> None:
    """From the checkpoint on, whose digest the log names; figures of the summary count what was removed."""
    run_dir = write_run(tmp_path)
    summary = {
        "run": RUN,
        "updates": 4,
        "total_steps": 48,
        "state_digest": state(4).digest,
        "train_return_mean": 8.0,
        "train_return_over": "newest episodes",
        "train_episodes": 2,
        "eval_return_mean": None,
        "eval_return_std": None,
        "eval_episodes": 0,
    }
    (run_dir / "summary.json").write_text(json.dumps(summary))
    audit, versions = audited(run_dir)
    assert versions == [4]
    assert audit.findings == []
    assert audit.chain.findings == []
    lines = list(describe_retention(open_run(run_dir), read_beginning(open_run(run_dir))))
    assert lines[0].startswith("the first 1 updates were removed by retention (log.keep 1): nothing of them was ")
    assert "updates 2 to 3" in lines[0]
    assert "follows from" in lines[1]
    assert "00000003.ckpt" in lines[1]


def test_a_beginning_that_nobody_was_to_remove(tmp_path: Path) -> None:
    """Is a finding: the run keeps everything."""
    audit, _ = audited(write_run(tmp_path, keep="everything"))
    assert audit.findings == ["the first 1 updates were removed, although log.keep is everything"]


def test_a_checkpoint_that_is_not_of_the_log(tmp_path: Path) -> None:
    """Is a finding: the log names another digest for its version."""
    run_dir = write_run(tmp_path)
    write_checkpoint(run_dir, Snapshot(RUN, 3, state(9).digest, dict(state(9).arrays)))
    audit, _ = audited(run_dir)
    assert f"state digest in {run_dir / 'checkpoints' / '00000003.ckpt'} is '{state(9).digest}'" in audit.findings[0]


def test_without_a_checkpoint_to_begin_with(tmp_path: Path) -> None:
    """There is nothing to make the updates of, which is said."""
    run_dir = write_run(tmp_path)
    (run_dir / "checkpoints" / "00000003.ckpt").unlink()
    with pytest.raises(LogReadError, match=r"removed by retention \(log.keep 1\), and beside the log is no checkpoint"):
        read_beginning(open_run(run_dir))


def test_a_log_of_an_earlier_release_needs_its_beginning(tmp_path: Path) -> None:
    """Its segments do not name what was before them."""
    from recorded_runs import write_log

    messages: Any = made_up().messages
    run_dir = write_log(tmp_path, messages, segment_bytes=1)
    list_segments(run_dir / "log")[0].unlink()
    with pytest.raises(LogReadError, match="no /spec with the settings of its run"):
        RecordedRun(run_dir)
