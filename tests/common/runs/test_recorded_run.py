"""A recorded run, read back from its log alone."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest
from recorded_runs import SECONDS, UPDATES, Message, Recording, batch, made_up, trainer_settings, write_log
from samples import rollout, settings

from common.errors import LogReadError, SettingsError
from common.runs.recorded_run import RecordedRun, open_run
from common.runs.rollout_window import BATCHES, RolloutWindow
from common.wire.rollout import Rollout


@pytest.fixture(scope="module")
def recording() -> Recording:
    return made_up()


@pytest.fixture(scope="module")
def run_dir(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole log in one segment."""
    return write_log(tmp_path_factory.mktemp("run") / "x", recording.messages)


def changed_update(recording: Recording, number: int, **changes: object) -> list[Message]:
    """The messages with fields of one update changed."""
    place, update = recording.of("/update")[number]
    return [*recording.messages[:place], ("/update", update | changes), *recording.messages[place + 1 :]]


def test_a_run_knows_its_settings(run_dir: Path) -> None:
    """And its name, from the first message of the log."""
    run = open_run(str(run_dir))
    assert run.run == "run-1"
    assert run.settings == trainer_settings()
    assert run.count_updates() == UPDATES
    assert run.torn == []


def test_updates_come_with_their_rollouts(run_dir: Path, recording: Recording) -> None:
    """In the order of use, which is not that of the log, bit for bit, with what was recorded of the update."""
    updates = list(open_run(run_dir).updates())
    assert [update.version for update in updates] == [1, 2, 3, 4]
    for update in updates:
        assert [used.key for used in update.rollouts] == [
            (0, "life-0", update.version - 1),
            (1, "life-1", update.version - 1),
        ]
        for found, expected in zip(update.rollouts, batch(update.version), strict=True):
            for field in dataclasses.fields(Rollout):
                np.testing.assert_array_equal(getattr(found, field.name), getattr(expected, field.name))
        assert update.state_digest == f"state-{update.version}"
        assert update.metrics == {"train/kl": update.version / 10}
        assert update.env_steps == 12 * update.version
        assert update.seconds == SECONDS
        assert update.staleness == {"min": 0, "mean": 0.0, "max": 0}
    # messages are a tenth of a second apart; the first update follows spec, event and two rollouts
    assert updates[0].t_ns == 10**18 + 4 * 10**8
    assert updates[1].t_ns - updates[0].t_ns == 3 * 10**8


def test_until_ends_at_a_version(run_dir: Path) -> None:
    """With that one as the last."""
    assert [update.version for update in open_run(run_dir).updates(until=2)] == [1, 2]


def test_rollouts_without_use_are_told(run_dir: Path) -> None:
    """Each to whoever asks, and they disturb nothing."""
    unused: list[Rollout] = []
    assert len(list(open_run(run_dir).updates(on_unused=unused.append))) == UPDATES
    assert [rollout.key for rollout in unused] == [(1, "late", 0)]


def test_a_run_goes_on_over_segments(recording: Recording, tmp_path: Path) -> None:
    """As it does when they roll by size, and when a resumed run writes further ones with /spec again."""
    spec, *rest = recording.messages
    half = len(rest) // 2
    run_dir = write_log(tmp_path, [spec, *rest[:half]], segment_bytes=1000)
    write_log(tmp_path, [spec, *rest[half:]], hardware={"cpu": "another"})
    assert len(list((run_dir / "log").glob("*.mcap"))) > 3
    run = open_run(run_dir)
    assert [update.version for update in run.updates()] == [1, 2, 3, 4]
    assert {origin["cpu"] == "another" for origin in run.origins()} == {True, False}


def test_a_missing_rollout_is_named(recording: Recording, tmp_path: Path) -> None:
    """With the update that names it; the updates before it are given out."""
    place, _ = recording.of("/rollout")[4]  # slot 1 comes first: update 3
    updates = open_run(write_log(tmp_path, recording.without(place))).updates()
    assert [update.version for update in itertools.islice(updates, 2)] == [1, 2]
    with pytest.raises(LogReadError, match=r"update 3 names the rollout of slot 1, incarnation life-1, seq 2, which"):
        next(updates)


def test_a_rollout_is_used_once(recording: Recording, tmp_path: Path) -> None:
    """An update that names one that was used before is no update of a learner."""
    _, first = recording.of("/update")[0]
    updates = open_run(write_log(tmp_path, changed_update(recording, 1, rollouts=first["rollouts"]))).updates()
    next(updates)
    with pytest.raises(LogReadError, match=r"update 2 names the rollout of slot 0, .* or was used before"):
        next(updates)


def test_a_rollout_that_is_there_twice(recording: Recording, tmp_path: Path) -> None:
    """Is no log of a learner either: it would be unclear which was used."""
    place, data = recording.of("/rollout")[0]
    messages = [*recording.messages[:place], ("/rollout", data), *recording.messages[place:]]
    with pytest.raises(LogReadError, match="slot 1, incarnation life-1, seq 0 twice"):
        next(open_run(write_log(tmp_path, messages)).updates())


def test_versions_follow_each_other(recording: Recording, tmp_path: Path) -> None:
    """A gap is said, not passed over."""
    place, _ = recording.of("/update")[1]
    updates = open_run(write_log(tmp_path, recording.without(place))).updates()
    next(updates)
    with pytest.raises(LogReadError, match="update 3 comes after update 1; a part of the log is missing"):
        next(updates)


