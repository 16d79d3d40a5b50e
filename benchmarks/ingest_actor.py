"""An actor without computation: it joins, sends heartbeats and pushes the same rollout under increasing numbers.

`python -m benchmarks.ingest_actor ENDPOINT` works until the run is over. It does not import JAX.
"""

from __future__ import annotations

import sys
import threading
import time

import numpy as np

from common.config.settings import RunSettings
from common.runs.rollout_shape import rollout_shape
from common.wire.messages import Orders
from common.wire.rollout import Rollout, RolloutShape
from common.wire.session import Session, open_session
from services.actor.heartbeat import HeartbeatSender
from services.actor.link import ActorLink
from services.worker.joining import Assignment, join

CONNECT_S = 60.0


def act(endpoint: str) -> None:
    """Work for the learner at `endpoint` until its run is over."""
    settings = RunSettings()
    stop = threading.Event()
    with open_session(
        connect=[endpoint], connect_timeout_s=CONNECT_S, max_message_size=settings.transport.max_message_bytes
    ) as session:
        assignment = join(
            session, run="", physics="native", versions={}, hardware={}, stop=stop, waiting=lambda reason: None
        )
        if assignment is not None:
            _work(session, assignment, stop)


def _work(session: Session, assignment: Assignment, stop: threading.Event) -> None:
    link = ActorLink(session, assignment, push_timeout_s=assignment.settings.transport.push_timeout_s)
    arrays = made_up(rollout_shape(assignment.settings))
    orders: Orders | None = None
    version, made, seq = -1, 0, 0
    with HeartbeatSender(link, assignment) as heartbeats:
        heartbeats.set_state("waiting")
        while True:
            orders = link.orders(newer_than=orders, timeout_s=CONNECT_S) or orders
            if orders is None or orders.finished:
                return
            wanted = orders.collect[assignment.slot]
            if version != orders.version and wanted:
                heartbeats.version = version = link.snapshot().version
                made = 0
            while version == orders.version and made < wanted:
                heartbeats.set_state("pushing")
                if not link.push(_numbered(assignment, seq, version, arrays), stop):
                    break
                made, seq = made + 1, seq + 1
                heartbeats.set_state("waiting")


def made_up(shape: RolloutShape) -> dict[str, np.ndarray]:
    """Arrays of a rollout in which no episode ended, drawn from a fixed seed."""
    draw = np.random.default_rng(0).standard_normal
    steps, envs, branches = shape.num_steps, shape.num_envs, shape.branches
    sizes = {
        "obs": (steps, envs, shape.observation_size),
        "action": (steps, envs, shape.action_size),
        "reward": (steps, envs),
        "last_obs": (envs, shape.observation_size),
        "truncated_obs": (0, shape.observation_size),
        "episode_return": (0,),
        "mirror_action": (branches, shape.action_size),
        "mirror_reward": (branches,),
        "mirror_obs": (branches, shape.observation_size),
    }
    numbers = {name: draw(size, np.float32) for name, size in sizes.items()}
    # Those of draws from a policy of mean 0 and deviation 1, as the learner's first one is: others are refused.
    numbers["log_prob"] = (-0.5 * numbers["action"] ** 2 - np.float32(0.9189385)).sum(-1)
    flags = {name: np.zeros((steps, envs), bool) for name in ("terminated", "truncated")}
    mirrored = {name: np.zeros(branches, bool) for name in ("mirror_terminated", "mirror_truncated")}
    return {**numbers, **flags, **mirrored, "episode_length": np.zeros(0, np.int32)}


def _numbered(assignment: Assignment, seq: int, version: int, arrays: dict[str, np.ndarray]) -> Rollout:
    return Rollout(
        run=assignment.run,
        slot=assignment.slot,
        incarnation=assignment.incarnation,
        seq=seq,
        policy_version=version,
        t_ns=time.time_ns(),
        timing={},
        generation=assignment.generation,
        diverged=0,
        **arrays,
    )


if __name__ == "__main__":
    act(sys.argv[1])
