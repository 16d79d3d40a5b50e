"""The eight tasks: the one model behind both engines."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from common.errors import SettingsError
from common.physics.models import OPTIONS, c_model, load_task
from common.tasks import TASKS

# Seconds of simulated time in a step: MuJoCo's timestep in the task's model times the substeps of the task.
SECONDS_PER_STEP = {
    "inverted_pendulum": 0.02 * 2,
    "hopper": 0.002 * 4,
    "halfcheetah": 0.01 * 5,
    "walker2d": 0.002 * 4,
    "humanoid": 0.003 * 5,
    "humanoidstandup": 0.003 * 5,
    "pusher": 0.01 * 5,
    "reacher": 0.01 * 2,
}


@pytest.mark.parametrize("task", TASKS)
def test_both_engines_have_the_same_options(task: str, task_of: Any) -> None:
    """The C model runs with every option that the task set for MJX, not with those of the file it was read from."""
    environment = task_of(task)
    model = c_model(environment)
    for option in OPTIONS:
        expected = np.asarray(getattr(environment.sys.opt, option))
        np.testing.assert_array_equal(np.asarray(getattr(model.opt, option), expected.dtype), expected, option)
    assert model.opt.timestep * environment._n_frames == pytest.approx(SECONDS_PER_STEP[task], rel=1e-9)


def test_humanoid_runs_with_the_options_that_brax_sets_after_reading_it(task_of: Any) -> None:
    """brax's humanoid asks for one iteration of Newton's method and no implicit damping; its file asks for eight."""
    environment = task_of("humanoid")
    model = c_model(environment)
    assert model.opt.iterations == 1
    assert model.opt.ls_iterations == 4
    assert model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON
    assert model.opt.disableflags == mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    assert environment.sys.mj_model.opt.iterations == 8  # brax's own copy is left as it was


@pytest.mark.parametrize("task", TASKS)
def test_positions_velocities_and_warm_start_are_a_models_whole_state(task: str, task_of: Any) -> None:
    """What else MuJoCo can carry from step to step, and `Bodies` does not hold, no task has."""
    model = c_model(task_of(task))
    assert (model.na, model.nmocap, model.neq, model.nuserdata, model.npluginstate) == (0, 0, 0, 0, 0)


def test_an_unknown_task_is_refused_with_the_nearest_name() -> None:
    """brax calls it `halfcheetah`; who writes `half_cheetah` is told so."""
    with pytest.raises(SettingsError, match=r"'half_cheetah' is not a task; did you mean 'halfcheetah'"):
        load_task("half_cheetah")
