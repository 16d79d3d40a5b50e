"""Which checkpoint a run goes on from, and what is said of those that it does not."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples import RUN, rollout, settings, snapshot, update_record

from common.errors import CheckpointError, LogReadError, SettingsError
from common.log.writer import LogWriter
from common.wire.messages import Environment, Snapshot, digest_arrays
from services.learner.resume.plan import Resumption, plan_resumption
from services.learner.scheduling.slots import Start
from services.learner.training.checkpoints import KeptEnvironments, write_checkpoint, write_environments

METADATA = {"run": {"run": RUN}}
SETTINGS = settings()
"""Ten updates of two slots."""


def environment(slot: int, version: int, generation: int = 0) -> bytes:
    arrays = {"q": np.full(3, version, np.float32)}
    return Environment(RUN, slot, "a", generation, version, version, digest_arrays(arrays), arrays).encode()


def write_log(
    run_dir: Path,
    updates: int,
    *,
    unused: int = 0,
    early: int = 0,
    generations: Sequence[tuple[int, int]] = (),
    segments: int = 1,
) -> None:
    """A log of so many updates, both slots acting in each, and some rollouts more.

    Args:
        unused: rollouts of the last version, `early`: of the one after it.
        generations: (slot, version) from which on the slot's rollouts are of its next generation.
        segments: files; each takes an equal share of the updates.
    """
    fresh = dict(generations)

    def made(slot: int, version: int) -> Any:
        since = fresh.get(slot, version + 1)
        new = version >= since
        one = rollout(slot, "ab"[slot], version - since if new else version, version)
        return dataclasses.replace(one, generation=int(new))

    share = updates // segments
    for segment in range(segments):
        last = segment == segments - 1
        with LogWriter(run_dir / "log", metadata=METADATA) as log:
            for version in range(segment * share, updates if last else (segment + 1) * share):
                pair = [made(slot, version) for slot in (0, 1)]
                for one in pair:
                    log.write("/rollout", one.encode())
                log.write("/episode", {"version": version + 1, "count": 2, "return_mean": 3.0})
                log.write("/update", update_record(version + 1, snapshot(version + 1).digest, pair))
            if last:
                for slot in range(unused):
                    log.write("/rollout", made(slot, updates).encode())
                for slot in range(early):
                    log.write("/rollout", made(slot, updates + 1).encode())


def keep(run_dir: Path, version: int, *, environments: bool = True, state: Snapshot | None = None) -> Path:
    path = write_checkpoint(run_dir, state or snapshot(version))
    if environments:
        states = {slot: environment(slot, version) for slot in (0, 1)}
        write_environments(run_dir, KeptEnvironments(RUN, version, (1, 1), states))
    return path


def resumed(run_dir: Path) -> Resumption:
    found = plan_resumption(SETTINGS, run_dir)
    assert found is not None
    return found


def test_the_newest_complete_checkpoint(tmp_path: Path) -> None:
    """State, environments, and the tail after it: update 7 and one rollout that no update has used."""
    write_log(tmp_path, 7, unused=1)
    for version in (3, 6):
        keep(tmp_path, version)
    found = resumed(tmp_path)
    assert (found.run, found.version, found.log_only_reason) == (RUN, 6, None)
    assert found.arrays is not None
    assert found.arrays["count"] == 6
    assert found.starts == [Start(0, 6, environment(slot, 6)) for slot in (0, 1)]
    assert [one.id for one in found.tail.rollouts(6)] == [(0, 0, 6), (1, 0, 6)]
    assert [one.id for one in found.tail.rollouts(7)] == [(0, 0, 7)]
    assert [record["version"] for record in found.episodes] == [1, 2, 3, 4, 5, 6]
    assert found.notes[-1].endswith("environments of 2 slots; a tail of 1 updates and 1 rollouts not yet used")


def test_a_batch_is_set_aside(tmp_path: Path) -> None:
    """The logged batch of the next update is none any more, and the same environments do not make it once more: every
    slot begins with new ones. Without a complete batch there is nothing to set aside."""
    write_log(tmp_path, 7, unused=2)
    keep(tmp_path, 6)
    found = plan_resumption(SETTINGS, tmp_path, skip_batch=True)
    assert found is not None
    assert found.tail.unused == []
    assert found.log_only_reason == "the batch that would have updated version 7 was set aside"
    assert found.starts == [Start(1), Start(1)]
    assert "set aside: the 2 rollouts for the update after 7; others replace them" in found.notes
    record = found.set_aside
    assert record is not None
    assert record["version"] == 7
    assert [(one["slot"], one["generation"], one["seq"]) for one in record["rollouts"]] == [(0, 0, 7), (1, 0, 7)]
    write_log(tmp_path / "other", 7, unused=1)
    with pytest.raises(SettingsError, match=r"has 1 of 2 rollouts for the update after 7: there is no complete batch"):
        plan_resumption(SETTINGS, tmp_path / "other", skip_batch=True)


def test_a_batch_stays_set_aside(tmp_path: Path) -> None:
    """The log says so: resumed once more, before or after other rollouts took its place, it needs no option."""
    write_log(tmp_path, 7, unused=2)
    keep(tmp_path, 6)
    first = plan_resumption(SETTINGS, tmp_path, skip_batch=True)
    assert first is not None
    assert first.set_aside is not None
    with LogWriter(tmp_path / "log", metadata=METADATA) as log:
        log.write("/set_aside", first.set_aside)
    second = resumed(tmp_path)
    assert (second.tail.unused, second.starts, second.set_aside) == ([], [Start(1), Start(1)], None)
    pair = [dataclasses.replace(rollout(slot, "cd"[slot], 0, 7), generation=1) for slot in (0, 1)]
    with LogWriter(tmp_path / "log", metadata=METADATA) as log:
        for one in pair:
            log.write("/rollout", one.encode())
        log.write("/update", update_record(8, snapshot(8).digest, pair))
    third = resumed(tmp_path)
    assert third.log_only_reason is not None
    assert [one.id for one in third.tail.rollouts(7)] == [(0, 1, 0), (1, 1, 0)]
    assert third.starts == [Start(2), Start(2)]
    # From a checkpoint after it, acting reproduces the log as ever.
    keep(tmp_path, 8)
    assert resumed(tmp_path).log_only_reason is None


def test_a_batch_is_set_aside_in_async_mode(tmp_path: Path) -> None:
    """The oldest rollouts of the queue, as many as an update takes; those behind them stay."""
    write_log(tmp_path, 7, unused=2, early=1)
    found = plan_resumption(settings(mode="async"), tmp_path, skip_batch=True)
    assert found is not None
    assert [one.id for one in found.tail.unused] == [(0, 0, 8)]


def test_evaluations_of_a_version_may_repeat(tmp_path: Path) -> None:
    """What evaluators found of it, however often, is not the run's own evaluation, which is written once."""
    write_log(tmp_path, 7)
    keep(tmp_path, 6)
    with LogWriter(tmp_path / "log", metadata=METADATA) as log:
        for version, source in ((5, "e"), (7, "e"), (7, "f"), (7, "f")):
            log.write("/eval", {"version": version, "source": source})
    assert not resumed(tmp_path).tail.holds("/eval", 7)
    with LogWriter(tmp_path / "log", metadata=METADATA) as log:
        log.write("/eval", {"version": 7, "source": "run"})
        log.write("/eval", {"version": 7, "source": "e"})
    assert resumed(tmp_path).tail.holds("/eval", 7)


