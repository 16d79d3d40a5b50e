"""A run with a long log is resumed from its newest checkpoint's segment on, and keeps as much as `log.keep` says."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest
from long_logs import keep_checkpoint, long_settings, write_long_log

from common.errors import CheckpointError
from common.log.reader import LogReader
from common.log.segments import list_segments
from services.learner.reporting.statistics import TrainingReturn
from services.learner.resume.logged_run import LogIndexer
from services.learner.resume.plan import Resumption, fresh_starts, plan_resumption
from services.learner.resume.restore_point import RestorePoint
from services.learner.resume.retention import Retention, checkpoints_to_keep
from services.learner.scheduling.slots import Start

SETTINGS = long_settings()


def resumed(run_dir: Path, settings: Any = SETTINGS, **options: Any) -> Resumption:
    found = plan_resumption(settings, run_dir, **options)
    assert found is not None
    return found


def returns(found: Resumption) -> TrainingReturn:
    result = TrainingReturn(40, episodes=found.earlier_episodes)
    for record in found.episodes:
        result.recall(record)
    return result


def test_only_what_the_checkpoint_needs_is_read(tmp_path: Path) -> None:
    """Of twenty segments, those from that of update 17 on: the checkpoint is of version 18, and rollouts of version 18
    are not written before update 17 is. A damaged older segment is not even noticed."""
    write_long_log(tmp_path, 20, SETTINGS, unused=1)
    segments = list_segments(tmp_path / "log")
    whole = LogIndexer(tmp_path, SETTINGS).since(0)
    segments[5].write_bytes(segments[5].read_bytes().replace(b"log_prob", b"log_prof", 1))
    seen: list[tuple[int, int]] = []
    found = resumed(tmp_path, on_read=lambda done, total: seen.append((done, total)))
    assert found.version == 18
    assert "the log was read from 00016.mcap on; the 16 files before it are not needed" in found.notes
    assert [update.version for update in (found.tail.after(18), found.tail.after(19)) if update] == [19, 20]
    assert [one.id for one in found.tail.rollouts(20)] == [(0, 0, 20)]
    assert seen[-1][1] == sum(path.stat().st_size for path in list_segments(tmp_path / "log")[16:])
    assert found.chain == whole.chain.digest
    assert found.tally is not None
    assert found.tally.metadata() == whole.tally.metadata()


def test_figures_are_those_of_the_whole_log(tmp_path: Path) -> None:
    """Episodes of updates 1 to 18: 1 + ... + 18 = 171 in all, the newest 200 being all of them."""
    write_long_log(tmp_path, 20, SETTINGS)
    part, whole = TrainingReturn(40), returns(resumed(tmp_path))
    for version in range(1, 19):
        part.recall({"version": version, "count": version, "return_mean": float(version)})
    assert whole.episodes == 171
    assert (whole.newest, whole.late, whole.episodes) == (part.newest, part.late, part.episodes)


def test_an_older_checkpoint_reads_more(tmp_path: Path) -> None:
    """The newest has no environments, the one before it is damaged: the log is read from the third one's segment on."""
    write_long_log(tmp_path, 20, SETTINGS)
    (tmp_path / "checkpoints" / "00000018.env").unlink()
    (tmp_path / "checkpoints" / "00000015.ckpt").write_bytes(b"x")
    found = resumed(tmp_path)
    assert found.version == 12
    assert "the log was read from 00010.mcap on; the 10 files before it are not needed" in found.notes


def test_new_generations_are_new_to_the_whole_log(tmp_path: Path) -> None:
    """In async mode every slot goes on with new environments, of a generation that no older segment has either."""
    settings = long_settings(mode="async")
    write_long_log(tmp_path, 20, settings)
    log = LogIndexer(tmp_path, settings)
    logged = log.since(18)
    assert log.skipped
    assert logged.before.generations == {0: 0, 1: 0}
    logged.before.generations[1] = 6
    assert fresh_starts(2, RestorePoint(18, None, []), logged) == [Start(1), Start(7)]


@pytest.mark.parametrize("keep", [1, 2])
def test_old_segments_are_deleted(tmp_path: Path, keep: int) -> None:
    """As soon as newer checkpoints are complete; what is left is resumed as the whole log would be, and every segment
    has the attachments. Checkpoint 18 needs the segments from 16 on, checkpoint 15 those from 13 on."""
    settings = long_settings(log={"keep": keep})
    told: list[str] = []
    retention = Retention(settings, tmp_path, told.append)
    write_long_log(tmp_path, 20, settings, unused=1, after_update=retention.apply)
    left = [path.name for path in list_segments(tmp_path / "log")]
    first = {1: "00016.mcap", 2: "00013.mcap"}[keep]
    assert (left[0], left[-1]) == (first, "00020.mcap")
    assert told[-1].startswith(f"log.keep {keep}: ")
    assert set(LogReader(tmp_path / "log" / first).attachments()) == {"model.xml"}
    write_long_log(tmp_path / "whole", 20, long_settings(), unused=1)
    part, whole = resumed(tmp_path, settings), resumed(tmp_path / "whole")
    # Each log has its own digests, and the records that are in it by now.
    own: dict[str, Any] = {"notes": [], "chain": "", "tally": None, "arrays": None, "logged_records": {}}
    assert dataclasses.replace(part, tail=whole.tail, **own) == dataclasses.replace(whole, **own)
    assert [one.id for one in part.tail.rollouts(19)] == [one.id for one in whole.tail.rollouts(19)]


def test_nothing_is_deleted_before_a_newer_checkpoint_is_complete(tmp_path: Path) -> None:
    """Neither for a state whose environments are not kept yet, nor where there are fewer checkpoints than wanted."""
    settings = long_settings(log={"keep": 2})
    write_long_log(tmp_path, 6, settings)
    (tmp_path / "checkpoints" / "00000006.env").unlink()
    Retention(settings, tmp_path, lambda text: None).apply(6)
    assert len(list_segments(tmp_path / "log")) == 6
    keep_checkpoint(tmp_path, 6)
    Retention(settings, tmp_path, lambda text: None).apply(5)
    assert len(list_segments(tmp_path / "log")) == 6
    Retention(long_settings(), tmp_path, lambda text: None).apply(6)
    assert len(list_segments(tmp_path / "log")) == 6
    Retention(settings, tmp_path, lambda text: None).apply(6)
    assert len(list_segments(tmp_path / "log")) == 5


def test_without_any_checkpoint_that_what_is_left_begins_before(tmp_path: Path) -> None:
    """The run cannot be gone on with, and that is said, as of a log whose beginning was lost."""
    settings = long_settings(log={"keep": 1})
    write_long_log(tmp_path, 20, settings, after_update=Retention(settings, tmp_path, lambda text: None).apply)
    (tmp_path / "checkpoints" / "00000018.ckpt").write_bytes(b"x")
    with pytest.raises(CheckpointError, match="no checkpoint to go on from, and its log begins at update 17"):
        plan_resumption(settings, tmp_path)


def test_as_many_checkpoints_are_kept_as_the_log_is_kept_for() -> None:
    """Three, or one more than the log is kept for: the newest is not complete at first."""
    assert [checkpoints_to_keep(long_settings(log={"keep": keep})) for keep in ("everything", 1, 2, 5)] == [3, 3, 3, 6]
