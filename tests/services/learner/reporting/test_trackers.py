"""Weights & Biases and trackio beside TensorBoard: with packages that are made up here, since none is installed."""

from __future__ import annotations

import sys
import threading
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from common.config.settings import RunSettings
from common.config.sources import load
from common.config.trackers import require_trackers
from common.errors import SettingsError
from services.learner.reporting import trackers
from services.learner.reporting.scalars import Scalars
from services.learner.reporting.trackers import TrackedRun, Tracker, make_tracker


class Recorded:
    """A run of either package: what was called, in order."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, Any]] = []

    def init(self, **given: Any) -> Recorded:
        self.calls.append(("init", given))
        return self

    def define_metric(self, name: str, **given: Any) -> None:
        self.calls.append(("define_metric", name))

    def log(self, values: dict[str, float], step: int | None = None) -> None:
        self.calls.append(("log", (step, values)))

    def finish(self) -> None:
        self.calls.append(("finish", None))


@pytest.fixture
def package(monkeypatch: pytest.MonkeyPatch) -> Recorded:
    """Both packages, as one."""
    recorded = Recorded()
    for name in ("wandb", "trackio"):
        module = ModuleType(name)
        module.__spec__ = ModuleSpec(name, None)
        vars(module).update(init=recorded.init, Settings=dict)
        monkeypatch.setitem(sys.modules, name, module)
    return recorded


def tracked(tmp_path: Path) -> TrackedRun:
    return TrackedRun("hopper-ppo-s0-ab12", {"task": "hopper"}, tmp_path)


@pytest.mark.parametrize(("name", "step"), [("wandb", None), ("trackio", 24)])
def test_the_points_of_the_curves_are_sent(package: Recorded, tmp_path: Path, name: str, step: int | None) -> None:
    """Those that are drawn, and no others: a step that a curve has reached is left out there, too."""
    warned: list[str] = []
    curves = Scalars(tmp_path / "curves", warned.append, [make_tracker(name, tracked(tmp_path), warned.append)])
    curves.add(24, {"train/kl": 0.25, "rkhs/share": None})
    curves.add(24, {"train/kl": 0.5})
    curves.close()
    curves.close()
    begun = dict(package.calls)["init"]
    assert (begun["project"], begun["name"], begun["resume"]) == ("reskpn", "hopper-ppo-s0-ab12", "allow")
    assert begun["config"] == {"task": "hopper"}
    values = {"train/kl": 0.25} | ({} if step else {"env_steps": 24})
    assert [call for call in package.calls if call[0] in ("log", "finish")] == [
        ("log", (step, values)),
        ("finish", None),
    ]
    assert not warned


def test_a_tracker_that_fails_ends_alone(tmp_path: Path) -> None:
    """Whatever it raises, the end of its own process included, is one sentence; the curves go on."""
    warned: list[str] = []

    class Failing:
        def log(self, env_steps: int, values: object) -> None:
            raise SystemExit("not\nlogged in")

        def finish(self) -> None:
            raise AssertionError

    tracker = Tracker("wandb", Failing, warned.append)
    curves = Scalars(tmp_path / "curves", warned.append, [tracker])
    for step in (1, 2, 3):
        curves.add(step, {"a": 1.0})
    tracker._thread.join(20.0)
    curves.close()
    assert warned == ["wandb ended: not logged in; the run goes on, and its log has all numbers"]
    assert curves.reached("a") == 3


def test_no_run_waits_for_a_tracker(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that never answers: points beyond a number are left out with one sentence, and the end is within a limit."""
    monkeypatch.setattr(trackers, "MOST_WAITING", 2)
    monkeypatch.setattr(trackers, "CLOSE_S", 0.05)
    release = threading.Event()
    recorded: list[str] = []

    def stuck() -> Any:
        release.wait(20.0)
        return Recorded()

    tracker = Tracker("trackio", stuck, recorded.append)
    for step in range(5):
        tracker.add(step, {"a": 1.0})
    tracker.close()
    tracker.add(9, {"a": 1.0})
    assert recorded == [
        "trackio is too slow: points are left out there; the log has all numbers",
        "trackio did not finish within 0.05 s: its last points may be missing there",
    ]
    release.set()
    tracker._thread.join(20.0)


def test_the_flag() -> None:
    """One or both; a name that is none of them is refused."""
    assert RunSettings().track == ()
    assert load(environment={"RESKPN_TRACK": "wandb,trackio"}).track == ("wandb", "trackio")
    with pytest.raises(SettingsError, match="track"):
        load(environment={"RESKPN_TRACK": "mlflow"})


def test_a_package_that_is_not_installed(package: Recorded, monkeypatch: pytest.MonkeyPatch) -> None:
    """One sentence with the command, before anything begins."""
    require_trackers(("wandb", "trackio"))
    monkeypatch.delitem(sys.modules, "wandb")
    monkeypatch.setattr("common.config.trackers.find_spec", lambda name: None if name == "wandb" else object())
    with pytest.raises(
        SettingsError, match=r"track wandb,trackio: not installed here; install with: pip install wandb$"
    ):
        require_trackers(("wandb", "trackio"))
