"""A learner under every wrong message there is, for as long as one likes: `python -m tests.chaos.soak --minutes 60`.

One of two actors is honest; the other delivers its rollouts as it should and sends mutated messages beside them, under
the names that it knows. A client outside sends mutated messages to every key, joins in every role, and comes and goes.
The run must end in the state in which it ends alone; figures of memory and of answers are printed.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from common.errors import ReskpnError
from common.wire.assessment import Assessment
from common.wire.keys import JOIN, STATUS, Keys
from common.wire.messages import Environment, Evaluation, Heartbeat, Join, digest_arrays
from common.wire.report import RunReport
from common.wire.rollout import Rollout
from common.wire.session import Session, open_session
from tests.chaos.interruptions import Apart, audited, processes, small_options
from tests.mutations import Mutator

PER_PUSH_S = 1.0
"""For so long an actor under the fault sends wrong messages beside each of its rollouts."""

ASK_S = 20.0
PROBE_S = 0.25
LARGEST = 8 << 20
LIMIT_BYTES = 64 << 20
LIMIT_S = 1.0


def messages_of(good: Rollout) -> dict[str, bytes]:
    """Messages under the names that the rollout's actor knows, of every kind that a learner takes."""
    run, slot, name, version = good.run, good.slot, good.incarnation, good.policy_version
    ones = {"returns": np.ones(1, np.float32), "lengths": np.ones(1, np.int32)}
    arrays = {"obs": good.last_obs, "steps": np.zeros(len(good.last_obs), np.int32)}
    digest = digest_arrays(arrays)
    return {
        "rollout": good.encode(),
        "environment": Environment(run, slot, name, good.generation, good.seq, version, digest, arrays).encode(),
        "evaluation": Evaluation(run, slot, name, version, ones["returns"], ones["lengths"]).encode(),
        "assessment": Assessment(
            run, "soak", version, ones["returns"], ones["lengths"], np.zeros((1, 2), np.float32), 0.5
        ).encode(),
        "heartbeat": Heartbeat(run, slot, name, "collecting", version, 0, 0.0, 0.0, 1).encode(),
        "join": Join("", "evaluator", "soak", {}, {"host": "soak"}, "native").encode(),
    }


