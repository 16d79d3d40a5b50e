"""What the learner's process does around a run: its summary, its events."""

from __future__ import annotations

import json
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples import RUN, settings

from common.errors import LogReadError, LogWriteError, SessionError
from common.log.reader import LogReader
from common.log.writer import LogWriter
from common.wire.endpoint import free_port
from common.wire.messages import Evaluation
from reskpn.commands.status import ask, connect
from reskpn.health import Health, learner_health, port_health
from services.learner import service
from services.learner.reporting.outlets import Events
from services.learner.reporting.statistics import TrainingReturn
from services.learner.reporting.summary import Outcome, conclude, describe, final_record, summarise

# -- the summary -------------------------------------------------------------------------------------------


def finished_run(**changes: Any) -> Outcome:
    """A run of 10 updates of 12 steps, of which the last ended an episode of return 8."""
    returns = TrainingReturn(10, late_sum=8.0, late_count=1, episodes=3)
    values: dict[str, Any] = {"complete": True, "physics": frozenset({"native"}), "env_steps": 120}
    values |= {"steps_per_s": 60.0, "returns": returns, "digest": "ab12"}
    return Outcome(**values | changes)


EVALUATION = Evaluation("r", 0, "a", 10, np.array([10, 30], np.float32), np.array([5, 7], np.int32))
RECORD = final_record(EVALUATION, 800)


def test_the_summary_of_a_run(tmp_path: Path) -> None:
    """All figures in one JSON object. Evaluation: mean of 10 and 30 is 20, standard deviation 10."""
    given = settings(seed=4)
    summary = summarise(given, tmp_path, "run-1", finished_run(), EVALUATION, 2.0004)
    assert json.loads(json.dumps(summary)) == {
        "run": "run-1",
        "task": "inverted_pendulum",
        "learner": "reskpn",
        "physics": "native",
        "seed": 4,
        "actors": 2,
        "total_steps": 120,
        "updates": 10,
        "wall_s": 2.0,
        "env_steps_per_s": 60.0,
        "train_return_mean": 8.0,
        "train_return_over": "last tenth",
        "train_episodes": 3,
        "eval_return_mean": 20.0,
        "eval_return_std": 10.0,
        "eval_episodes": 2,
        "state_digest": "ab12",
        "log": str(tmp_path / "log"),
        "complete": True,
    }


def test_the_summary_of_a_run_that_was_stopped_at_once(tmp_path: Path) -> None:
    """What did not take place is null; the engine is the one that was asked for, and mixed engines are all named."""
    early = finished_run(physics=frozenset(), env_steps=0, steps_per_s=None, returns=TrainingReturn(10))
    summary = summarise(settings(), tmp_path, "run-1", early, None, 1.0)
    nothing = ("env_steps_per_s", "train_return_mean", "eval_return_mean", "eval_return_std")
    assert [summary[name] for name in nothing] == [None] * 4
    assert (summary["eval_episodes"], summary["updates"], summary["physics"]) == (0, 0, "native")
    mixed = summarise(settings(), tmp_path, "run-1", finished_run(physics=frozenset({"native", "mjx"})), None, 1.0)
    assert mixed["physics"] == "mjx+native"


def test_the_summary_has_the_return_that_was_shown(tmp_path: Path) -> None:
    """Where no episode ended in the last tenth of the updates, it is the one that the screen showed last."""
    returns = TrainingReturn(10)
    returns.recall({"version": 2, "count": 3, "return_mean": 1000.0})
    summary = summarise(settings(), tmp_path, "run-1", finished_run(returns=returns), None, 1.0)
    assert (summary["train_return_mean"], summary["train_return_over"]) == (1000.0, "newest episodes")
    assert "  training return over the newest episodes: 1,000.0" in list(describe(summary, tmp_path))


def test_what_says_that_a_run_is_over(tmp_path: Path) -> None:
    """The evaluation is in the log before there is a summary; one that the log has is not written again."""
    with LogWriter(tmp_path / "log") as log:
        conclude(tmp_path, log, {"complete": True}, RECORD)
        assert json.loads((tmp_path / "summary.json").read_text()) == {"complete": True}
        # As it is on the disk while the log is still open.
        (evaluation,) = [message.json() for message in LogReader(tmp_path).messages(["/eval"])]
        assert (evaluation["version"], evaluation["episodes"], evaluation["return_mean"]) == (10, 2, 20.0)
        assert (evaluation["env_steps"], evaluation["source"]) == (800, "run")
        conclude(tmp_path, log, {"complete": True}, None)
    assert LogReader(tmp_path).counts() == {"/eval": 1}


def test_a_summary_that_cannot_be_written(tmp_path: Path) -> None:
    """A sentence with the remedy; the evaluation is in the log, so the run can be resumed."""
    (tmp_path / "summary.json.part").mkdir()
    with LogWriter(tmp_path / "log") as log:
        with pytest.raises(
            LogWriteError, match=r"summary\.json: Is a directory; something else is in its place.* resume the run"
        ):
            conclude(tmp_path, log, {"complete": True}, RECORD)
        assert LogReader(tmp_path).counts() == {"/eval": 1}


