"""A log with trajectories of a small robot, written without a run: a cart with a pole, on a floor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from common.log.writer import LogWriter
from common.wire.divergence import Divergence
from common.wire.motion import Motion, Motions

RUN = "cart-1"
STEP_S = 0.04
MJCF = """
<mujoco model="cart">
  <worldbody>
    <light pos="0 0 3" dir="0 0 -1"/>
    <geom name="floor" type="plane" size="5 5 0.1" rgba="0.8 0.8 0.8 1"/>
    <camera name="side" pos="0 -3 0.5" xyaxes="1 0 0 0 0 1"/>
    <body name="cart" pos="0 0 0.3">
      <joint name="slide" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.2 0.1 0.1" mass="1" rgba="0.9 0.1 0.1 1"/>
      <body name="pole">
        <joint name="hinge" type="hinge" axis="0 1 0"/>
        <geom name="rod" type="capsule" fromto="0 0 0 0 0 0.6" size="0.04" mass="0.1" rgba="0.1 0.1 0.9 1"/>
        <geom name="knob" type="sphere" pos="0 0 0.6" size="0.08" mass="0.1"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="slide"/></actuator>
</mujoco>
"""


def motion(steps: int, start: float = 0.0) -> Motion:
    """The cart goes right by 0.01 a step, and the reward of step n is n."""
    n = np.arange(steps, dtype=np.float32)
    return Motion(
        qpos=np.stack([start + 0.01 * n, 0.02 * n], axis=1).astype(np.float32),
        qvel=np.tile(np.float32([0.25, 0.5]), (steps, 1)),
        action=np.full((steps, 1), 0.5, np.float32),
        reward=n,
    )


def motions(version: int, lengths: Sequence[int], source: str = "evaluator-e1") -> bytes:
    """A `/motion` message with an episode of each length, each starting 1 further than the last."""
    made = [motion(steps, float(number)) for number, steps in enumerate(lengths)]
    return Motions.of(made, run=RUN, version=version, source=source, step_s=STEP_S).encode()


def divergence(steps: int, version: int = 10, env: int = 3) -> bytes:
    """A `/divergence` message."""
    made = motion(steps)
    return Divergence(
        run=RUN, slot=1, incarnation="a", generation=0, seq=7, policy_version=version, env=env, step=4, step_s=STEP_S,
        qpos=made.qpos, qvel=made.qvel, action=made.action, reward=made.reward,
    ).encode()  # fmt: skip


def write_log(
    directory: Path, *messages: tuple[str, bytes], mjcf: str = MJCF, files: dict[str, bytes] | None = None
) -> Path:
    """A run directory whose log has its settings, the model and these messages."""
    attachments = {"cart.xml": ("application/xml", mjcf.encode())}
    attachments |= {name: ("application/octet-stream", data) for name, data in (files or {}).items()}
    spec: dict[str, Any] = {"run": RUN, "settings": {"task": "cart"}}
    with LogWriter(directory / "log", attachments=attachments) as log:
        log.write("/spec", spec)
        for topic, data in messages:
            log.write(topic, data)
    return directory


def usual_log(directory: Path) -> Path:
    """Versions 0 and 20 by an evaluator, 20 again by the run itself, and two diverged simulations."""
    return write_log(
        directory,
        ("/motion", motions(0, [30])),
        ("/divergence", divergence(5, version=10)),
        ("/divergence", divergence(51, version=20)),
        ("/motion", motions(20, [50, 40])),
        ("/motion", motions(20, [60], source="run")),
    )
