"""TensorBoard event files."""

from __future__ import annotations

from pathlib import Path

from tensorboardX.proto.event_pb2 import Event
from tensorboardX.record_writer import masked_crc32c

from services.learner.scalars import Scalars


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
