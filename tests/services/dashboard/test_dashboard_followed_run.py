"""A run that is shown from its directory."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from dashboard_runs import SECRET, append, evaluation, settings, update, write_summary
from reports import progress, report

from common.log.lock import LogLock
from common.wire.credentials import NO_CREDENTIALS
from common.wire.endpoint import free_port
from common.wire.keys import STATUS
from common.wire.session import open_session
from services.dashboard import followed_run
from services.dashboard.followed_run import FollowedRun
from services.dashboard.run_view import Cursor

DEADLINE_S = 20.0


def follow(path: Path, stop: threading.Event) -> FollowedRun:
    return FollowedRun(path, path.name, NO_CREDENTIALS, stop)


def test_a_finished_run(make_run: Callable[..., Path], stop: threading.Event) -> None:
    """Its curves, evaluation, event, settings and final figures; nobody is asked."""
    run = follow(make_run(updates=100, complete=True), stop)
    while run.poll():
        pass
    state = run.view.state
    assert (state["phase"], state["version"], state["updates"], state["total_steps"]) == ("finished", 100, 100, 1200)
    assert state["summary"]["eval_return_mean"] == 12.5
    assert state["settings"]["rkhs.eta"] == "0.1"
    assert (state["task"], state["learner"], state["seed"]) == ("hopper", "reskpn", 3)
    found, _ = run.view.since(Cursor())
    assert found is not None
    assert len(found["columns"]["run/return"]) == 100
    assert found["evaluations"][0]["return_mean"] == 1100.0
    assert SECRET not in json.dumps(found)
    assert run._link is None


def test_it_grows_and_is_resumed_by_another_learner(make_run: Callable[..., Path], stop: threading.Event) -> None:
    """Rows come once; the next learner passes version 3 again, which is left out."""
    path = make_run(updates=3)
    run = follow(path, stop)
    run.poll()
    first, cursor = run.view.since(Cursor())
    assert first is not None
    append(path, ("/update", update(3)), ("/update", update(4)), ("/eval", evaluation(4)))
    run.poll()
    second, _ = run.view.since(cursor)
    assert second is not None
    assert (second["start"], second["columns"]["version"]) == (3, [4])
    assert run.view.evaluation is not None
    assert run.view.evaluation["version"] == 4


def test_a_run_whose_learner_is_gone_is_waited_for(make_run: Callable[..., Path], stop: threading.Event) -> None:
    """The page says how to continue it."""
    path = make_run()
    run = follow(path, stop)
    run.poll()
    assert run.view.state["phase"] == "waiting"
    assert run.view.state["notice"] == (
        f"waiting for the learner: it is not running; continue it with: reskpn train --resume {path}"
    )
    assert [slot["slot"] for slot in run.view.state["logged_slots"]] == [0, 1]


def test_a_run_that_has_not_begun(tmp_path: Path, stop: threading.Event) -> None:
    (tmp_path / "new").mkdir()
    run = follow(tmp_path / "new", stop)
    run.poll()
    assert run.view.state["notice"] == "waiting for the learner: the run has not begun to write yet"


def test_a_run_that_is_being_written_is_not_waited_for(make_run: Callable[..., Path], stop: threading.Event) -> None:
    """Its lock says so, though its learner cannot be asked."""
    path = make_run()
    with LogLock(path / "log"):
        run = follow(path, stop)
        run.poll()
        assert run.view.state["phase"] == "training"


def test_a_damaged_log_is_a_sentence_and_is_tried_again(
    make_run: Callable[..., Path], stop: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was read before stays; once the file is restored all is read from the start."""
    path = make_run()
    segment = path / "log" / "00000.mcap"
    good = segment.read_bytes()
    damaged = bytearray(good)
    damaged[good.index(b"hopper-reskpn")] ^= 1
    segment.write_bytes(damaged)
    run = follow(path, stop)
    run.poll()
    assert "00000.mcap is damaged at byte" in run.view.state["problem"]
    segment.write_bytes(good)
    run.poll()
    assert "problem" in run.view.state
    monkeypatch.setattr(followed_run, "AGAIN_S", 0.0)
    run._again_s = 0.0
    run.poll()
    assert "problem" not in run.view.state
    assert run.view.latest["version"] == 3


def test_the_learner_is_asked_for_the_fleet(make_run: Callable[..., Path], stop: threading.Event) -> None:
    """Its address is in the settings; the state is the learner's own, with every actor. A finished run ends it."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    path = make_run(name="hopper-ppo-s0-ab12", given=settings(transport={"endpoint": endpoint}))
    run = follow(path, stop)
    with open_session(listen=[endpoint], max_message_size=1 << 20) as learner:
        learner.serve(STATUS, lambda request: request.reply(report().encode()))
        end_s = time.monotonic() + DEADLINE_S
        while run.fresh_report() is None and time.monotonic() < end_s:
            run.poll()
            stop.wait(0.05)
        run.poll()
        state = run.view.state
        assert (state["phase"], state["asked"], len(state["actors"])) == ("training", True, 2)
        assert (state["actors"][0]["state"], state["actors"][0]["heard_s"]) == ("collecting", 0.25)
        write_summary(path)
        run.poll()
        assert run.view.state["phase"] == "finished"
    assert run._link is not None
    run._link.join()


def test_a_learner_that_reads_its_log_does_not_set_the_run_back(
    make_run: Callable[..., Path], stop: threading.Event
) -> None:
    """It reports version 0 then; the log has 3."""
    run = follow(make_run(name="hopper-ppo-s0-ab12"), stop)
    run.poll()
    run._on_report(report(progress=progress(phase="resuming", version=0, env_steps=0)))
    run.poll()
    state = run.view.state
    assert (state["phase"], state["version"], state["env_steps"]) == ("resuming", 3, 36)


def test_another_run_at_the_address_is_not_this_one(make_run: Callable[..., Path], stop: threading.Event) -> None:
    """A port is used again: the report of another run is not shown."""
    run = follow(make_run(name="hopper-reskpn-s3-0000"), stop)
    run.poll()
    run._on_report(report())
    assert run.fresh_report() is None
