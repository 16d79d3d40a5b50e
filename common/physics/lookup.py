"""Tasks found by name and made ready: the only place where code of a task is imported.

A `module:Class` is imported only if this process was told to by its own command line, environment or configuration
(`allow_import`): what a learner or a log names is not reason enough to run it. Entry points of installed packages are.
"""

from __future__ import annotations

import importlib
import inspect
import os
import sys
import warnings
from functools import cache

import mujoco

from common.errors import SettingsError
from common.physics.gymnasium_tasks import gymnasium_class
from common.physics.libraries import log_instead_of_printing
from common.physics.mjcf import read_mjcf, spec_of
from common.physics.simulation import AFTER_CONSTRAINTS
from common.physics.task import Task
from common.suggestions import nearest_name
from common.tasks import BUILT_IN, GYMNASIUM, TASKS, installed_tasks, is_class_name, is_own, task_fault

_ALLOWED: set[str] = set()


def allow_import(name: str) -> None:
    """Allow this process to import the class of a task that its user has named."""
    _ALLOWED.add(name)


def is_allowed(name: str) -> bool:
    """True for a task whose code this process may import."""
    return not is_own(name) or name in _ALLOWED or name in installed_tasks()


def require_allowed(name: str) -> None:
    """Raise SettingsError for a task whose code this process was not told to import."""
    if is_allowed(name):
        return
    if not is_class_name(name):
        raise SettingsError(
            f"the run's task {name} belongs to a package that is not installed here; install the package that has it "
            "as an entry point of reskpn.tasks"
        )
    raise SettingsError(
        f"the run's task {name} is a Python class, and code is not run because a run names it: allow it here by "
        f"--task {name}"
    )


def load_definition(name: str) -> Task:
    """The task of Gymnasium's or of one's own, with its model.

    Raises:
        SettingsError: there is none, it may not be imported, its class is not that of a task, or its MJCF does not
            load.
    """
    if name in TASKS:
        raise SettingsError(f"task {name} is one of brax's, which are no classes")
    if (fault := task_fault(name, None)) is not None:
        raise SettingsError(fault)
    require_allowed(name)
    return _load(name)


@cache
def _load(name: str) -> Task:
    found = gymnasium_class(name) if name in GYMNASIUM else task_class(installed_tasks().get(name, name))
    task = _instance(name, found)
    log_instead_of_printing()
    task.model = _compiled(name, task)
    return task


def task_class(name: str) -> type[Task]:
    """The class `module:Class`. SettingsError where there is none, or it is not a task's."""
    module_name, _, class_name = name.partition(":")
    module = _import(name, module_name)
    classes = {key: value for key, value in vars(module).items() if inspect.isclass(value)}
    found = classes.get(class_name)
    if found is None:
        tasks = [key for key, value in classes.items() if issubclass(value, Task) and value is not Task]
        near = nearest_name(class_name, tasks)
        hint = f"did you mean {near}? it" if near else "it"
        raise SettingsError(
            f"--task {name}: module {module_name} has no class {class_name}; {hint} has {', '.join(tasks) or 'no task'}"
        )
    if not issubclass(found, Task):
        raise SettingsError(f"--task {name}: {class_name} is not a task: derive it from reskpn.tasks.Task")
    return found


def _import(name: str, module_name: str) -> object:
    if (here := os.getcwd()) not in sys.path:
        sys.path.append(here)  # last, so that a file of the current folder does not replace a library
    importlib.invalidate_caches()
    try:
        return importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is None or not module_name.startswith(error.name):
            raise SettingsError(f"--task {name}: {module_name} imports {error.name}, which is not installed") from None
        near = nearest_name(module_name, [path.removesuffix(".py") for path in os.listdir() if path.endswith(".py")])
        hint = f"did you mean {near}? " if near and near != module_name else ""
        raise SettingsError(
            f"--task {name}: there is no module {module_name}; {hint}modules are found in the current folder ({here}) "
            "and on PYTHONPATH"
        ) from None
    except Exception as error:  # a user's module may raise anything
        raise SettingsError(f"--task {name}: importing {module_name} raises {type(error).__name__}: {error}") from error


def _instance(name: str, found: type[Task]) -> Task:
    missing = sorted(getattr(found, "__abstractmethods__", ()))
    if missing:
        raise SettingsError(f"task {name}: class {found.__name__} has no method {' and no method '.join(missing)}")
    if "mjcf" not in {attribute for cls in found.__mro__ for attribute in vars(cls)}:
        raise SettingsError(
            f"task {name}: class {found.__name__} has no model: set mjcf to MJCF or to the path of a file"
        )
    if found.frame_skip < 1 or found.episode_length < 1:
        raise SettingsError(f"task {name}: frame_skip and episode_length of {found.__name__} must be at least 1")
    try:
        return found()
    except TypeError as error:
        raise SettingsError(f"task {name}: class {found.__name__} must be made without arguments ({error})") from None


def _compiled(name: str, task: Task) -> mujoco.MjModel:
    """The task's model, with a sensor where the task reads what engines compute only for one."""
    spec = spec_of(name, read_mjcf(name, task))
    try:
        if set(task.reads) & set(AFTER_CONSTRAINTS):
            _add_sensor(spec)
        with warnings.catch_warnings():
            if name in GYMNASIUM:  # of models that are not ours to change
                warnings.filterwarnings("ignore", message="compiler attribute")
            model = spec.compile()
    except ValueError as error:
        raise SettingsError(f"task {name}: its MJCF does not load: {' '.join(str(error).split())}") from None
    if not model.nu:
        raise SettingsError(f"task {name}: its MJCF has no actuator, so there is nothing to learn; add some <actuator>")
    return model


def _add_sensor(spec: mujoco.MjSpec) -> None:
    moving = next((body for body in spec.bodies[1:] if body.joints), None)
    if moving is not None:
        moving.name = moving.name or "reskpn_moving"
        spec.add_sensor(
            name="reskpn_after_constraints",
            type=mujoco.mjtSensor.mjSENS_FRAMELINACC,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            objname=moving.name,
        )


def known_names() -> list[str]:
    """The names of all tasks that are built in or installed."""
    return [*BUILT_IN, *installed_tasks()]