def test_rollouts_are_those_of_the_run(recording: Recording, tmp_path: Path) -> None:
    """One of another shape, or bytes that are none, are refused with their place in the log."""
    wrong = recording.with_rollout(
        0, lambda rollout: dataclasses.replace(rollout, last_obs=np.zeros((2, 5), np.float32))
    )
    with pytest.raises(LogReadError, match=r"message 2 of /rollout is not a rollout of this run: last_obs"):
        next(open_run(write_log(tmp_path / "a", wrong)).updates())
    place, _ = recording.of("/rollout")[0]
    wrong = [*recording.messages[:place], ("/rollout", b"\x00"), *recording.messages[place + 1 :]]
    with pytest.raises(LogReadError, match=r"message 2 of /rollout is not a rollout of this run"):
        next(open_run(write_log(tmp_path / "b", wrong)).updates())


def test_an_update_that_is_none_is_refused(recording: Recording, tmp_path: Path) -> None:
    """A record without what makes it one."""
    updates = open_run(write_log(tmp_path, changed_update(recording, 0, rollouts=[{"slot": 0}]))).updates()
    with pytest.raises(LogReadError, match=r"message 4 of /update is not the record of an update \(KeyError"):
        next(updates)


def test_what_is_no_run(recording: Recording, tmp_path: Path) -> None:
    """An absent or empty folder, a log without settings, and settings of another version: a sentence each."""
    with pytest.raises(LogReadError, match="does not exist; give a run directory"):
        open_run(tmp_path / "absent")
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogReadError, match="no log in"):
        open_run(tmp_path / "empty")
    with pytest.raises(LogReadError, match="no /spec with the settings of its run"):
        open_run(write_log(tmp_path / "a", recording.messages[1:]))
    spec = ("/spec", {"run": "x", "settings": {"task": "chess"}})
    with pytest.raises(SettingsError, match="task: 'chess' is not a task"):
        open_run(write_log(tmp_path / "b", [spec]))


def test_the_window_is_bounded() -> None:
    """The oldest unused rollouts leave it when there is no room; those that were used give room."""
    unused: list[Rollout] = []
    window = RolloutWindow(1, unused.append)
    for seq in range(BATCHES + 2):
        window.add(rollout(0, "a", seq))
    assert [left.seq for left in unused] == [0, 1]
    assert [taken.seq for taken in window.take(1, [(0, "a", 5), (0, "a", 2)])] == [5, 2]
    for seq in (20, 21):
        window.add(rollout(0, "a", seq))
    assert len(unused) == 2
    with pytest.raises(
        LogReadError, match=r"update 2 names the rollout of slot 0, incarnation a, seq 1, .* the 8 roll"
    ):
        window.take(2, [(0, "a", 1)])
    window.close()
    assert [left.seq for left in unused[2:]] == [3, 4, 6, 7, 8, 9, 20, 21]


def test_memory_is_that_of_the_window(tmp_path: Path) -> None:
    """A long log is not held: of a hundred updates read, only the newest one's rollouts are alive."""
    import weakref

    spec = {"run": "r", "settings": settings(total_steps=12_000).model_dump(mode="json")}
    messages: list[Message] = [("/spec", spec)]
    for version in range(1, 101):
        pair = [rollout(slot, "a", version) for slot in (0, 1)]
        messages += [("/rollout", one.encode()) for one in pair]
        names = [{"slot": one.slot, "incarnation": "a", "seq": version} for one in pair]
        facts = {"version": version, "env_steps": 0, "state_digest": "", "metrics": {}, "seconds": {}, "staleness": {}}
        messages.append(("/update", facts | {"rollouts": names}))
    alive: weakref.WeakSet[Rollout] = weakref.WeakSet()
    most = 0
    for update in RecordedRun(write_log(tmp_path, messages)).updates():
        for used in update.rollouts:
            alive.add(used)
        del used
        most = max(most, len(alive))
    assert most <= 4


def test_a_run_that_branches_is_read(recording: Recording, tmp_path: Path) -> None:
    """With the mirrored step of every environment, as its settings say; one without it is not of this run."""
    estimate = {"estimate": "symmetric", "capacity": 4}
    run = trainer_settings().model_dump(mode="json") | {"rkhs": estimate}
    _, update = recording.of("/update")[0]
    made = {
        "mirror_action": np.ones((2, 1), np.float32),
        "mirror_reward": np.ones(2, np.float32),
        "mirror_terminated": np.zeros(2, bool),
        "mirror_truncated": np.zeros(2, bool),
        "mirror_obs": np.ones((2, 4), np.float32),
    }
    spec = ("/spec", {"run": "run-1", "settings": run})
    rollouts = [("/rollout", dataclasses.replace(one, **made).encode()) for one in batch(1)]
    (read,) = open_run(write_log(tmp_path / "x", [spec, *rollouts, ("/update", update)])).updates()
    assert [len(one.mirror_reward) for one in read.rollouts] == [2, 2]
    plain = [("/rollout", one.encode()) for one in batch(1)]
    with pytest.raises(LogReadError, match=r"is not a rollout of this run: .*mirror_action"):
        list(open_run(write_log(tmp_path / "y", [spec, *plain, ("/update", update)])).updates())


@pytest.mark.parametrize("name", ["metrics", "seconds", "staleness"])
def test_words_in_the_place_of_numbers(recording: Recording, tmp_path: Path, name: str) -> None:
    """Are no record of an update: a sentence, wherever they stand."""
    updates = open_run(write_log(tmp_path, changed_update(recording, 0, **{name: {"x": "much"}}))).updates()
    with pytest.raises(LogReadError, match=r"is not the record of an update \(TypeError\('x is str, not a number'\)\)"):
        next(updates)


def test_a_path_that_is_too_long() -> None:
    """A sentence of the log's, as for every other path that cannot be read."""
    with pytest.raises(LogReadError, match="cannot be read: File name too long"):
        open_run(Path("x" * 300))
