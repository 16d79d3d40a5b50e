"""A learner's hub, and an actor's readers, under wrong messages: every handler is called as the session calls it.

Rounds alternate: good actors come, bring a batch and must be taken; then mutated messages arrive at every door, made
from messages that would be good at that moment. What became of each is counted here, by the answers, and must be what
the learner reports.
"""

from __future__ import annotations

import random
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mirrors import no_mirror
from mutations import Mutator

from common.config.settings import RunSettings
from common.config.sources import parse_json
from common.errors import CodecError, ReskpnError
from common.log.reader import LogReader
from common.log.writer import LogWriter
from common.physics.state_shapes import state_shapes
from common.runs.rollout_shape import rollout_shape
from common.tasks import TASKS
from common.wire.assessment import Assessment
from common.wire.keys import JOIN, STATUS, Keys
from common.wire.messages import (
    ACCEPTED,
    Environment,
    Evaluation,
    Heartbeat,
    Join,
    JoinReply,
    Orders,
    PushReply,
    Snapshot,
    digest_arrays,
)
from common.wire.report import Progress, RunReport
from common.wire.rollout import Rollout
from common.wire.session import Request
from services.learner.endpoints.hub import Hub
from services.learner.reporting.evaluations import source_of

RUN = "run-1"
KEYS = Keys(RUN)
DEADLINE_S = 30.0
ROUND = 40
EPISODES = 2
EVALUATOR = "evaluator-1"

SETTINGS = RunSettings.model_validate(
    {
        "actors": 2,
        "num_envs": 16,
        "num_steps": 5,
        "total_steps": 800,
        "algorithm": {"hidden": (8, 8), "minibatches": 2},
        "physics": "native",
    }
)
TASK = TASKS[SETTINGS.task]
SHAPE = rollout_shape(SETTINGS)


class Doors:
    """Stands for a session: keeps the handlers, so that they can be called."""

    def __init__(self) -> None:
        self.served: dict[str, Callable[[Request], None]] = {}
        self.heard: dict[str, Callable[[str, bytes], None]] = {}
        self.watched: dict[str, Callable[[str, bool], None]] = {}

    def serve(self, key: str, handler: Callable[[Request], None]) -> None:
        self.served[key] = handler

    def subscribe(self, key: str, handler: Callable[[str, bytes], None]) -> None:
        self.heard[key] = handler

    def watch_alive(self, key: str, handler: Callable[[str, bool], None]) -> None:
        self.watched[key] = handler

    def declare_alive(self, key: str) -> None:
        """Nobody watches."""

    def publisher(self, key: str, **_: bool) -> Any:
        class Nobody:
            def put(self, data: bytes) -> None:
                """Goes to nobody."""

        return Nobody()


