"""Kill -9 at random points of a run, each followed by `--resume`: `make test-chaos`.

Promise: the run ends in the state in which it ends undisturbed; no transition that was acknowledged is missing from
the log, and none was used twice. CHAOS_POINTS says how many points of each kind are tried (20), CHAOS_SEED which.
"""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.chaos.interruptions import (
    LONGEST_DELAY_S,
    OPTIONS,
    SEED,
    UPDATES,
    Apart,
    Processes,
    audited,
    train_until,
    updates_seen,
    wait_for,
)

POINTS = int(os.environ.get("CHAOS_POINTS", "20"))
PATIENCE = 10
"""Updates after which a file that is only there for a moment is not waited for any more."""

WORST = ("ckpt", "env", "part")
"""Suffixes of files in whose writing a run is killed, now and then."""

pytestmark = pytest.mark.timeout(600)


def points(kind: str) -> list[tuple[int, str]]:
    """(number, seed): a point is drawn from its own seed, so that one can be tried again alone."""
    return [(number, f"{SEED}-{kind}-{number}") for number in range(POINTS)]


def moment(run_dir: Path, seed: str) -> tuple[Callable[[], object], float]:
    """When to kill: what to wait for, and the seconds after it. Every fourth time a file being kept is the mark."""
    draw = random.Random(seed)
    updates = draw.randrange(UPDATES - 2 * PATIENCE)
    print(f"CHAOS_SEED={SEED}, point {seed}: ", end="")
    if draw.random() < 0.25:
        suffix = draw.choice(WORST)
        print(f"killed after update {updates}, at the next .{suffix} file")

        def there() -> bool:
            seen = updates_seen(run_dir)
            return seen >= updates and (_newest(run_dir, suffix) >= updates or seen >= updates + PATIENCE)

        return there, 0.0
    delay_s = draw.uniform(0, LONGEST_DELAY_S)
    print(f"killed {delay_s:.3f} s after update {updates}")
    return lambda: updates_seen(run_dir) >= updates, delay_s


def _newest(run_dir: Path, suffix: str) -> int:
    """Version of the newest file of that kind, -1 without one."""
    return max((int(path.name[:8]) for path in (run_dir / "checkpoints").glob(f"*.{suffix}")), default=-1)


@pytest.mark.parametrize(("number", "seed"), points("all"))
def test_all_processes(started: Processes, tmp_path: Path, undisturbed: list[str], number: int, seed: str) -> None:
    """As when a machine is switched off: nothing is left but the files."""
    run_dir = tmp_path / "run"
    there, delay_s = moment(run_dir, seed)
    train_until(started, run_dir, OPTIONS, there, delay_s)
    started.start("train", "--resume", run_dir).end()
    assert audited(run_dir, UPDATES) == undisturbed


@pytest.mark.parametrize(("number", "seed"), points("learner"))
def test_the_learner_alone(started: Processes, tmp_path: Path, undisturbed: list[str], number: int, seed: str) -> None:
    """Its actors stay, and have what they made since the checkpoint only in memory."""
    run_dir = tmp_path / "run"
    there, delay_s = moment(run_dir, seed)
    apart = Apart(started, run_dir, OPTIONS)
    apart.kill_learner(there, delay_s)
    apart.resume_learner()
    apart.end()
    assert audited(run_dir, UPDATES) == undisturbed


@pytest.mark.parametrize(("number", "seed"), points("actor"))
def test_an_actor_and_then_everything(started: Processes, tmp_path: Path, number: int, seed: str) -> None:
    """What its successor was to do cannot be acted again; all is in the log once and used once for all that."""
    run_dir = tmp_path / "run"
    there, _ = moment(run_dir, seed)
    process = started.start("train", *OPTIONS, "--run-dir", run_dir)
    wait_for(there, [process])
    process.kill_an_actor()
    seen = updates_seen(run_dir)
    wait_for(lambda: updates_seen(run_dir) > seen + 2, [process])
    process.kill()
    started.start("train", "--resume", run_dir).end()
    audited(run_dir, UPDATES)
