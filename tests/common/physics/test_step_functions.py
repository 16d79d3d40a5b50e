"""A task's functions around MuJoCo's step, computed by ONNX Runtime: what the engine's environment does."""

from __future__ import annotations

import pytest

from common.physics.step_functions import StepFunctions
from tests.portable_tasks import check_portable


@pytest.mark.parametrize("task", ["reacher", "swimmer-v5"])
def test_a_portable_task_is_the_task(task: str) -> None:
    """One of brax's and one of Gymnasium's; `make test-runs` has them all."""
    check_portable(task)


def test_the_layout_names_joints() -> None:
    """Of hopper: the height of its body, the angles of its joints, the velocities of all."""
    layout = StepFunctions("hopper").observation_layout()
    assert layout[:3] == ["xpos torso 2", "qpos rooty", "qpos thigh_joint"]
    assert layout[-2:] == ["qvel leg_joint", "qvel foot_joint"]
    assert len(layout) == 11


def test_the_layout_says_what_is_computed() -> None:
    """Reacher's observation begins with cosines and sines of its two joints, which are no numbers of MuJoCo's."""
    layout = StepFunctions("reacher").observation_layout()
    assert layout[:4] == ["computed"] * 4
    assert len(layout) == 11