@dataclass
class Siege:
    """The hub, what is known about the good actors, and what became of the messages."""

    directory: Path
    seed: int
    sent: Counter[str] = field(default_factory=Counter)
    ways: Counter[str] = field(default_factory=Counter)
    refused: dict[str, Counter[str]] = field(default_factory=dict)
    answers: Counter[str] = field(default_factory=Counter)
    joined: int = 0
    turned_away: int = 0
    assessed: set[int] = field(default_factory=set)
    version: int = 0
    names: list[str] = field(default_factory=list)
    generations: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._rng = random.Random(self.seed)
        self.log = LogWriter(self.directory)
        self._doors = Doors()
        doors: Any = self._doors
        self.hub = Hub(RUN, SETTINGS, doors, self.log, lambda *_: None)
        self.hub.publish(_snapshot(0))
        self.hub.open()
        self.hub.publish_progress(STATUS_NOW)
        self.hub.ask_for_evaluation(EPISODES)
        self._join_evaluator()
        self._mutator = Mutator(self.seed, self._good())
        self._attacks: dict[str, Callable[[bytes], None]] = {
            "rollout": self._attack_rollout,
            "environment": self._attack_environment,
            "evaluation": self._attack_evaluation,
            "assessment": self._attack_assessment,
            "join": self._attack_join,
            "heartbeat": self._attack_heartbeat,
            "alive": self._attack_alive,
            "question": self._attack_question,
            "orders": lambda data: self._read("orders", lambda: Orders.decode(data)),
            "snapshot": lambda data: self._read("snapshot", lambda: Snapshot.decode(data)),
            "push_reply": lambda data: self._read("push_reply", lambda: PushReply.decode(data)),
            "join_reply": lambda data: self._read("join_reply", lambda: _membership(data)),
            "report": lambda data: self._read("report", lambda: RunReport.decode(data)),
        }

    # -- rounds --------------------------------------------------------------------------------------------

    def run(self, messages: int) -> None:
        """So many wrong messages, in rounds."""
        kinds = sorted(self._attacks)
        for number in range(messages):
            if number % ROUND == 0:
                self.serve_good_actors()
            kind = self._rng.choice(kinds)
            source = kind if kind in self._mutator.messages else self._rng.choice(sorted(self._mutator.messages))
            way, data = self._mutator.make(source)
            self.sent[kind] += 1
            self.ways[way] += 1
            self._attacks[kind](data)

    def serve_good_actors(self) -> None:
        """Two new actors join and bring a batch of the version: they must be taken, whatever came before."""
        for incarnation in [*self.names, *self._strangers()]:
            self._doors.watched[KEYS.all_alive](KEYS.alive("actor", incarnation), False)
        assert self.hub.actors() == 0
        self.version += 1
        self.hub.publish(_snapshot(self.version))
        self.names = [f"{self.version}-{slot}" for slot in range(SETTINGS.actors)]
        self.generations = {}
        for slot, name in enumerate(self.names):
            reply = JoinReply.decode(self._ask(JOIN, _join(name).encode()))
            assert (reply.accepted, reply.slot) == (True, slot)
            self.joined += 1
            self._doors.heard[KEYS.heartbeats](KEYS.heartbeat(slot), _heartbeat(slot, name).encode())
            self.generations[name] = reply.generation
            made = self._rollout(slot, name, 0)
            assert self._push(made.encode(), slot) == ACCEPTED
        batch = self.hub.rollouts(DEADLINE_S)
        assert batch is not None
        assert [rollout.incarnation for rollout in batch] == self.names
        self.version += 1
        self.hub.publish(_snapshot(self.version))
        self._mutator.messages = self._good()

    def _join_evaluator(self) -> None:
        """It stays for the whole siege, and has no slot."""
        question = Join("", "evaluator", EVALUATOR, {}, {}, "native")
        reply = JoinReply.decode(self._ask(JOIN, question.encode()))
        assert reply.accepted
        self._doors.watched[KEYS.all_alive](KEYS.alive("evaluator", EVALUATOR), True)

    def _strangers(self) -> list[str]:
        """Whoever a mutated message let in, by the learner's own account."""
        return [actor.incarnation for actor in self.hub.report().actors if actor.incarnation not in self.names]

    def _good(self) -> dict[str, bytes]:
        """A message of each kind that would be taken now."""
        slot = self._rng.randrange(SETTINGS.actors)
        name = self.names[slot] if self.names else "nobody"
        returns, lengths = np.float32([10, 30]), np.int32([5, 7])
        return {
            "rollout": self._rollout(slot, name, 1).encode(),
            "environment": _environment(slot, name, self.version).encode(),
            "evaluation": Evaluation(RUN, slot, name, self.version, returns, lengths).encode(),
            "assessment": _assessment(self.version).encode(),
            "join": _join(f"stranger-{self.version}").encode(),
            "heartbeat": _heartbeat(slot, name).encode(),
            "orders": Orders(RUN, self.version, "d", 99, {0: 2, 1: 1}, {1: 2}, False, 5).encode(),
            "snapshot": _snapshot(self.version).encode(),
            "push_reply": PushReply.busy("queue_full", "the learner's queue is full").encode(),
            "join_reply": JoinReply.granted(RUN, slot, 0, SETTINGS.model_dump_json()).encode(),
            "report": self.hub.report().encode(),
        }

    def _rollout(self, slot: int, name: str, seq: int) -> Rollout:
        return _rollout(slot, name, seq, self.version, self.generations.get(name, 0), self._rng)

    # -- the doors -----------------------------------------------------------------------------------------

    def _ask(self, key: str, payload: bytes, door: str | None = None) -> bytes:
        """The one answer to a question; the log's thread may give it."""
        answers: list[bytes] = []
        answered = threading.Event()

        def answer(data: bytes) -> None:
            answers.append(data)
            answered.set()

        self._doors.served[door or key](Request(key, payload, answer))
        assert answered.wait(DEADLINE_S), "a question was not answered"
        assert len(answers) == 1
        return answers[0]

    def _push(self, data: bytes, slot: int) -> PushReply:
        reply = PushReply.decode(self._ask(KEYS.rollout(slot), data, KEYS.rollouts))
        self.answers[reply.status] += 1
        return reply

    def _attack_rollout(self, data: bytes) -> None:
        reply = self._push(data, self._rng.randrange(SETTINGS.actors + 1))
        if reply.status == "refused":
            self._count("rollout", reply.slug)

    def _attack_environment(self, data: bytes) -> None:
        """None was asked for. An empty one asks what to go on from: nothing, at a run's start."""
        answer = self._ask(KEYS.environment(self._rng.randrange(SETTINGS.actors)), data, KEYS.environments)
        if not data:
            assert answer == b""
            return
        reply = PushReply.decode(answer)
        assert reply.status == "refused"
        self._count("environment", reply.slug)

    def _attack_evaluation(self, data: bytes) -> None:
        key = KEYS.evaluation(self._rng.randrange(SETTINGS.actors))
        reply = PushReply.decode(self._ask(key, data, KEYS.evaluations))
        if reply.status == "refused":
            self._count("evaluation", reply.slug)

    def _attack_assessment(self, data: bytes) -> None:
        reply = PushReply.decode(self._ask(KEYS.assessment(EVALUATOR), data, KEYS.assessments))
        if reply.status == "refused":
            self._count("assessment", reply.slug)
        else:
            self.assessed.add(Assessment.decode(data).version)

    def _attack_join(self, data: bytes) -> None:
        reply = JoinReply.decode(self._ask(JOIN, data))
        self.joined += reply.accepted
        self.turned_away += not reply.accepted
        try:
            join = Join.decode(data)
        except CodecError as error:
            assert not reply.accepted
            self._count("join", error.reason)
        else:
            if join.physics not in ("native", "mjx", "auto"):
                self._count("join", "bad_value")

    def _attack_heartbeat(self, data: bytes) -> None:
        slot = self._rng.randrange(SETTINGS.actors)
        held = {actor.slot: actor.incarnation for actor in self.hub.report().actors}
        self._doors.heard[KEYS.heartbeats](KEYS.heartbeat(slot), data)
        try:
            beat = Heartbeat.decode(data)
        except CodecError as error:
            self._count("heartbeat", error.reason)
            return
        if beat.slot != slot:
            self._count("heartbeat", "bad_key")
        elif beat.run != RUN:
            self._count("heartbeat", "run")
        elif held.get(slot) != beat.incarnation:
            self._count("heartbeat", "incarnation")

    def _attack_alive(self, data: bytes) -> None:
        """Tokens on keys that are none, and of nobody."""
        word = data[:40].decode("latin-1").replace("/", "")
        key = self._rng.choice(
            [word, f"reskpn/v1/{RUN}/alive/actor/{word or '?'}/", f"reskpn/v1/{RUN}/alive/{word}/A", KEYS.metrics]
        )
        self._doors.watched[KEYS.all_alive](key, self._rng.random() < 0.5)
        self._count("alive", "bad_key")

    def _attack_question(self, data: bytes) -> None:
        """What is asked with no payload gets its answer with any."""
        assert self._ask(KEYS.policy_latest, data) == _snapshot(self.version).encode()
        assert RunReport.decode(self._ask(STATUS, data)).run == RUN

    def _read(self, kind: str, read: Callable[[], object]) -> None:
        """As an actor or a watcher reads what it is sent."""
        try:
            read()
        except ReskpnError as error:
            self._count(kind, error.reason if isinstance(error, CodecError) else type(error).__name__)

    def _count(self, kind: str, reason: str) -> None:
        self.refused.setdefault(kind, Counter())[reason] += 1

    # -- what must hold ------------------------------------------------------------------------------------

    def check(self) -> None:
        """The learner's account is ours, and its log holds what was accepted and nothing malformed."""
        report = self.hub.report()
        mine = {kind: dict(counts) for kind, counts in self.refused.items() if kind in HUB_KINDS}
        assert report.refusals == mine
        totals = report.totals
        # Repeats are answered `accepted` as well.
        assert totals.accepted + totals.repeated == self.answers["accepted"]
        assert (totals.refused, totals.busy) == (self.answers["refused"], self.answers["busy"])
        assert sum(report.refused_joins.values()) == self.turned_away
        self.log.flush(timeout_s=DEADLINE_S)
        logged = 0
        for message in LogReader(self.directory).messages({"/rollout"}):
            Rollout.decode(message.data).check(SHAPE)
            logged += 1
        assert logged == totals.accepted
        evaluations = [message.json() for message in LogReader(self.directory).messages({"/eval"})]
        assert sorted(record["version"] for record in evaluations) == sorted(self.assessed)
        assert {record["source"] for record in evaluations} == {source_of(EVALUATOR)}
        assert (report.evaluators, len(report.actors)) == (1, len(self.names) + len(self._strangers()))