def test_rollouts_that_came_before_the_record_of_their_version(tmp_path: Path) -> None:
    """The actors work for a version as soon as it is published; the update to it is recorded after that. Killed in
    between, the log has rollouts of the version after its last: they count, and are not made a second time."""
    write_log(tmp_path, 7, unused=2, early=1)
    keep(tmp_path, 6)
    found = resumed(tmp_path)
    assert found.log_only_reason is None
    assert [one.id for one in found.tail.rollouts(7)] == [(0, 0, 7), (1, 0, 7)]
    assert [one.id for one in found.tail.rollouts(8)] == [(0, 0, 8)]
    assert found.tail.rollouts(9) == []
    assert found.notes[-1].endswith("a tail of 1 updates and 3 rollouts not yet used")


def test_early_rollouts_of_a_successor(tmp_path: Path) -> None:
    """Theirs is a generation that the log has: no slot begins with it again."""
    write_log(tmp_path, 7, unused=2, early=2, generations=[(1, 8)])
    keep(tmp_path, 6)
    found = resumed(tmp_path)
    assert found.log_only_reason == "version 8 of the run was not acted by one and the same actor in every slot"
    assert found.starts == [Start(1), Start(2)]


def test_without_environments_the_one_before(tmp_path: Path) -> None:
    """It is good, but the run had no time to complete it."""
    write_log(tmp_path, 7)
    keep(tmp_path, 3)
    path = keep(tmp_path, 6, environments=False)
    found = resumed(tmp_path)
    assert found.version == 3
    assert "not from checkpoint 00000006.ckpt: the actors had not handed in their environments" in found.notes
    assert path.exists()


