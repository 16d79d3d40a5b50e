"""A recorded run as Parquet files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from recorded_runs import RUN, SECONDS, UPDATES, Recording, batch, made_up, trainer_settings, write_log

from common.errors import LogReadError, SettingsError
from common.runs import tables
from common.runs.recorded_run import open_run
from common.runs.tables import EPISODES, EVALUATIONS, FILES, METRICS, ROLLOUTS, extract

ROWS = 6
"""Transitions of a rollout: three steps of two environments."""

OF_RUN = {"run": RUN, "task": "inverted_pendulum", "learner": trainer_settings().learner, "seed": 0}

EVALUATION = {
    "version": 4,
    "env_steps": 48,
    "source": "run",
    "behind": 0,
    "episodes": 3,
    "return_mean": 20.0,
    "return_std": 1.5,
    "return_min": 18.0,
    "return_max": 22.0,
    "length_mean": 20.0,
    "length_std": 1.5,
}


@pytest.fixture(scope="module")
def recording() -> Recording:
    """The second update lacks the metric of the others and has one of its own, the third's was not finite."""
    made = made_up()
    metrics: list[dict[str, Any]] = [{"train/kl": 0.1}, {"rkhs/alpha": 2.0}, {"train/kl": None}, {"train/kl": 0.4}]
    for number, (place, update) in enumerate(made.of("/update")):
        made.messages[place] = ("/update", update | {"metrics": metrics[number]})
    made.messages.append(("/eval", EVALUATION))
    return made