HUB_KINDS = ("rollout", "environment", "evaluation", "assessment", "join", "heartbeat", "alive")

STATUS_NOW = Progress(
    phase="training", text="", version=0, updates=10, env_steps=0, total_steps=800, steps_per_s=None,
    train_return=None, step_reward=None, staleness=0.0, centres=None, capacity=0, actors=0, slots=2,
)  # fmt: skip


@contextmanager
def siege(directory: Path, seed: int) -> Iterator[Siege]:
    made = Siege(directory, seed)
    try:
        yield made
    finally:
        made.log.close()


@contextmanager
def memory_growth() -> Iterator[Callable[[], int]]:
    """Gives a function: by how many bytes this process has grown at most since the start, what is free again included.

    The kernel keeps the highest mark; it is put back to what is resident now.
    """
    Path("/proc/self/clear_refs").write_text("5")
    before = _memory("VmRSS")
    yield lambda: _memory("VmHWM") - before


def _memory(name: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(f"{name}:"))


def _membership(data: bytes) -> object:
    reply = JoinReply.decode(data)
    return parse_json(reply.settings) if reply.accepted else reply


def _join(incarnation: str) -> Join:
    return Join("", "actor", incarnation, {"python": "3.11"}, {"host": "here"}, "native")


def _heartbeat(slot: int, incarnation: str) -> Heartbeat:
    return Heartbeat(RUN, slot, incarnation, "waiting", 0, 0, 0.0, 0.0, 1)