@pytest.mark.parametrize(
    ("q", "what"),
    [
        (np.zeros(4, np.float32), r"q is float32 \[4\]"),
        (np.zeros(3, np.float64), r"q is float64 \[3\]"),
        (np.array([0, np.nan, 0], np.float32), r"q is float32 \[3\], not all of it finite"),
    ],
    ids=["shape", "dtype", "not finite"],
)
def test_environments_that_no_actor_could_go_on_with(tmp_path: Path, q: np.ndarray, what: str) -> None:
    """An actor handed in other arrays than the run's: the checkpoint before is taken, and it is said why."""
    write_log(tmp_path, 7)
    keep(tmp_path, 3)
    path = keep(tmp_path, 6)
    wrong = Environment(RUN, 1, "b", 0, 6, 6, digest_arrays({"q": q}), {"q": q}).encode()
    write_environments(tmp_path, KeptEnvironments(RUN, 6, (1, 1), {0: environment(0, 6), 1: wrong}))
    found = resumed(tmp_path)
    assert found.version == 3
    (note,) = (note for note in found.notes if note.startswith("not from checkpoint 00000006.ckpt"))
    assert re.search(rf"the environments of slot 1 are not as the others of the run \({what}\)", note)
    assert path.exists()


def test_ahead_of_the_log_the_one_before(tmp_path: Path) -> None:
    """A checkpoint is written before the record of its update; a power cut may take the record alone."""
    write_log(tmp_path, 5)
    keep(tmp_path, 3)
    keep(tmp_path, 6)
    found = resumed(tmp_path)
    assert found.version == 3
    assert "not from checkpoint 00000006.ckpt: the log ends at update 5, before it" in found.notes


