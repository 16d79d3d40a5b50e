"""Actors that die or leave at bad moments, and a learner that stands still: the run goes on and ends.

Which actor did what is then a matter of timing, so the state is another than the undisturbed run's; that it follows
from the log, bit for bit, `reskpn replay --verify` shows.
"""

from __future__ import annotations

import os
import signal
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from benchmarks.recovery import GOES_ON_S, USED_S, Timeline, compiled_at_s
from tests.chaos.interruptions import (
    OPTIONS,
    UPDATES,
    Apart,
    Processes,
    audited,
    events,
    small_options,
    updates_seen,
    verified,
    wait_for,
)

pytestmark = pytest.mark.timeout(400)

COLLECT = "services.actor.collector:Collector.collect"
PUSH = "services.actor.link:ActorLink.push"
UPDATE = "services.learner.training.trainer:Trainer.update"

LOADED = 3
"""Times what is promised of a quiet machine: these are no measurements (`python -m benchmarks.recovery` makes them)."""

LONG = small_options(5000)
"""Longer than any test: the learner is asked to stop."""

STILL_S = 5.0
STILL = threading.Event()
"""Never set: nothing happens where a process is stopped."""

LOOK_S = 0.1
"""Between two looks at a log that has grown long."""

LEAVES = 10
INTERRUPTED = 130


def asked_to_stop(apart: Apart) -> None:
    """As by Ctrl-C: the log is closed, and the actors go home."""
    os.kill(apart.learner.pid, signal.SIGINT)
    apart.learner.end(INTERRUPTED)
    for actor in apart.actors:
        actor.end()


def test_killed_in_a_push_and_in_a_collect(started: Processes, tmp_path: Path, found: Callable[[str], None]) -> None:
    """Actor killed: the run goes on within 2 s of the loss being noticed; returned: used again within 3 s after it has
    compiled."""
    run_dir = tmp_path / "run"
    apart = Apart(started, run_dir, LONG, [f"slow 0.03 {UPDATE}"], ([f"sent {PUSH} 8"], []))
    apart.actors.pop(0).die()
    # Its successor dies as well, and has one that stays.
    first = recovers(apart, run_dir, tmp_path / "state-1.json", 0, f"sent {COLLECT} 8")
    apart.actors.pop().die()
    second = recovers(apart, run_dir, tmp_path / "state-2.json", 1)
    asked_to_stop(apart)
    audited(run_dir, None)
    verified(started, run_dir)
    goes_on, used = zip(first, second, strict=True)
    assert max(goes_on) < LOADED * GOES_ON_S
    assert max(used) < LOADED * USED_S
    found(f"on after {times(goes_on)}, used {times(used)} after compiling; replay agrees")


def recovers(apart: Apart, run_dir: Path, state: Path, loss: int, *faults: str) -> tuple[float, float]:
    """Seconds from that loss to the next update, and from when a successor had compiled to its first use."""
    wait_for(lambda: went_on_s(run_dir, loss) is not None, [apart.learner], LOOK_S)
    apart.add_actor(*faults, words=["--state-file", state])
    wait_for(lambda: compiled_at_s(state) is not None, [apart.learner], LOOK_S)
    compiled_s = compiled_at_s(state)
    place = (Timeline.of(run_dir).losses[loss][1], loss + 1)
    wait_for(lambda: place in Timeline.of(run_dir).first_used, [apart.learner], LOOK_S)
    on_s = went_on_s(run_dir, loss)
    assert compiled_s is not None
    assert on_s is not None
    return on_s, max(0.0, Timeline.of(run_dir).first_used[place] - compiled_s)


def went_on_s(run_dir: Path, loss: int) -> float | None:
    timeline = Timeline.of(run_dir)
    return timeline.went_on_s(loss) if len(timeline.losses) > loss else None


def times(seconds: Sequence[float]) -> str:
    return " and ".join(f"{one:.2f} s" for one in seconds)


def test_a_stopped_learner(started: Processes, tmp_path: Path, found: Callable[[str], None]) -> None:
    """The learner stands still for 5 s, longer than the lease on both sides: its actors join again, the run ends, and
    every rollout is in the log once and used once."""
    run_dir = tmp_path / "run"
    apart = Apart(started, run_dir, OPTIONS, [f"slow 0.05 {UPDATE}"])
    wait_for(lambda: updates_seen(run_dir) >= 10, [apart.learner])
    os.kill(apart.learner.pid, signal.SIGSTOP)
    try:
        # An actor says so when the lease is over: longer than that is enough.
        wait_for(lambda: all("joining again" in actor.printed() for actor in apart.actors))
        STILL.wait(STILL_S)
    finally:
        os.kill(apart.learner.pid, signal.SIGCONT)
    apart.end()
    assert len(audited(run_dir, UPDATES)) == UPDATES
    verified(started, run_dir)
    counts = Counter(events(run_dir))
    assert counts["actor_joined"] >= 4, counts
    found(f"{counts['actor_lost']} actors given up, {counts['actor_joined']} joins, {UPDATES} updates; replay agrees")


def test_ten_joins_and_leaves(started: Processes, tmp_path: Path, found: Callable[[str], None]) -> None:
    """Ten actors come and go, half of them without a word: the run goes on, and every rollout that was accepted is in
    the log once and used once."""
    run_dir = tmp_path / "run"
    apart = Apart(started, run_dir, LONG, actor_faults=[[f"slow 0.1 {COLLECT}"]])
    (steady,) = apart.actors
    wait_for(lambda: "as slot 0" in steady.printed(), [apart.learner])
    # Those that find no slot stand by, and take over when one is freed.
    passing = [apart.add_actor(f"sent {PUSH} 4" if number % 2 else f"leave {PUSH} 4") for number in range(LEAVES)]
    apart.actors = [steady]
    wait_for(lambda: all(actor.ended() is not None for actor in passing), [apart.learner, steady])
    assert sorted(actor.ended() or 0 for actor in passing) == [-signal.SIGKILL] * 5 + [0] * 5
    last = apart.add_actor()
    place = (1, LEAVES)
    wait_for(lambda: place in Timeline.of(run_dir).first_used, [apart.learner, last], LOOK_S)
    asked_to_stop(apart)
    updates = len(audited(run_dir, None))
    verified(started, run_dir)
    counts = Counter(events(run_dir))
    assert counts["actor_joined"] >= LEAVES + 2, counts
    assert counts["actor_lost"] >= LEAVES, counts
    found(f"{counts['actor_joined']} joins, {counts['actor_lost']} leaves, {updates} updates; replay agrees")