@pytest.fixture(scope="module")
def folder(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What was extracted of it."""
    run_dir = write_log(tmp_path_factory.mktemp("run"), recording.messages)
    seen: list[int] = []
    made = extract(open_run(run_dir), run_dir / "deep" / "tables", lambda update: seen.append(update.version))
    assert seen == [1, 2, 3, 4]
    # two rollouts an update and one without use; two episodes ended at update 2
    assert made == {ROLLOUTS: (2 * UPDATES + 1) * ROWS, EPISODES: 2, METRICS: UPDATES, EVALUATIONS: 1}
    return run_dir / "deep" / "tables"


def rows(folder: Path, name: str) -> list[dict[str, Any]]:
    """The file as a list of rows."""
    found: list[dict[str, Any]] = parquet.read_table(folder / name).to_pylist()
    return found


def test_one_row_a_transition(folder: Path) -> None:
    """In the order of use: update, rollout, step, environment; every number as it was."""
    found = rows(folder, ROLLOUTS)
    expected = [rollout for version in range(1, UPDATES + 1) for rollout in batch(version)]
    for number, rollout in enumerate(expected):
        for place in range(ROWS):
            row = found[ROWS * number + place]
            t, env = divmod(place, 2)
            assert (row["t"], row["env"]) == (t, env)
            assert (row["slot"], row["incarnation"], row["seq"]) == rollout.key
            assert (row["version"], row["policy_version"]) == (number // 2 + 1, rollout.policy_version)
            np.testing.assert_array_equal(np.float32(row["observation"]), rollout.obs[t, env])
            np.testing.assert_array_equal(np.float32(row["action"]), rollout.action[t, env])
            for name in ("log_prob", "reward", "terminated", "truncated"):
                assert row[name] == getattr(rollout, name)[t, env]


def test_columns_have_types_that_other_programs_read(folder: Path) -> None:
    """Observations and actions are lists of fixed size."""
    schema = parquet.read_schema(folder / ROLLOUTS)
    assert schema.field("observation").type == pa.list_(pa.float32(), 4)
    assert schema.field("action").type == pa.list_(pa.float32(), 1)
    assert schema.field("terminated").type == pa.bool_()


def test_rollouts_without_use_have_no_version(folder: Path) -> None:
    """They are there all the same."""
    late = [row for row in rows(folder, ROLLOUTS) if row["version"] is None]
    assert [(row["incarnation"], row["seq"]) for row in late] == [("late", 0)] * ROWS


def test_one_row_an_episode(folder: Path) -> None:
    """With the rollout it ended in."""
    where = OF_RUN | {"version": 2, "slot": 0, "incarnation": "life-0", "seq": 1}
    assert rows(folder, EPISODES) == [where | {"return": 7.0, "length": 7}, where | {"return": 9.0, "length": 9}]


def test_one_row_an_update(folder: Path) -> None:
    """One column a metric; null where an update has it not, and where it was not finite."""
    found = rows(folder, METRICS)
    assert [row["version"] for row in found] == [1, 2, 3, 4]
    assert [row["env_steps"] for row in found] == [12, 24, 36, 48]
    assert [row["state_digest"] for row in found] == ["state-1", "state-2", "state-3", "state-4"]
    assert [row["train/kl"] for row in found] == [0.1, None, None, 0.4]
    assert [row["rkhs/alpha"] for row in found] == [None, 2.0, None, None]
    assert [row["seconds/wait"] for row in found] == [SECONDS["wait"]] * 4
    assert [row["staleness/max"] for row in found] == [0.0] * 4
    assert found[0]["t_ns"] == 10**18 + 4 * 10**8


def test_the_return_of_every_update(folder: Path) -> None:
    """Mean over the episodes that ended in its rollouts, 7 and 9 at update 2; null where none did."""
    found = rows(folder, METRICS)
    assert [row["episodes"] for row in found] == [0, 2, 0, 0]
    assert [row["return"] for row in found] == [None, 8.0, None, None]


def test_one_row_an_evaluation(folder: Path) -> None:
    """Every figure of the `/eval` message, and the run that it is of."""
    assert rows(folder, EVALUATIONS) == [OF_RUN | EVALUATION]


@pytest.mark.parametrize("name", FILES)
def test_every_row_says_which_run_it_is_of(folder: Path, name: str) -> None:
    """Run, task, learner and seed are the first columns, so that the files of several runs can be put together."""
    assert parquet.read_schema(folder / name).names[:4] == list(OF_RUN)
    assert all(row | OF_RUN == row for row in rows(folder, name))


def test_row_groups_are_bounded(recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file is written as the log is read: here a row group a rollout."""
    monkeypatch.setattr(tables, "_GROUP_BYTES", 1)
    extract(open_run(write_log(tmp_path, recording.messages)), tmp_path / "t", lambda _: None)
    groups = parquet.ParquetFile(tmp_path / "t" / ROLLOUTS).metadata
    assert groups.num_row_groups == 2 * UPDATES + 1
    assert groups.row_group(0).num_rows == ROWS


def test_a_file_is_whole_or_absent(recording: Recording, tmp_path: Path) -> None:
    """A log that breaks off leaves none."""
    place, _ = recording.of("/rollout")[4]
    with pytest.raises(LogReadError, match="update 3 names"):
        extract(open_run(write_log(tmp_path, recording.without(place))), tmp_path / "t", lambda _: None)
    assert list((tmp_path / "t").iterdir()) == []


def test_nothing_is_overwritten(recording: Recording, tmp_path: Path) -> None:
    """Files that are there are named; a folder that cannot be one is said."""
    run = open_run(write_log(tmp_path, recording.messages))
    (tmp_path / METRICS).write_text("mine")
    with pytest.raises(SettingsError, match=r"already holds metrics.parquet; choose another"):
        extract(run, tmp_path, lambda _: None)
    assert [name for name in FILES if (tmp_path / name).exists()] == [METRICS]
    with pytest.raises(SettingsError, match=r"/x cannot be written \(Not a directory\); part of the path is a file"):
        extract(run, tmp_path / METRICS / "x", lambda _: None)
    with pytest.raises(SettingsError, match=r"cannot be written \(File name too long\); choose a shorter name"):
        extract(run, tmp_path / ("x" * 300), lambda _: None)
