"""TensorBoard event files."""

from __future__ import annotations

from pathlib import Path

import pytest
from tensorboardX.proto.event_pb2 import Event
from tensorboardX.record_writer import masked_crc32c

from services.learner.reporting.scalars import Scalars

FULL = Path("/dev/full")
"""A file that is open and has no room."""


def events(folder: Path) -> list[tuple[str, float, int]]:
    """(name, value, step) of every scalar in the folder's one event file, whose framing must be sound."""
    (path,) = folder.iterdir()
    data = path.read_bytes()
    found, place = [], 0
    while place < len(data):
        size = int.from_bytes(data[place : place + 8], "little")
        body = data[place + 12 : place + 12 + size]
        assert int.from_bytes(data[place + 12 + size : place + 16 + size], "little") == masked_crc32c(body)
        event = Event.FromString(body)
        found += [(value.tag, value.simple_value, event.step) for value in event.summary.value]
        place += 16 + size
    return found


def test_numbers_by_environment_step(tmp_path: Path) -> None:
    """Every name has its value at the step given; what is None is left out."""
    scalars = Scalars(tmp_path / "tensorboard")
    scalars.add(100, {"run/return": None, "loss/value": 0.5})
    scalars.add(200, {"run/return": 12.0, "loss/value": 0.25})
    scalars.close()
    assert events(tmp_path / "tensorboard") == [
        ("loss/value", 0.5, 100),
        ("run/return", 12.0, 200),
        ("loss/value", 0.25, 200),
    ]


def test_a_curve_never_goes_back(tmp_path: Path) -> None:
    """One point a step: what a second evaluator or a resumed run brings once more, or brings late, is left out.

    Curves are counted one by one, and go on where those of the folder's former files end, also of a torn one.
    """
    folder = tmp_path / "tensorboard"
    with_two = Scalars(folder)
    for step, value in ((0, 1.0), (30, 2.0), (30, 3.0), (20, 4.0)):
        with_two.add(step, {"eval/return": value})
    with_two.close()
    (path,) = folder.iterdir()
    assert events(folder) == [("eval/return", 1.0, 0), ("eval/return", 2.0, 30)]
    torn = path.with_name("events.out.tfevents.0.torn")
    path.rename(torn)
    with torn.open("ab") as file:
        file.write(b"\x30\0\0\0\0\0\0\0 and no more")
    resumed = Scalars(folder)
    assert (resumed.reached("eval/return"), resumed.reached("run/return")) == (30, -1)
    resumed.add(30, {"eval/return": 5.0, "run/return": 6.0})
    resumed.add(40, {"eval/return": 7.0})
    resumed.close()
    torn.rename(tmp_path / "aside")
    assert events(folder) == [("run/return", 6.0, 30), ("eval/return", 7.0, 40)]


def test_points_can_be_looked_at_at_once(tmp_path: Path) -> None:
    """After a flush they are in the file, while it is open."""
    scalars = Scalars(tmp_path)
    scalars.add(100, {"loss/value": 0.5})
    scalars.flush()
    assert events(tmp_path) == [("loss/value", 0.5, 100)]
    scalars.close()
    scalars.flush()


def test_settings_for_the_comparison_of_runs(tmp_path: Path) -> None:
    """TensorBoard's HPARAMS tab gets them by name, with the curves that runs are compared by."""
    scalars = Scalars(tmp_path)
    scalars.add_settings({"algorithm.learning_rate": 0.5, "task": "hopper", "slot_wait_s": None}, ["charts/return"])
    scalars.close()
    (path,) = tmp_path.iterdir()
    content = path.read_bytes()
    assert [name in content for name in (b"algorithm.learning_rate", b"hopper", b"slot_wait_s")] == [True, True, False]
    assert content.count(b"charts/return") == 1


def test_a_full_disk_ends_the_curves_and_not_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Said once, when what was held back does not fit; what comes after it goes nowhere, and nothing waits."""
    full = open(FULL, "wb")  # noqa: SIM115  (closed by what it is given to)
    monkeypatch.setattr("tensorboardX.record_writer.open_file", lambda path: full)
    told: list[str] = []
    scalars = Scalars(tmp_path, told.append)
    for step in range(1000):
        scalars.add(step, {"loss/value": 0.5})
    scalars.close()
    assert told == [f"the curves in {tmp_path} end here: No space left on device; the log has all numbers"]
    assert full.closed


def test_a_disk_that_is_full_only_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Closing is the first that fails, and says it as well."""
    full = open(FULL, "wb")  # noqa: SIM115
    monkeypatch.setattr("tensorboardX.record_writer.open_file", lambda path: full)
    told: list[str] = []
    scalars = Scalars(tmp_path, told.append)
    scalars.add(1, {"loss/value": 0.5})
    assert told == []
    scalars.close()
    scalars.close()
    assert len(told) == 1


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    """The run has no curves, and goes on."""
    (tmp_path / "file").touch()
    told: list[str] = []
    scalars = Scalars(tmp_path / "file" / "tensorboard", told.append)
    scalars.add(1, {"loss/value": 0.5})
    scalars.close()
    assert told == [
        f"the curves in {tmp_path / 'file' / 'tensorboard'} end here: Not a directory; the log has all numbers"
    ]
