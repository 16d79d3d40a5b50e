"""Environments that several tests of physics share: making and compiling one costs seconds."""

from __future__ import annotations

import functools
from typing import Any

import pytest

from common.physics.environments import BatchedEnvironment, make_environment
from common.physics.models import load_task


@pytest.fixture(autouse=True, scope="module")
def _everything_in_a_hurry(in_a_hurry: None) -> None:
    """For all tests of this folder: they share programs, and compare what these compute bit for bit."""


@pytest.fixture(scope="session")
def task_of() -> Any:
    """`task_of(name)`: the brax environment of a task, loaded once."""
    return functools.cache(load_task)


@pytest.fixture(scope="session")
def pendulum() -> BatchedEnvironment:
    """Four inverted pendulums with episodes of 5 steps."""
    return make_environment("inverted_pendulum", "native", num_envs=4, episode_length=5)


@pytest.fixture(scope="session")
def hopper() -> BatchedEnvironment:
    """Three hoppers with episodes of the usual length."""
    return make_environment("hopper", "native", num_envs=3)
