"""The steps of one run in containers, and their expected results.

Three slots and two actors; one actor is killed, the fleet is scaled to three, one process crashes, then the
learner does, and the run ends; an evaluator is beside it all the time.
"""

from __future__ import annotations

import json
import os
import re
import signal
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from common.log.reader import LogReader
from common.printable import shortened
from common.wire.rollout import Rollout
from scripts.docker_test.project import SERVICES, Project

# Many small updates: they are to last longer than it takes an actor to load and compile, on any machine.
SLOTS, UPDATES, ENVS, STEPS = 3, 3000, 12, 5
SETTINGS = {
    "RESKPN_ACTORS": str(SLOTS),
    "RESKPN_SLOT_WAIT_S": "20",
    "RESKPN_NUM_ENVS": str(ENVS),
    "RESKPN_NUM_STEPS": str(STEPS),
    "RESKPN_TOTAL_STEPS": str(UPDATES * ENVS * STEPS),
    "RESKPN_ALGORITHM__HIDDEN": "[16,16]",
    "RESKPN_ALGORITHM__MINIBATCHES": "2",
    "RESKPN_ALGORITHM__EPOCHS": "2",
    "RESKPN_RKHS__CAPACITY": "64",
    "RESKPN_LOG__CHECKPOINT_EVERY": "100",
    "RESKPN_EVALUATION__EPISODES": "8",
    "RESKPN_EPISODE_LENGTH": "50",
    "ACTOR_REPLICAS": "2",
    "EVALUATOR_EVERY": "100",
    "EVALUATOR_EPISODES": "4",
}
ASK_FOR_TAGS = [
    "python", "-c",
    "import urllib.request as r; print(r.urlopen('http://127.0.0.1:6006/data/plugin/scalars/tags').read())",
]  # fmt: skip
JOINED = re.compile(r"slot (\d) \(generation (\d+)\): native on \S+, incarnation (\w+)")