class Shooter:
    """Sends mutated messages over a session."""

    def __init__(self, session: Session, keys: Keys, seed: int) -> None:
        self._session = session
        self._keys = keys
        self._rng = random.Random(seed)
        self._mutator = Mutator(seed, {})
        self._beat = session.publisher(keys.heartbeat(0))
        self.sent: Counter[str] = Counter()

    def shoot(self, messages: dict[str, bytes], slot: int, harmless: Callable[[str, bytes], bool]) -> None:
        """One message, to the key of its kind or to any other."""
        self._mutator.messages = messages
        kind = self._rng.choice(sorted(messages))
        way, data = self._mutator.make(kind)
        if self._rng.random() < 0.01:
            way, data = "large", self._rng.randbytes(64) * (self._rng.randrange(LARGEST) // 64)
        keys = {
            "rollout": self._keys.rollout(slot),
            "environment": self._keys.environment(slot),
            "evaluation": self._keys.evaluation(slot),
            "assessment": self._keys.assessment("soak"),
            "join": JOIN,
            "status": STATUS,
            "policy": self._keys.policy_latest,
        }
        if kind == "heartbeat":
            self._beat.put(data[: 1 << 16])
        else:
            key = kind if self._rng.random() < 0.9 else self._rng.choice(sorted(keys))
            if not harmless(key, data):
                return
            self._session.ask(keys[key], data, ASK_S)
        self.sent[way] += 1


@dataclass
class SoakingActor:
    """Stands in the place of `ActorLink.push`: delivers, and then sends what is wrong about what was delivered."""

    seed: int
    account: Path
    sent: Counter[str] = field(default_factory=Counter)
    _shooter: Shooter | None = None

    def push(self, push: Callable[..., bool], link: Any, rollout: Rollout, stop: Any) -> bool:
        taken = push(link, rollout, stop)
        if self._shooter is None:
            self._shooter = Shooter(link._session, link._keys, self.seed)

        def harmless(key: str, data: bytes) -> bool:
            # What is still valid and new would be used, and rightly: an actor makes the experience of its slot.
            with suppress(ReskpnError):
                made = Rollout.decode(data)
                return made.seq <= rollout.seq or made.policy_version <= rollout.policy_version
            return True

        messages = messages_of(rollout)
        end = time.monotonic() + PER_PUSH_S
        while taken and time.monotonic() < end:
            with suppress(ReskpnError):
                self._shooter.shoot(messages, rollout.slot, harmless)
        self.account.write_text(str(self._shooter.sent.total()))
        return taken


@dataclass
class Watch:
    """The learner's memory and the time of its answers, while strangers send what they can."""

    endpoint: str
    pid: int
    seed: int
    rss: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    sent: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._ended = threading.Event()
        self._threads = [threading.Thread(target=one, daemon=True) for one in (self._probe, self._attack)]

    def __enter__(self) -> Watch:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join(2 * ASK_S)

    def _open(self) -> Session:
        return open_session(connect=[self.endpoint], connect_timeout_s=ASK_S, max_message_size=1 << 28)

    def _probe(self) -> None:
        unanswered: list[str] = []
        with self._open() as session:
            while not self._ended.wait(PROBE_S):
                began_s = time.monotonic()
                try:
                    RunReport.decode(session.ask(STATUS, b"", ASK_S))
                except ReskpnError as error:
                    unanswered.append(str(error))
                    continue
                self.failures += unanswered  # those at the end are of a learner that leaves
                unanswered.clear()
                self.seconds.append(time.monotonic() - began_s)
                self.rss.append(_resident(self.pid))

    def _attack(self) -> None:
        rng = random.Random(self.seed)
        while not self._ended.is_set() and _alive(self.pid):
            with suppress(ReskpnError), self._open() as session:
                report = RunReport.decode(session.ask(STATUS, b"", ASK_S))
                name = f"soak-{rng.randrange(10**6)}"
                role = rng.choice(["actor", "evaluator"])
                session.ask(JOIN, Join("", role, name, {}, {}, "native").encode(), ASK_S)  # type: ignore[arg-type]
                session.declare_alive(Keys(report.run).alive(rng.choice(["evaluator", "stranger"]), name))
                shooter = Shooter(session, Keys(report.run), rng.randrange(10**9))
                messages = messages_of(_made_up(report.run, name))
                until = time.monotonic() + 5.0
                while time.monotonic() < until and not self._ended.is_set():
                    with suppress(ReskpnError):
                        shooter.shoot(messages, rng.randrange(3), lambda key, data: True)
                self.sent.update(shooter.sent)


def _made_up(run: str, name: str) -> Rollout:
    def zeros(*shape: int) -> np.ndarray:
        return np.zeros(shape, np.float32)

    flags = np.zeros((8, 4), bool)
    return Rollout(
        run, 0, name, 0, 0, 1, zeros(8, 4, 4), zeros(8, 4, 1), zeros(8, 4), zeros(8, 4), flags, flags, zeros(4, 4),
        zeros(0, 4), zeros(0), np.zeros(0, np.int32), {"collect": 1.0}, zeros(0, 1), zeros(0), np.zeros(0, bool),
        np.zeros(0, bool), zeros(0, 4),
    )  # fmt: skip


def _resident(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096


def _alive(pid: int) -> bool:
    return Path(f"/proc/{pid}").exists()


@dataclass(frozen=True)
class Soaked:
    """What was found: digests of both runs, messages, memory, times of answers."""

    equal: bool
    updates: int
    messages: int
    before: int
    most: int
    answers: int
    slowest_s: float
    median_s: float
    failures: list[str]

    def __str__(self) -> str:
        return (
            f"{self.messages:,} wrong messages beside {self.updates:,} updates: digests "
            f"{'equal' if self.equal else 'NOT equal'} to the run alone; learner's memory {self.before / 1e6:.0f} MB "
            f"before, at most {self.most / 1e6:.0f} MB; {self.answers:,} answers to status, median "
            f"{1e3 * self.median_s:.0f} ms, slowest {self.slowest_s:.2f} s, {len(self.failures)} without"
        )


def soak(folder: Path, minutes: float, seed: int) -> Soaked:
    """Make both runs, one after the other, and compare them."""
    updates = max(20, round(minutes * 60 / PER_PUSH_S))
    options = small_options(updates)
    account = folder / "account.txt"
    with processes(folder) as started:
        began_s = time.monotonic()
        alone = started.start("train", *options, "--run-dir", folder / "alone")
        alone.ended(60 * minutes * 4 + 240)
        alone.end()
        print(f"alone: {time.monotonic() - began_s:.0f} s", flush=True)
        apart = Apart(started, folder / "run", options, actor_faults=([], [f"soak {seed} {account}"]))
        apart.report_once(lambda report: report.progress is not None and report.progress.version > 5)
        with Watch(apart.endpoint, apart.learner.pid, seed) as watch:
            apart.learner.ended(60 * minutes * 4 + 240)
            print(f"beside wrong messages: {time.monotonic() - began_s:.0f} s in all", flush=True)
        apart.end()
    rss, seconds = watch.rss, sorted(watch.seconds)
    settled = rss[: max(1, len(rss) // 10)]
    return Soaked(
        audited(folder / "run", updates) == audited(folder / "alone", updates),
        updates,
        watch.sent.total() + int(account.read_text()),
        max(settled),
        max(rss),
        len(seconds),
        seconds[-1],
        seconds[len(seconds) // 2],
        watch.failures,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.chaos.soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=5.0, help="how long (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the wrong messages (default: %(default)s)")
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        found = soak(Path(folder), given.minutes, given.seed)
    print(found)
    sound = found.equal and found.most - found.before < LIMIT_BYTES and found.slowest_s < LIMIT_S
    return 0 if sound and not found.failures else 1


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent.parent))
    sys.exit(main())