def write_async_log(run_dir: Path, updates: int, *, segments: int) -> None:
    """A log of so many updates of rollouts one version behind, of slot 0 alone; four more are in the queue."""
    made = [rollout(0, "a", seq, max(0, seq // 2 - 1)) for seq in range(2 * updates + 4)]
    share = updates // segments
    for segment in range(segments):
        with LogWriter(run_dir / "log", metadata=METADATA) as log:
            for version in range(segment * share, (segment + 1) * share):
                # Those of the next update come before this one: actors work on.
                for one in made[2 * version + 2 if version else 0 : 2 * version + 4]:
                    log.write("/rollout", one.encode())
                used = made[2 * version : 2 * version + 2]
                log.write("/update", update_record(version + 1, snapshot(version + 1).digest, used))
            if segment == segments - 1:
                for one in made[2 * updates + 2 :]:
                    log.write("/rollout", one.encode())


@pytest.mark.parametrize("segments", [1, 7])
def test_a_run_in_async_mode(tmp_path: Path, segments: int) -> None:
    """It goes on from the newest state by its log: rollouts of versions before it, and those in the queue, are used.

    Every slot begins with new environments, for what was made depended on the timing.
    """
    write_async_log(tmp_path, 7, segments=segments)
    for version in (3, 6):
        keep(tmp_path, version, environments=False)
    found = plan_resumption(settings(mode="async"), tmp_path)
    assert found is not None
    assert found.version == 6
    assert found.log_only_reason == "in async mode what actors make depends on the timing, and cannot be made again"
    assert found.starts == [Start(1), Start(0)]
    assert [one.id for one in found.tail.rollouts(6)] == [(0, 0, 12), (0, 0, 13)]
    assert [(one.seq, one.policy_version) for one in found.tail.rollouts(7)] == [(14, 6), (15, 6), (16, 7), (17, 7)]


def damage(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)


@pytest.mark.parametrize("suffix", [".ckpt", ".env"])
def test_a_damaged_one_is_put_aside(tmp_path: Path, suffix: str) -> None:
    """With a sentence; the one before serves."""
    write_log(tmp_path, 7)
    keep(tmp_path, 3)
    path = keep(tmp_path, 6)
    damage(path.with_suffix(suffix))
    found = resumed(tmp_path)
    assert found.version == 3
    assert any(note.startswith("warning: ") and "is damaged" in note for note in found.notes)
    assert not path.exists()
    assert path.with_name("00000006.ckpt.bad").exists()


def test_one_of_another_log_is_put_aside(tmp_path: Path) -> None:
    """Its digest is not the one that the log has for its version, or it is of another run."""
    write_log(tmp_path, 7)
    arrays = {"count": np.array(6, np.int32)}
    keep(tmp_path, 6, state=Snapshot(RUN, 6, digest_arrays(arrays), arrays))
    keep(tmp_path, 5, state=dataclasses.replace(snapshot(5), run="run-2"))
    found = resumed(tmp_path)
    assert found.version == 0
    assert any("it is not of this log" in note for note in found.notes)
    assert any("is of the run 'run-2', not of 'run-1'" in note for note in found.notes)


def test_from_the_beginning(tmp_path: Path) -> None:
    """A run that had no checkpoint yet starts as it started, and acts all again."""
    write_log(tmp_path, 2)
    found = resumed(tmp_path)
    assert (found.version, found.arrays, found.log_only_reason) == (0, None, None)
    assert found.starts == [Start(0), Start(0)]
    assert [one.id for one in found.tail.rollouts(0)] == [(0, 0, 0), (1, 0, 0)]
    assert found.notes[-1].startswith("resumed: from the beginning; environments of 0 slots; a tail of 2 updates")


def test_before_the_log_had_begun(tmp_path: Path) -> None:
    """There is nothing to go on from: the run is started."""
    assert plan_resumption(SETTINGS, tmp_path) is None
    (tmp_path / "log").mkdir()
    (tmp_path / "log" / "00000.mcap").write_bytes(b"")
    assert plan_resumption(SETTINGS, tmp_path) is None


def test_a_tail_with_a_lost_actor_is_not_acted_again(tmp_path: Path) -> None:
    """From its update on the log alone decides; every slot goes on as a generation that the log does not have."""
    write_log(tmp_path, 7, generations=[(1, 5)])
    keep(tmp_path, 3)
    found = resumed(tmp_path)
    assert found.log_only_reason == "version 5 of the run was not acted by one and the same actor in every slot"
    assert found.starts == [Start(1), Start(2)]


def test_the_last_version_needs_no_environments(tmp_path: Path) -> None:
    """Only the evaluation was left to be done."""
    write_log(tmp_path, 10)
    keep(tmp_path, 10, environments=False)
    found = resumed(tmp_path)
    assert (found.version, found.log_only_reason, found.tail.after(10)) == (10, None, None)


def test_all_updates_made_but_the_last_checkpoint_lost(tmp_path: Path) -> None:
    """They are made again from the log: nobody has to act for it."""
    write_log(tmp_path, 10)
    keep(tmp_path, 6)
    found = resumed(tmp_path)
    assert (found.version, found.log_only_reason) == (6, "no environments are needed any more")


def test_a_tail_over_several_files(tmp_path: Path) -> None:
    """It is read from the file in which it begins."""
    write_log(tmp_path, 9, segments=3)
    keep(tmp_path, 6)
    found = resumed(tmp_path)
    assert [found.tail.after(version).version for version in (6, 7, 8)] == [7, 8, 9]  # type: ignore[union-attr]


def test_without_beginning_and_checkpoint(tmp_path: Path) -> None:
    """A log whose first files were deleted does not say how the run began."""
    write_log(tmp_path, 9, segments=3)
    (tmp_path / "log" / "00000.mcap").unlink()
    with pytest.raises(CheckpointError, match="no checkpoint to go on from, and its log begins at update 4"):
        plan_resumption(SETTINGS, tmp_path)


def test_what_was_written_ahead_of_its_update(tmp_path: Path) -> None:
    """Is not written again: policy and episodes come before the update that they belong to."""
    write_log(tmp_path, 4)
    with LogWriter(tmp_path / "log") as log:
        log.write("/episode", {"version": 5, "count": 1, "return_mean": 1.0})
        log.write("/policy", snapshot(5).encode())
    tail = resumed(tmp_path).tail
    assert tail.holds("/episode", 5)
    assert tail.holds("/policy", 5)
    assert not tail.holds("/policy", 6)


def test_a_log_of_another_release(tmp_path: Path) -> None:
    """What cannot be decoded is an error with a sentence."""
    write_log(tmp_path, 1)
    with LogWriter(tmp_path / "log") as log:
        log.write("/rollout", b"\x80")
    with pytest.raises(LogReadError, match="resume it with the release that wrote it"):
        plan_resumption(SETTINGS, tmp_path)