@dataclass
class Story:
    """One run; the steps build on each other."""

    project: Project
    killed: str = ""
    crashed: str = ""
    began_s: float = 0.0
    lost_s: float = 0.0
    log: Logged = field(init=False)

    def steps(self) -> dict[str, Callable[[], None]]:
        """The steps by the property they show."""
        return {
            "first updates with two of three actors": self.first_updates,
            "learner, two actors and the evaluator are healthy": self.all_are_healthy,
            "one actor killed, the other does its work": self.one_is_killed,
            "scaled to three during the run": self.scaled_to_three,
            "one process crashes and is started again": self.one_crashes,
            "the learner crashes, is started again and goes on with the run": self.learner_crashes,
            "the run ends by itself, all with exit code 0": self.the_run_ends,
            "summary": self.the_summary,
            "log": self.the_log,
            "evaluations, in the log and in TensorBoard": self.the_evaluations,
        }

    def first_updates(self) -> None:
        """With two actors the run begins, without the third slot's actor."""
        self.began_s = time.time()
        self.project.compose("up", "-d", "--no-build")
        self.project.wait_for("the first update", lambda: self.project.updates() >= 1)
        assert len(self.project.containers("actor")) == 2
        assert "no actor after 20 s in slot 2: others do its work" in self.project.learner_words()

    def all_are_healthy(self) -> None:
        """The learner answers join requests, the others hold a policy."""
        everyone = [one for service in SERVICES for one in self.project.containers(service)]
        assert len(everyone) == 4
        self.project.wait_for("health", lambda: {self.project.health(one) for one in everyone} == {"healthy"})

    def one_is_killed(self) -> None:
        """Killed as by an operator, it is not restarted: the other actor does its work."""
        self.killed = self.project.containers("actor")[0]
        self.project.docker("kill", self.killed)
        self.project.wait_for("its loss", lambda: "is gone" in self.project.learner_words())
        before = self.project.updates()
        self.project.wait_for("updates after it", lambda: self.project.updates() > before)
        assert self.project.state(self.killed)["Status"] == "exited"

    def scaled_to_three(self) -> None:
        """During the run, in the same learner; the killed actor is started again as one of them."""
        learner = self.project.containers("learner")
        self.project.compose("up", "-d", "--no-build", "--scale", "actor=3")
        actors = self.project.containers("actor")
        assert len(actors) == 3
        self.project.wait_for("three actors", lambda: len(self._joined()) == 4)
        self.project.wait_for("health of three", lambda: {self.project.health(one) for one in actors} == {"healthy"})
        assert self.project.containers("learner") == learner

    def one_crashes(self) -> None:
        """The engine restarts it, and it joins with a slot."""
        self.crashed = next(one for one in self.project.containers("actor") if one != self.killed)
        os.kill(int(self.project.state(self.crashed)["Pid"]), signal.SIGKILL)
        self.project.wait_for("a restart", lambda: self.project.state(self.crashed)["RestartCount"] == 1)
        self.project.wait_for("its return", lambda: len(self._joined()) == 5)

    def learner_crashes(self) -> None:
        """The engine restarts the learner, it resumes, and the same actors rejoin."""
        (learner,) = self.project.containers("learner")
        actors = self.project.containers("actor")
        before, crash_s = self.project.updates(), time.monotonic()
        os.kill(int(self.project.state(learner)["Pid"]), signal.SIGKILL)
        self.project.wait_for("its restart", lambda: self.project.state(learner)["RestartCount"] == 1)
        self.project.wait_for("later updates", lambda: self.project.updates() > before)
        self.lost_s = time.monotonic() - crash_s
        assert "resumed: " in self.project.learner_words()
        assert self.project.containers("actor") == actors
        assert {self.project.state(one)["Status"] for one in actors} == {"running"}

    def the_run_ends(self) -> None:
        """Every container stops by itself with exit code 0, and the learner prints the summary."""
        self.project.wait_for("the end", lambda: not self.project.running(), deadline_s=1200.0)
        everyone = [one for service in SERVICES for one in self.project.containers(service)]
        codes = {one[:12]: self.project.state(one)["ExitCode"] for one in everyone}
        assert set(codes.values()) == {0}, f"{codes}\n{self.project.last_words()}"
        words = self.project.learner_words()
        assert "finished" in words
        assert f"{UPDATES * ENVS * STEPS:,} steps in {UPDATES} updates" in words

    def the_summary(self) -> None:
        """The summary on the volume: complete, with the requested steps and the native engine."""
        with tempfile.TemporaryDirectory() as folder:
            self.project.docker("cp", f"{self.project.containers('learner')[0]}:/data/runs/.", folder)
            runs = list(Path(folder).iterdir())
            assert len(runs) == 1
            summary = json.loads((runs[0] / "summary.json").read_text())
            self.log = read_log(runs[0])
        assert summary["complete"] is True
        assert (summary["updates"], summary["total_steps"]) == (UPDATES, UPDATES * ENVS * STEPS)
        assert (summary["physics"], summary["eval_episodes"]) == ("native", 8)
        assert summary["state_digest"] == self.log.updates[-1]["state_digest"]

    def the_log(self) -> None:
        """The log has every update once and in order, its transitions before it, from actors that joined."""
        assert [update["version"] for update in self.log.updates] == list(range(1, UPDATES + 1))
        assert self.log.unlogged == 0
        assert all(len(update["rollouts"]) == SLOTS for update in self.log.updates)
        by_life = self.log.used_by_life()
        lives = {incarnation for _, _, incarnation in self._joined()}
        assert {shortened(life) for life in by_life} <= lives
        # Two at first, one more by scaling, the killed and the crashed one again; and all that joined the new learner.
        assert len(lives) >= 6
        assert len(by_life) >= 5, f"rollouts by life: {by_life}"
        first = {used["slot"] for used in self.log.updates[0]["rollouts"]}
        assert first == {0, 1}
        assert {used["slot"] for update in self.log.updates for used in update["rollouts"]} == {0, 1, 2}

    def the_evaluations(self) -> None:
        """Evaluations from before and after the learner's crash; TensorBoard shows their curve."""
        sources = {source for source, _ in self.log.evaluations if source != "run"}
        assert len(sources) == 2, f"the evaluator joins each learner under a new name: {self.log.evaluations}"
        assert ("run", UPDATES) in self.log.evaluations
        self.project.compose("--profile", "tensorboard", "up", "-d", "--no-build", "--no-deps", "tensorboard")
        (viewer,) = self.project.containers("tensorboard")
        self.project.wait_for("TensorBoard", lambda: self.project.health(viewer) == "healthy")
        self.project.wait_for("the curve", lambda: "eval/return" in self.project.docker("exec", viewer, *ASK_FOR_TAGS))

    @property
    def first_update_s(self) -> float:
        """Seconds from `up` to the first update's record in the log."""
        return self.log.first_update_s - self.began_s

    def _joined(self) -> set[tuple[str, ...]]:
        """(slot, generation, incarnation as the learner shows it) of every actor that has joined so far."""
        return {found.groups() for found in JOINED.finditer(self.project.learner_words())}


@dataclass(frozen=True)
class Logged:
    """A run's updates, the number of their rollouts not logged before them, and the time of the first update."""

    updates: list[dict[str, Any]]
    unlogged: int
    first_update_s: float
    evaluations: list[tuple[str, int]]
    """Source and version."""

    def used_by_life(self) -> dict[str, int]:
        """The number of rollouts used, by whole incarnation: the log has it, the screen only its start."""
        counts: dict[str, int] = defaultdict(int)
        for update in self.updates:
            for used in update["rollouts"]:
                counts[used["incarnation"]] += 1
        return dict(counts)


def read_log(run_dir: Path) -> Logged:
    updates: list[dict[str, Any]] = []
    seen: set[tuple[int, str, int]] = set()
    evaluations: list[tuple[str, int]] = []
    unlogged, times_ns = 0, []
    for message in LogReader(run_dir).messages(["/rollout", "/update", "/eval"]):
        if message.topic == "/eval":
            evaluations.append((message.json()["source"], message.json()["version"]))
            continue
        if message.topic == "/rollout":
            seen.add(Rollout.decode(message.data).key)
            continue
        updates.append(message.json())
        times_ns.append(message.t_ns)
        named = {(used["slot"], used["incarnation"], used["seq"]) for used in updates[-1]["rollouts"]}
        unlogged += len(named - seen)
        seen -= named
    return Logged(updates, unlogged, min(times_ns) / 1e9, evaluations)
