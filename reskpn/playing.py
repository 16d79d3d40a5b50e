"""Episodes of an exported policy on MuJoCo, with what its file brings; needs neither JAX nor brax."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from common.errors import PolicyFileError
from common.physics.portable import Fields, PortableTask, Simulation, TaskFunctions
from reskpn.policy_file import Policy, open_session


def first_states(policy: Policy) -> int:
    """Number of first states in the file. PolicyFileError where it cannot be played."""
    return len(_simulation(policy)["qpos"])


def play(policy: Policy, episodes: int, seed: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Returns [e] and lengths [e] of so many episodes without exploration.

    Args:
        seed: draws the first states out of those in the file; None for the first so many, with which
            `reskpn evaluate` begins as well.

    Raises:
        PolicyFileError: the file cannot be played.
        PhysicsError: this version of MuJoCo cannot read the model.
    """
    simulation = open_simulation(policy)
    count = first_states(policy)
    numbers = range(episodes) if seed is None else np.random.default_rng(seed).permutation(count)[:episodes]
    played = [_episode(simulation, policy, int(number)) for number in numbers]
    returns, lengths = zip(*played, strict=True)
    return np.array(returns, np.float64), np.array(lengths, np.int64)


def open_simulation(policy: Policy) -> Simulation:
    """The simulation of the policy's task. PolicyFileError and PhysicsError as `play`."""
    content = _simulation(policy)
    names = ("model", "mujoco_version", "substeps", "episode_length", "kept", "read", "qpos", "qvel")
    try:
        task = PortableTask(**{name: content[name] for name in names})
        return Simulation(task, _functions(content))
    except KeyError as error:
        raise PolicyFileError(f"the simulation in {policy.path} lacks {error}; export the policy again") from None


def _episode(simulation: Simulation, policy: Policy, number: int) -> tuple[float, int]:
    obs, over, total, length = simulation.reset(number), False, 0.0, 0
    while not over:
        obs, reward, over = simulation.step(policy.act(obs))
        total, length = total + reward, length + 1
    return total, length


def _simulation(policy: Policy) -> Mapping[str, Any]:
    if policy.simulation is None:
        raise PolicyFileError(
            f"{policy.path} cannot be played: {policy.facts.get('not_playable') or 'it brings no simulation'}"
        )
    return policy.simulation


def _functions(content: Mapping[str, Any]) -> TaskFunctions:
    """The functions of the task, each a small ONNX model in the file."""
    sessions = {name: open_session(content[name], name) for name in ("command", "outcome", "first_observation")}
    wanted = {name: {given.name for given in session.get_inputs()} for name, session in sessions.items()}

    def run(name: str, before: Fields, action: np.ndarray | None = None, after: Fields | None = None) -> Any:
        given = {f"before.{field}": value for field, value in before.items()}
        given |= {f"after.{field}": value for field, value in (after or {}).items()}
        if action is not None:
            given["action"] = action
        return sessions[name].run(None, {key: value for key, value in given.items() if key in wanted[name]})

    def command(before: Fields, action: np.ndarray) -> np.ndarray:
        ctrl: np.ndarray = run("command", before, action)[0]
        return ctrl

    def outcome(before: Fields, action: np.ndarray, after: Fields) -> tuple[np.ndarray, float, bool]:
        obs, reward, terminated = run("outcome", before, action, after)
        return obs, float(reward), bool(terminated)

    def first_observation(fields: Fields) -> np.ndarray:
        obs: np.ndarray = run("first_observation", fields)[0]
        return obs

    return TaskFunctions(command, outcome, first_observation)
