"""An actor's life: it joins, does what is asked and no more, and begins anew when it is lost.

The learner's side is the real one; what takes long, environments and compiling, is replaced by stand-ins.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples import RUN, environment_arrays, rollout, settings, snapshot

from common.config.settings import TransportSettings
from common.errors import CodecError, PhysicsError, RefusedError, SessionError
from common.log.writer import LogWriter
from common.wire.messages import Environment, digest_arrays
from common.wire.session import Session
from services.actor import service
from services.actor.collector import SlotGeneration
from services.actor.rollouts import CollectedRollout, Trajectory
from services.actor.service import run_actor
from services.learner.endpoints.hub import Hub
from services.learner.scheduling.slots import Start
from services.worker.deterministic import Episodes
from services.worker.state_file import read_state

DEADLINE_S = 15.0
TIMING = {"collect": 0.5}


class Reader:
    """Takes a snapshot's arrays for a policy."""

    def __init__(self, settings: object) -> None:
        """Any settings will do."""

    def read(self, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return arrays


def collected(reward: np.ndarray) -> CollectedRollout[np.ndarray]:
    """A rollout of the samples in which no episode ends, as it comes from the environments."""
    sample = rollout(reward=reward)
    none = np.zeros((0, 2, 4), np.float32)
    steps = Trajectory(
        obs=sample.obs, action=sample.action, log_prob=sample.log_prob, reward=reward, terminated=sample.terminated,
        truncated=sample.truncated, next_obs=none, episode_return=reward, episode_length=np.zeros((3, 2), np.int32),
    )  # fmt: skip
    mirror = Trajectory(
        obs=sample.mirror_obs, action=sample.mirror_action, log_prob=sample.mirror_reward, reward=sample.mirror_reward,
        terminated=sample.mirror_terminated, truncated=sample.mirror_truncated, next_obs=sample.mirror_obs,
        episode_return=sample.mirror_reward, episode_length=np.zeros(0, np.int32),
    )  # fmt: skip
    return CollectedRollout(steps, sample.last_obs, np.zeros((2, 4), np.float32), mirror, np.array(0, np.int32))


class StandIn:
    """Rollouts whose rewards tell the policy, the slot and the number they were made with."""

    made: list[tuple[SlotGeneration, int, float]]
    ready: threading.Event
    before_rollout: Callable[[], None]

    def __init__(self, settings: Any, holder: SlotGeneration, reader: Reader, threads: int) -> None:
        self.holder = holder
        self.seq = 0
        self.physics = settings.physics

    def compile(self) -> None:
        assert self.ready.wait(DEADLINE_S)

    def collect(self, policy: dict[str, np.ndarray]) -> tuple[CollectedRollout[np.ndarray], dict[str, float]]:
        version = float(policy["count"])
        type(self).before_rollout()
        self.made.append((self.holder, self.seq, version))
        return collected(np.full((3, 2), version, np.float32)), dict(TIMING)

    def keep(self) -> None:
        self.seq += 1

    def environments(self) -> dict[str, np.ndarray]:
        return environment_arrays() | {"diverged": np.full(2, self.seq, np.int32)}

    def restore(self, arrays: dict[str, np.ndarray], seq: int) -> None:
        if "seq" not in arrays:
            raise CodecError("bad_fields", "no seq")
        self.seq = seq


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> type[StandIn]:
    """The collector's stand-in, which keeps what it made; it has compiled unless its `ready` is cleared."""

    class Fresh(StandIn):
        made: list[tuple[SlotGeneration, int, float]] = []  # noqa: RUF012
        ready = threading.Event()
        before_rollout = staticmethod(lambda: None)

    Fresh.ready.set()
    monkeypatch.setattr(service, "Collector", Fresh)
    monkeypatch.setattr(service, "PolicyReader", Reader)
    monkeypatch.setattr(service, "enable_compilation_cache", lambda: None)
    monkeypatch.setattr(
        service,
        "play_episodes",
        lambda settings, reader, policy, episodes, threads: Episodes(
            np.full(episodes, float(policy["count"]), np.float32),
            np.full(episodes, 5, np.int32),
            np.zeros((5, 2), np.float32),
        ),
    )
    return Fresh


class Learner:
    """A hub, its log and its session."""

    def __init__(self, session: Session, directory: Path, starts: Any = (), **changes: Any) -> None:
        self.session = session
        self.log = LogWriter(directory)
        self.events: list[tuple[str, str, str]] = []
        self.hub = Hub(
            RUN, settings(**changes), session, self.log, lambda *event: self.events.append(event), starts=starts
        )
        self.hub.publish(snapshot(0))
        self.hub.open()

    def close(self) -> None:
        self.session.close()
        self.log.close()

    def until(self, there: Callable[[], bool]) -> None:
        """Wait for something to become true; orders are repeated until it is."""
        deadline = time.monotonic() + DEADLINE_S
        while not there():
            assert time.monotonic() < deadline, self.hub.waiting_for()
            self.hub.announce()
            time.sleep(0.02)

    def batch(self) -> list[float]:
        """The versions that the rollouts of the batch tell; orders are repeated until it is complete."""
        deadline = time.monotonic() + DEADLINE_S
        while (rollouts := self.hub.rollouts(0.2)) is None:
            assert time.monotonic() < deadline, self.hub.waiting_for()
            self.hub.announce()
        return [float(r.reward[0, 0]) for r in rollouts]


@pytest.fixture
def learners(sessions: Callable[..., Session], tmp_path: Path) -> Iterator[Callable[..., Learner]]:
    with ExitStack() as stack:
        count = iter(range(9))

        def make(**changes: Any) -> Learner:
            learner = Learner(sessions(listen=True), tmp_path / f"log-{next(count)}", **changes)
            stack.callback(learner.close)
            return learner

        yield make


@pytest.fixture
def actors(endpoint: str, stand_in: type[StandIn]) -> Iterator[Callable[..., Future[int]]]:
    """Starts actors in threads of this process: `actors()`. What they say is in `actors.said`."""
    stop = threading.Event()
    said: list[str] = []
    with ThreadPoolExecutor(4) as pool:

        def start(**changes: Any) -> Future[int]:
            options: dict[str, Any] = {"physics": "native", "run": "", "threads": 0, "connect_timeout_s": DEADLINE_S}
            transport = TransportSettings(endpoint=endpoint)
            return pool.submit(run_actor, transport, **options | changes, stop=stop, say=said.append)

        start.stop, start.said = stop, said  # type: ignore[attr-defined]
        yield start
        stop.set()


def test_in_async_mode_an_actor_works_on(
    learners: Callable[..., Learner], actors: Any, stand_in: type[StandIn]
) -> None:
    """It makes what the bound allows without waiting for the next version, and takes the newest for what comes then."""
    learner = learners(actors=1, num_envs=2, mode="async", max_staleness=2)
    done = actors()
    learner.until(lambda: learner.hub.report().totals.accepted == 3)
    assert stand_in.made == [(SlotGeneration(0, 0), seq, 0.0) for seq in range(3)]
    assert learner.batch() == [0.0]
    for version in (1, 2, 3):
        learner.hub.publish(snapshot(version))
        learner.until(lambda version=version: learner.hub.report().totals.accepted == 3 + version)
        assert learner.batch() == [max(0.0, version - 2)]
    assert stand_in.made[3:] == [(SlotGeneration(0, 0), 2 + version, float(version)) for version in (1, 2, 3)]
    learner.hub.finish()
    assert done.result(DEADLINE_S) == 0
    assert learner.hub.refusals() == {}


def test_an_actor_does_what_is_asked(learners: Callable[..., Learner], actors: Any, stand_in: type[StandIn]) -> None:
    """One rollout a version with that version's policy, an evaluation of the last, and it leaves when all is over."""
    learner = learners(actors=1, num_envs=2)
    done = actors()
    for version in range(3):
        assert learner.batch() == [float(version)]
        learner.hub.publish(snapshot(version + 1), collect=version < 2)
    learner.hub.ask_for_evaluation(6)
    evaluation = learner.hub.evaluation(DEADLINE_S)
    assert evaluation is not None
    assert (evaluation.version, evaluation.episode_return.tolist()) == (3, [3.0] * 6)
    learner.hub.finish()
    assert done.result(DEADLINE_S) == 0
    assert stand_in.made == [(SlotGeneration(0, 0), seq, float(seq)) for seq in range(3)]
    assert actors.said == [f"joined {RUN} as slot 0 (generation 0) with native physics", "the run is over"]


def test_two_actors_share_a_run(
    learners: Callable[..., Learner], actors: Any, stand_in: type[StandIn], until: Callable[..., None]
) -> None:
    """Each fills its slot; of the work of one that is not there the other does as much as it is asked."""
    learner = learners()
    both = [actors(), actors()]
    for version in range(2):
        assert learner.batch() == [float(version)] * 2
        learner.hub.publish(snapshot(version + 1))
    assert sorted(holder.slot for holder, _, version in stand_in.made if version == 0.0) == [0, 1]
    learner.hub.finish()
    assert [one.result(DEADLINE_S) for one in both] == [0, 0]


def test_an_actor_keeps_what_it_does_in_a_file(
    learners: Callable[..., Learner], actors: Any, stand_in: type[StandIn], until: Callable[..., None], tmp_path: Path
) -> None:
    """Standing by, no policy while it compiles, then the version of the one it has."""
    learner = learners(actors=1, num_envs=2)
    learner.hub._fleet.join("first", "native", 0.0)
    stand_in.ready.clear()
    file = tmp_path / "actor.json"
    done = actors(state_file=file)

    def kept() -> tuple[str, int]:
        found = read_state(file)
        return ("", 0) if found is None else (found.state, found.version)

    until(lambda: kept() == ("standing by", -1))
    learner.hub._remove("first", "is gone")
    until(lambda: kept() == ("compiling", -1))
    stand_in.ready.set()
    assert learner.batch() == [0.0]
    until(lambda: kept() == ("waiting", 0))
    learner.hub.finish()
    assert done.result(DEADLINE_S) == 0


def test_one_that_stands_by_to_the_end_ends_well(
    learners: Callable[..., Learner], actors: Any, until: Callable[..., None]
) -> None:
    """Nothing failed: it says that nothing is left to do."""
    learner = learners(actors=1, num_envs=2)
    learner.hub._fleet.join("first", "native", 0.0)
    done = actors()
    until(learner.hub.standing_by)
    learner.hub.finish()
    assert done.result(DEADLINE_S) == 0
    assert actors.said[-1] == f"the run is over, nothing is left to do for run {RUN!r}"


def test_an_actor_alone_does_the_work_of_two(
    learners: Callable[..., Learner], actors: Any, stand_in: type[StandIn], until: Callable[..., None]
) -> None:
    """Once the slot of another was lost: two rollouts a version, one after the other."""
    learner = learners()
    done = actors()
    until(lambda: learner.hub.actors() == 1)
    # A second actor that comes and goes, from slot 1.
    learner.hub._fleet.join("passing", "native", 0.0)
    learner.hub._remove("passing", "is gone")
    for version in range(2):
        assert learner.batch() == [float(version)] * 2
        learner.hub.publish(snapshot(version + 1))
    learner.hub.finish()
    assert done.result(DEADLINE_S) == 0
    assert stand_in.made[:4] == [
        (SlotGeneration(0, 0), seq, version) for seq, version in enumerate([0.0, 0.0, 1.0, 1.0])
    ]


def test_a_rollout_that_comes_too_late_is_made_anew(
    learners: Callable[..., Learner], actors: Any, stand_in: type[StandIn], until: Callable[..., None]
) -> None:
    """With the newer policy, from the same states; no other is made with the old one, though two were asked for."""
    learner = learners()
    moved_on = threading.Event()

    def move_on() -> None:
        if not moved_on.is_set():
            moved_on.set()
            learner.hub.publish(snapshot(1))

    stand_in.before_rollout = staticmethod(move_on)
    stand_in.ready.clear()
    done = actors()
    until(lambda: learner.hub.actors() == 1)
    # A second actor that comes and goes, from slot 1: the first is asked for two rollouts once it is ready.
    learner.hub._fleet.join("passing", "native", 0.0)
    learner.hub._remove("passing", "is gone")
    stand_in.ready.set()
    assert learner.batch() == [1.0, 1.0]
    assert [(seq, version) for _, seq, version in stand_in.made] == [(0, 0.0), (0, 1.0), (1, 1.0)]
    learner.hub.finish()
    assert done.result(DEADLINE_S) == 0


@pytest.mark.parametrize("collect", [True, False])
def test_an_actor_that_was_given_up_joins_again(
    learners: Callable[..., Learner], actors: Any, stand_in: type[StandIn], collect: bool
) -> None:
    """It finds out by the orders, which do not name its slot, and starts as the next generation."""
    learner = learners(actors=1, num_envs=2)
    done = actors()
    assert learner.batch() == [0.0]
    ((_, member),) = learner.hub._fleet.members()
    learner.hub._remove(member.incarnation, "sent no heartbeat")
    learner.hub.publish(snapshot(1), collect=collect)
    if collect:
        assert learner.batch() == [1.0]
    learner.hub.ask_for_evaluation(2)
    assert learner.hub.evaluation(DEADLINE_S) is not None
    assert "the learner has given this actor up; joining again" in actors.said
    assert actors.said[-1] == f"joined {RUN} as slot 0 (generation 1) with native physics"
    learner.hub.finish()
    assert done.result(DEADLINE_S) == 0


def test_an_actor_whose_slot_was_given_away_joins_again(
    learners: Callable[..., Learner], actors: Any, stand_in: type[StandIn], until: Callable[..., None]
) -> None:
    """It finds out by its next rollout, and starts as the next generation with new environments."""
    learner = learners(actors=1, num_envs=2)
    done = actors()
    assert learner.batch() == [0.0]
    ((_, member),) = learner.hub._fleet.members()
    learner.hub.publish(snapshot(1))
    assert learner.batch() == [1.0]
    # Somebody else has the slot before any orders have told of it.
    learner.hub._fleet.remove(member.incarnation)
    learner.hub._fleet.join("other", "native", 0.0)
    learner.hub.publish(snapshot(2))
    until(lambda: any("join again; joining again" in line for line in actors.said))
    learner.hub._remove("other", "is gone")
    assert learner.batch() == [2.0]
    # Generation 1 was "other".
    assert stand_in.made[-1] == (SlotGeneration(0, 2), 0, 2.0)
    learner.hub.finish()
    assert done.result(DEADLINE_S) == 0


def test_a_learner_that_goes_is_waited_for(
    learners: Callable[..., Learner], actors: Any, stand_in: type[StandIn]
) -> None:
    """However long it takes: the time to connect is for the first one only. The next run is joined as a new actor."""
    first = learners(actors=1, num_envs=2)
    done = actors(connect_timeout_s=5.0)
    assert first.batch() == [0.0]
    first.close()
    second = learners(actors=1, num_envs=2)
    assert second.batch() == [0.0]
    assert "the learner is gone; joining again" in actors.said
    second.hub.finish()
    assert done.result(DEADLINE_S) == 0
    assert [seq for _, seq, _ in stand_in.made] == [0, 0]


def test_an_actor_that_compiles_says_so_and_can_be_stopped(
    learners: Callable[..., Learner], actors: Any, stand_in: type[StandIn], until: Callable[..., None]
) -> None:
    """It is not given up meanwhile; told to stop, it leaves as soon as it can, without a rollout."""
    stand_in.ready.clear()
    learner = learners(actors=1, num_envs=2)
    done = actors()
    until(lambda: "slot 0 compiling" in learner.hub.waiting_for())
    actors.stop.set()
    stand_in.ready.set()
    assert done.result(DEADLINE_S) == 0
    until(lambda: learner.hub.actors() == 0)
    assert stand_in.made == []


def test_without_a_learner_an_actor_gives_up(actors: Any) -> None:
    """After the time it was given."""
    with pytest.raises(SessionError, match=r"no connection to tcp/127\.0\.0\.1:\d+ within 0\.2 s"):
        actors(connect_timeout_s=0.2).result(DEADLINE_S)


def test_an_actor_for_another_run_is_refused(learners: Callable[..., Learner], actors: Any) -> None:
    """Its error is the learner's reason."""
    learners()
    with pytest.raises(RefusedError, match=r"does not take this actor: this learner runs 'run-1', not 'run-2'"):
        actors(run="run-2").result(DEADLINE_S)


def test_the_runs_own_engine_wins(
    learners: Callable[..., Learner], actors: Any, stand_in: type[StandIn], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An actor's is used only where the run leaves the choice to it."""
    engines = []
    make = stand_in.__init__

    def keep_engine(self: StandIn, settings: Any, *rest: Any) -> None:
        engines.append(settings.physics)
        make(self, settings, *rest)

    monkeypatch.setattr(stand_in, "__init__", keep_engine)
    for asked, own in (("native", "mjx"), ("auto", "mjx")):
        learner = learners(actors=1, num_envs=2, physics=asked)
        done = actors(physics=own)
        learner.batch()
        learner.hub.finish()
        assert done.result(DEADLINE_S) == 0
        learner.close()
    assert engines == ["native", "mjx"]
    joined = [line for line in actors.said if line.startswith("joined")]
    assert [line.split(" with ")[1] for line in joined] == ["native physics", "mjx physics"]


def test_environments_are_handed_in_before_they_are_used(
    learners: Callable[..., Learner], actors: Any, stand_in: type[StandIn]
) -> None:
    """Once, where the orders ask for it: as they were when the first rollout of that version began."""
    learner = learners(actors=1, num_envs=2)
    done = actors()
    assert learner.batch() == [0.0]
    learner.hub.publish(snapshot(1), hand_in=True)
    assert learner.batch() == [1.0]
    kept = learner.hub.environments.kept()
    assert kept is not None
    state = Environment.decode(kept.states[0])
    assert (state.version, state.generation, state.seq, state.arrays["diverged"][0]) == (1, 0, 1, 1)
    learner.hub.publish(snapshot(2))
    assert learner.batch() == [2.0]
    learner.hub.finish()
    assert done.result(DEADLINE_S) == 0


def kept_state(**arrays: np.ndarray) -> Start:
    return Start.of(Environment(RUN, 0, "old", 2, 7, 5, digest_arrays(arrays), arrays).encode())


def test_an_actor_goes_on_with_what_it_is_given(
    learners: Callable[..., Learner], actors: Any, stand_in: type[StandIn]
) -> None:
    """Generation and number of a resumed slot, from the first rollout on."""
    learner = learners(actors=1, num_envs=2, starts=[kept_state(seq=np.array(7, np.int32))])
    done = actors()
    assert learner.batch() == [0.0]
    assert stand_in.made == [(SlotGeneration(0, 2), 7, 0.0)]
    learner.hub.finish()
    assert done.result(DEADLINE_S) == 0


def test_environments_of_another_engine(learners: Callable[..., Learner], actors: Any) -> None:
    """Are no reason to begin with others: the sentence names the engine and what to do."""
    learners(actors=1, num_envs=2, starts=[kept_state(other=np.zeros(1, np.float32))])
    with pytest.raises(PhysicsError, match=r"slot 0 goes on from do not fit the native engine here .*--physics"):
        actors().result(DEADLINE_S)


def test_a_lost_learner_is_waited_for_as_long_as_it_was_said(
    learners: Callable[..., Learner], actors: Any, stand_in: type[StandIn]
) -> None:
    """Then the actor gives up, as it does for the first."""
    learner = learners(actors=1, num_envs=2)
    done = actors(rejoin_timeout_s=0.2)
    assert learner.batch() == [0.0]
    learner.close()
    with pytest.raises(SessionError, match=r"within 0\.2 s"):
        done.result(DEADLINE_S)