def test_the_summary_for_a_person(tmp_path: Path) -> None:
    """State, steps, speed, returns, digest and where the files are."""
    summary = summarise(settings(), tmp_path, "run-1", finished_run(), EVALUATION, 2.0)
    assert list(describe(summary, tmp_path)) == [
        "run-1: finished",
        "  120 steps in 10 updates, 2 s in all, 60 steps/s while training",
        "  training return over the last tenth: 8.0",
        "  evaluation: 20.0 ± 10.0 over 2 episodes with the deterministic policy",
        "  state digest ab12",
        f"  log {tmp_path / 'log'}, summary {tmp_path / 'summary.json'}, curves {tmp_path / 'tensorboard'}",
    ]


def test_the_summary_of_a_stopped_run_for_a_person(tmp_path: Path) -> None:
    """Says so, that the log is complete, and which command goes on; without figures that there are not."""
    early = finished_run(complete=False, env_steps=0, steps_per_s=None, returns=TrainingReturn(10))
    summary = summarise(settings(), tmp_path, "run-1", early, None, 1.0)
    lines = list(describe(summary, tmp_path))
    assert lines[:2] == [
        "run-1: stopped early; the log is complete up to here. Continue with: reskpn train --resume " + str(tmp_path),
        "  0 steps in 0 updates, 1 s in all",
    ]
    assert len(lines) == 4


# -- events ------------------------------------------------------------------------------------------------


class Screen:
    """Keeps the notes; shows nothing."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)

    def show(self, status: object) -> None:
        """Not of interest here."""

    def close(self) -> None:
        """Nothing to put back."""


def test_events_go_to_the_log_and_the_screen(tmp_path: Path) -> None:
    """Level, name and text in the log; on the screen the level only where it is more than information."""
    screen = Screen()
    with LogWriter(tmp_path / "log") as log:
        events = Events(log, screen)
        events.add("info", "actor_joined", "slot 0")
        events.add("warning", "actor_lost", "slot 0 is gone")
    assert screen.notes == ["slot 0", "warning: slot 0 is gone"]
    assert [message.json() for message in LogReader(tmp_path / "log").messages({"/event"})] == [
        {"level": "info", "name": "actor_joined", "text": "slot 0"},
        {"level": "warning", "name": "actor_lost", "text": "slot 0 is gone"},
    ]


def test_an_event_is_shown_when_the_log_is_closed(tmp_path: Path) -> None:
    """The log's failure is reported by itself; what is told meanwhile must not hide it."""
    screen = Screen()
    log = LogWriter(tmp_path / "log")
    log.close()
    with pytest.raises(LogWriteError):
        log.write("/event", {})
    Events(log, screen).add("error", "run_failed", "why")
    assert screen.notes == ["error: why"]


def test_a_run_that_cannot_listen_leaves_no_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A port in use is found before anything is written, so that the same command works once it is free."""
    monkeypatch.setattr(service, "enable_compilation_cache", lambda: None)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        endpoint = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        given = settings(run_dir=tmp_path / "run", transport={"endpoint": endpoint})
        with pytest.raises(SessionError, match=r"port \d+ of .* is in use"):
            service.run_learner(given, stop=threading.Event())
    assert not (tmp_path / "run").exists()


def test_a_resumed_learner_takes_compiled_programs_of_the_environment_it_adopts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cache is chosen after the threads and cores of the run were taken over: others may give other bits."""
    order = []

    def adopt(run_dir: Path) -> list[str]:
        order.append("adopted")
        return []

    def choose_cache() -> None:
        order.append("cache")
        raise LogReadError("stopped by the test")

    monkeypatch.setattr(service, "adopt_numerical_origin", adopt)
    monkeypatch.setattr(service, "enable_compilation_cache", choose_cache)
    given = settings(run_dir=tmp_path, transport={"endpoint": f"tcp/127.0.0.1:{free_port()}"})
    with pytest.raises(LogReadError, match="stopped by the test"):
        service.run_learner(given, stop=threading.Event(), resume=True)
    assert order == ["adopted", "cache"]


def test_a_learner_answers_while_it_reads_its_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Status, the health port and joins say how far it is, from before the log is read: however long that takes, the
    learner is alive, and not ready."""
    endpoint, port = f"tcp/127.0.0.1:{free_port()}", free_port()
    given = settings(run_dir=tmp_path, transport={"endpoint": endpoint, "health_port": port})
    with LogWriter(tmp_path / "log", metadata={"run": {"run": RUN}}) as log:
        log.write("/event", {})
    reading, enough = threading.Event(), threading.Event()

    def read(*_: Any, on_read: Any, **__: Any) -> None:
        on_read(7_000_000, 115_000_000_000)
        reading.set()
        enough.wait(60.0)
        raise LogReadError("stopped by the test")

    monkeypatch.setattr(service, "enable_compilation_cache", lambda: None)
    monkeypatch.setattr(service, "plan_resumption", read)
    with ThreadPoolExecutor(1) as pool:
        ended = pool.submit(service.run_learner, given, stop=threading.Event(), resume=True)
        try:
            assert reading.wait(60.0)
            text = "resuming, 7 of 115,000 MB of the log read"
            found = port_health(port, 15.0)
            assert (found.good, found.text) == (True, f"the learner is {text}")
            assert not port_health(port, 15.0, ready=True).good
            assert learner_health(endpoint, 15.0) == Health(True, f"the learner is {text}; ask again later (run {RUN})")
            with connect(endpoint, 15.0) as session:
                report = ask(session, endpoint, 15.0)
            assert (report.run, report.waiting_for) == (RUN, text)
        finally:
            enough.set()
        with pytest.raises(LogReadError, match="stopped by the test"):
            ended.result(60.0)