def _environment(slot: int, incarnation: str, version: int) -> Environment:
    shapes = state_shapes(SETTINGS.sizes, SETTINGS.envs_per_actor)
    arrays = {path: np.zeros(shape, dtype) for path, (dtype, shape) in shapes.items()}
    return Environment(RUN, slot, incarnation, 0, 1, version, digest_arrays(arrays), arrays)


def _assessment(version: int) -> Assessment:
    returns, lengths = np.float32([10, 30]), np.int32([5, 7])
    return Assessment(RUN, EVALUATOR, version, returns, lengths, np.ones((4, 2), np.float32), 0.04)


def _snapshot(version: int) -> Snapshot:
    arrays = {"parameters/w": np.full((8, 8), version, np.float32), "count": np.array(version, np.int32)}
    return Snapshot(RUN, version, digest_arrays(arrays), arrays)


def _rollout(slot: int, incarnation: str, seq: int, version: int, generation: int, rng: random.Random) -> Rollout:
    """One of `SETTINGS`, with an episode that fell and one that was cut."""
    draw = np.random.default_rng(rng.getrandbits(32)).standard_normal
    steps, envs, observation, action = SHAPE.num_steps, SHAPE.num_envs, SHAPE.observation_size, SHAPE.action_size
    terminated, truncated = np.zeros((steps, envs), bool), np.zeros((steps, envs), bool)
    terminated[1, 0] = truncated[3, 1] = True
    return Rollout(
        run=RUN,
        slot=slot,
        incarnation=incarnation,
        seq=seq,
        policy_version=version,
        t_ns=1,
        obs=draw((steps, envs, observation), np.float32),
        action=draw((steps, envs, action), np.float32),
        log_prob=draw((steps, envs), np.float32),
        reward=draw((steps, envs), np.float32),
        terminated=terminated,
        truncated=truncated,
        last_obs=draw((envs, observation), np.float32),
        truncated_obs=draw((1, observation), np.float32),
        episode_return=np.float32([3, 4]),
        episode_length=np.int32([2, 4]),
        timing={"collect": 0.25, "physics": 0.5},
        generation=generation,
        **no_mirror(observation, action),
    )
