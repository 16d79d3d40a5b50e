"""The ingest benchmark: its learner and actors speak the real protocol, and its sums are right."""

from __future__ import annotations

import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from benchmarks.ingest import Point, describe_limit, limit, table
from benchmarks.ingest_actor import act, made_up
from benchmarks.ingest_learner import Ingest, serve
from benchmarks.raw_socket import receive
from common.config.settings import RunSettings
from common.log.reader import LogReader
from common.runs.rollout_shape import rollout_shape
from common.wire.endpoint import free_port
from common.wire.rollout import Rollout


def point(actors: int, rollouts: int, cpu_s: float = 1.0, idle_cpu: float = 0.0) -> Point:
    """Two seconds with rollouts of 1000 steps and half a megabyte; the socket takes 10 MB/s."""
    found = Ingest(
        actors=actors, idle_cpu=idle_cpu, seconds=2.0, cpu_s=cpu_s, rollouts=rollouts, rollout_bytes=500_000,
        snapshot_bytes=1000, steps_per_rollout=1000,
    )  # fmt: skip
    return Point(found, 1e7)


def test_learner_and_actors_speak_the_protocol(tmp_path: Path) -> None:
    """What is counted is in the log, in rollouts that fit the run; the actors leave when it is over."""
    settings = RunSettings.model_validate(
        {
            "actors": 2, "num_envs": 4, "num_steps": 3, "total_steps": 12, "physics": "native",
            "algorithm": {"hidden": (8, 8), "minibatches": 2},
            "transport": {"endpoint": f"tcp/127.0.0.1:{free_port()}"},
        }
    )  # fmt: skip
    with ThreadPoolExecutor(2) as pool:
        actors = [pool.submit(act, settings.transport.endpoint) for _ in range(2)]
        found = serve(settings, tmp_path / "log", 0.3)
        assert [actor.result(30.0) for actor in actors] == [None, None]
    assert (found.actors, found.steps_per_rollout) == (2, 6)
    assert found.rollouts >= 2
    assert found.rollouts % 2 == 0
    assert found.cpu_s > 0.0
    assert found.snapshot_bytes > 0
    logged = [message.data for message in LogReader(tmp_path / "log").messages({"/rollout"})]
    assert len(logged) >= found.rollouts
    for data in logged:
        Rollout.decode(data).check(rollout_shape(settings))
    # Numbers take more bytes the larger they are, and times.
    assert abs(len(logged[0]) - found.rollout_bytes) < 32


def test_an_actor_loads_no_jax() -> None:
    """Sixteen of them are to fit beside a learner."""
    program = "import sys, benchmarks.ingest_actor; sys.exit('jax' in sys.modules or 'mujoco' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], cwd=Path(__file__).parents[2]).returncode == 0


def test_rollouts_that_branch_are_made_up_too() -> None:
    """With one mirrored step of each environment."""
    settings = RunSettings.model_validate({"rkhs": {"estimate": "symmetric"}})
    shape = rollout_shape(settings)
    assert made_up(shape)["mirror_obs"].shape == (shape.num_envs, shape.observation_size)


def test_a_bare_socket() -> None:
    """Takes whole messages from several processes, and leaves none of them behind."""
    before = threading.active_count()
    assert receive(100_000, 2, 0.2) > 0.0
    assert threading.active_count() == before


def test_the_table() -> None:
    """Two actors, 20 rollouts of half a megabyte in 2 s: 10 a second, 5 MB/s, half of the socket's 10 MB/s."""
    head, row = table([point(2, 20, cpu_s=0.5, idle_cpu=0.01)])
    assert head.endswith(" idle CPU %     per actor %")
    # 0.5 s / 20 rollouts = 25 ms; 1 % while idle, half of it for each of two
    assert row.split() == ["2", "10.0", "5", "10", "0.50", "25.0", "1.00", "0.500"]


def test_the_limit() -> None:
    """From the best throughput, and from what the largest number of actors cost."""
    points = [point(1, 20), point(2, 40), point(4, 30, cpu_s=0.3, idle_cpu=0.02)]
    found = limit(points, 2500.0)
    # 20 rollouts/s of 1000 steps; an actor makes 2.5 rollouts/s, so 8 of them make 20
    assert (found.rollouts_per_s, found.steps_per_s, found.fleet) == (20.0, 20_000.0, 8)
    # an actor costs 2.5 x 0.3 s / 30 + 0.02 / 4 = 0.025 + 0.005 = 0.03 of a core
    assert found.core_fleet == 33
    assert describe_limit(found) == (
        "at most 10 MB/s = 20.0 rollouts/s = 20,000 steps/s: 8 actors of 2,500 steps/s; 33 of them keep one core of "
        "the learner busy"
    )


@pytest.mark.parametrize("task", ["hopper", "humanoid"])
def test_the_sizes_are_those_of_the_task(task: str) -> None:
    """An observation of a rollout is as large as the task's."""
    shape = rollout_shape(RunSettings(task=task))
    assert made_up(shape)["obs"].shape == (shape.num_steps, shape.num_envs, shape.observation_size)
