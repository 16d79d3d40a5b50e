"""An evaluator's life: it follows the newest policy, tells what it found, and is no burden to anybody.

The learner's side is the real one; environments and compiling are replaced by stand-ins.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples import RUN, settings, snapshot

from common.config.settings import TransportSettings
from common.errors import RefusedError, SessionError, SettingsError
from common.log.reader import LogReader
from common.log.writer import LogWriter
from common.wire.session import Session
from services.evaluator import service
from services.evaluator.link import EvaluatorLink
from services.evaluator.service import EvaluationOptions, run_evaluator
from services.learner.endpoints.hub import Hub
from services.worker.deterministic import Episodes
from services.worker.state_file import read_state

DEADLINE_S = 15.0


class Reader:
    """Takes a snapshot's arrays for a policy."""

    def __init__(self, settings: object) -> None:
        """Any settings will do."""

    def read(self, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return arrays


class StandIn:
    """Episodes whose returns tell the policy's version. While `free` is not set they take their time."""

    played: list[int]
    links: list[EvaluatorLink]
    free: threading.Event
    step_s = 0.5

    def __init__(self, settings: Any, reader: Reader, episodes: int, threads: int) -> None:
        self.episodes = episodes

    def play(self, policy: dict[str, np.ndarray]) -> Episodes:
        version = int(policy["count"])
        self.played.append(version)
        assert self.free.wait(DEADLINE_S)
        lengths = np.full(self.episodes, 5, np.int32)
        return Episodes(np.full(self.episodes, version, np.float32), lengths, np.zeros((5, 2), np.float32))


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> type[StandIn]:
    class Fresh(StandIn):
        played: list[int] = []  # noqa: RUF012
        links: list[EvaluatorLink] = []  # noqa: RUF012
        free = threading.Event()

    class Kept(EvaluatorLink):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            Fresh.links.append(self)

    Fresh.free.set()
    monkeypatch.setattr(service, "EvaluatorLink", Kept)
    monkeypatch.setattr(service, "DeterministicEpisodes", Fresh)
    monkeypatch.setattr(service, "PolicyReader", Reader)
    monkeypatch.setattr(service, "enable_compilation_cache", lambda: None)
    return Fresh


class Learner:
    """A hub, its log and its session."""

    def __init__(self, session: Session, directory: Path) -> None:
        self.session = session
        self.directory = directory
        self.log = LogWriter(directory)
        self.hub = Hub(RUN, settings(), session, self.log, lambda *_: None)
        self.hub.publish(snapshot(0))
        self.hub.open()

    def close(self) -> None:
        self.session.close()
        self.log.close()

    def announced(self) -> bool:
        """Says the orders once more, as the learner's loop does."""
        self.hub.announce()
        return True

    def evaluated(self) -> list[int]:
        """Versions in the log's /eval; the orders are said once more."""
        self.hub.announce()
        return [message.json()["version"] for message in LogReader(self.directory).messages({"/eval"})]


@pytest.fixture
def learners(sessions: Callable[..., Session], tmp_path: Path) -> Iterator[Callable[[], Learner]]:
    with ExitStack() as stack:
        count = iter(range(9))

        def make() -> Learner:
            learner = Learner(sessions(listen=True), tmp_path / f"log-{next(count)}")
            stack.callback(learner.close)
            return learner

        yield make


@pytest.fixture
def evaluators(endpoint: str, stand_in: type[StandIn]) -> Iterator[Any]:
    """Starts evaluators in threads of this process; what they say is in `evaluators.said`."""
    stop = threading.Event()
    said: list[str] = []
    with ThreadPoolExecutor(2) as pool:

        def start(work: EvaluationOptions | None = None, **changes: Any) -> Future[int]:
            options: dict[str, Any] = {"run": "", "connect_timeout_s": DEADLINE_S, "rejoin_timeout_s": DEADLINE_S}
            transport = TransportSettings(endpoint=endpoint)
            work = work or EvaluationOptions(every=1, episodes=3, physics="native")
            return pool.submit(run_evaluator, transport, work, **options | changes, stop=stop, say=said.append)

        start.stop, start.said = stop, said  # type: ignore[attr-defined]
        yield start
        stop.set()
        stand_in.free.set()


def test_it_follows_a_run_to_its_end(learners: Any, evaluators: Any, until: Any) -> None:
    """Every new policy is played and told; it leaves when the run is over."""
    learner = learners()
    done = evaluators()
    for version in range(3):
        until(lambda: learner.evaluated() == list(range(version + 1)))  # noqa: B023
        learner.hub.publish(snapshot(version + 1))
    until(lambda: len(learner.evaluated()) == 4)
    learner.hub.finish()
    assert done.result(DEADLINE_S) == 0
    assert evaluators.said[0] == f"following {RUN}: 3 episodes of every new policy"
    assert evaluators.said[1].startswith("policy 0: return 0.0 ± 0.0 over 3 episodes in ")
    assert evaluators.said[-1] == "the run is over"
    (first, *_) = LogReader(learner.directory).messages({"/trajectory"})
    assert [step["time_s"] for step in first.json()["steps"]] == [0.0, 0.5, 1.0, 1.5, 2.0]


def test_it_falls_behind_and_skips(learners: Any, evaluators: Any, stand_in: type[StandIn], until: Any) -> None:
    """What was published while it played is not made up for: the newest is next, and the distance is said."""
    learner = learners()
    stand_in.free.clear()
    evaluators()
    until(lambda: learner.announced() and stand_in.played == [0])
    for version in range(1, 8):
        learner.hub.publish(snapshot(version))
    until(lambda: learner.announced() and stand_in.links[0].newest == 7)
    stand_in.free.set()
    until(lambda: learner.evaluated() == [0, 7])
    until(lambda: len(evaluators.said) == 3)
    assert evaluators.said[1].endswith(", 7 versions behind")
    assert evaluators.said[2].endswith(", the newest")
    behind = [message.json()["behind"] for message in LogReader(learner.directory).messages({"/eval"})]
    assert behind == [7, 0]


def test_every_so_many_versions(learners: Any, evaluators: Any, stand_in: type[StandIn], until: Any) -> None:
    """With 4: the one it finds, then 4 or what has come after it, then 8."""
    learner = learners()
    learner.hub.publish(snapshot(1))
    evaluators(EvaluationOptions(every=4, episodes=1, positions=0, physics="native"))
    until(lambda: learner.evaluated() == [1])
    for version, expected in ((2, [1]), (3, [1]), (5, [1, 5]), (7, [1, 5]), (8, [1, 5, 8])):
        learner.hub.publish(snapshot(version))
        until(lambda: learner.evaluated() == expected)  # noqa: B023
    assert stand_in.played == [1, 5, 8]
    assert not list(LogReader(learner.directory).messages({"/trajectory"}))


def test_it_joins_the_next_learner(learners: Any, evaluators: Any, until: Any) -> None:
    """One that is gone is waited for; its successor's policies are played from the newest on."""
    first = learners()
    done = evaluators()
    until(lambda: first.evaluated() == [0])
    first.close()
    second = learners()
    second.hub.publish(snapshot(2))
    until(lambda: second.evaluated() in ([2], [0, 2]))
    second.hub.finish()
    assert done.result(DEADLINE_S) == 0
    assert any("joining again" in line for line in evaluators.said)


def test_the_end_is_heard_while_it_plays(learners: Any, evaluators: Any, stand_in: type[StandIn], until: Any) -> None:
    """A learner that is gone by the time the episodes are over had said that the run is: no failure, no waiting."""
    learner = learners()
    stand_in.free.clear()
    done = evaluators()
    until(lambda: learner.announced() and stand_in.played == [0])
    learner.hub.finish()
    until(lambda: learner.announced() and stand_in.links[0].over)
    learner.close()
    stand_in.free.set()
    assert done.result(DEADLINE_S) == 0
    assert evaluators.said[-1] == "the run is over"


def test_it_can_be_stopped(learners: Any, evaluators: Any, until: Any, tmp_path: Path) -> None:
    """At any time, with exit code 0; its state file says what it had."""
    learner = learners()
    done = evaluators(state_file=tmp_path / "state.json")
    until(lambda: learner.evaluated() == [0])
    evaluators.stop.set()
    assert done.result(DEADLINE_S) == 0
    found = read_state(tmp_path / "state.json")
    assert found is not None
    assert found.version == 0


def test_no_learner(evaluators: Any) -> None:
    """Within the time it was given."""
    with pytest.raises(SessionError, match="no connection"):
        evaluators(connect_timeout_s=0.2).result(DEADLINE_S)


def test_another_run_is_not_followed(learners: Any, evaluators: Any) -> None:
    """It was told which."""
    learners()
    with pytest.raises(RefusedError, match="this learner runs 'run-1'"):
        evaluators(run="run-2").result(DEADLINE_S)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"every": 0}, "--every is 0; allowed: 1 or more"),
        ({"episodes": 1025}, "--episodes is 1025; allowed: 1 to 1024"),
        ({"positions": -1}, "--positions is -1; allowed: 0 or more"),
        ({"threads": -1}, "--threads is -1; allowed: 0 or more"),
    ],
)
def test_impossible_work(given: dict[str, int], text: str) -> None:
    """Is refused at once, with what is allowed."""
    with pytest.raises(SettingsError) as caught:
        EvaluationOptions(**given)
    assert str(caught.value) == text
