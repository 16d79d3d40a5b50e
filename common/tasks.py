"""The tasks by name, with the sizes that networks and messages need.

Three families: the paper's eight (`brax.envs`), Gymnasium's MuJoCo tasks (`hopper-v5`), and tasks of one's own, which
are named `module:Class` or by an entry point of the group `reskpn.tasks`. The sizes of the first two are written down
here (and checked by tests), so that the learner needs no physics engine; those of one's own are in the run's settings
as the task's pin. Nothing here imports a task: a log or a learner may name any module.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points

from common.errors import SettingsError
from common.suggestions import unknown_name

EPISODE_LENGTH = 1000
"""Steps after which an episode is truncated (paper, section B.3)."""

ENTRY_POINTS = "reskpn.tasks"

MAX_SLUG = 40
"""Characters of a task's name that names of runs keep: they are limited themselves."""

_CLASS = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)
_PIN = re.compile(r"([1-9]\d{0,5})x([1-9]\d{0,5})-([0-9a-f]{16})", re.ASCII)


@dataclass(frozen=True)
class Task:
    """One environment: O = `observation_size`, A = `action_size`, and the usual length of its episodes."""

    name: str
    observation_size: int
    action_size: int
    episode_length: int = EPISODE_LENGTH


def _table(*tasks: Task) -> dict[str, Task]:
    return {task.name: task for task in tasks}


TASKS = _table(
    Task("inverted_pendulum", 4, 1),
    Task("hopper", 11, 3),
    Task("halfcheetah", 17, 6),
    Task("walker2d", 17, 6),
    Task("humanoid", 244, 17),
    Task("humanoidstandup", 244, 17),
    Task("pusher", 23, 7),
    Task("reacher", 11, 2),
)
"""The eight tasks of the paper, by the names of `brax.envs`."""

GYMNASIUM = _table(
    Task("ant-v5", 105, 8),
    Task("halfcheetah-v5", 17, 6),
    Task("hopper-v5", 11, 3),
    Task("humanoid-v5", 348, 17),
    Task("humanoidstandup-v5", 348, 17),
    Task("inverteddoublependulum-v5", 9, 1),
    Task("invertedpendulum-v5", 4, 1),
    Task("pusher-v5", 23, 7, episode_length=100),
    Task("reacher-v5", 10, 2, episode_length=50),
    Task("swimmer-v5", 8, 2),
    Task("walker2d-v5", 17, 6),
)
"""Gymnasium's MuJoCo tasks in their fifth version, by its names in lower case."""

BUILT_IN = TASKS | GYMNASIUM


@cache
def installed_tasks() -> dict[str, str]:
    """The tasks of installed packages: `module:Class` by the name of the entry point."""
    return {
        point.name: point.value
        for point in sorted(entry_points(group=ENTRY_POINTS), key=lambda point: point.name)
        if point.name not in BUILT_IN
    }


def is_own(name: str) -> bool:
    """True for a task that is a class of one's own: `module:Class`, or the name of an entry point."""
    return name not in BUILT_IN


def is_class_name(name: str) -> bool:
    """True for `module:Class`."""
    return _CLASS.fullmatch(name) is not None


def task_fault(name: str, pin: str | None) -> str | None:
    """The sentence for a name, or a pin, that no task can have; None where it may be a task's."""
    if pin is not None and not _PIN.fullmatch(pin):
        return f"task_pin is {pin!r}; it is written by the learner, as in 6x1-0123456789abcdef; leave it out"
    if name in BUILT_IN or is_class_name(name):
        return None
    if ":" in name:
        return f"{name!r} is not the name of a class: write module:Class, as in pendulum:DoublePendulum"
    # A run of a package that is not installed here can be read all the same.
    if pin is not None or name in installed_tasks():
        return None
    return f"{unknown_name('task', name, [*BUILT_IN, *installed_tasks()])}, or module:Class for a task of your own"


def pin_of(observation_size: int, action_size: int, digest: str) -> str:
    """The pin of a task of one's own. `digest`: hex, of its content."""
    return f"{observation_size}x{action_size}-{digest[:16]}"


def find_task(name: str, pin: str | None = None) -> Task:
    """The sizes of a task; those of one's own are in its pin.

    Raises:
        SettingsError: there is no such task, or its pin is missing.
    """
    if (fault := task_fault(name, pin)) is not None:
        raise SettingsError(fault)
    if name in BUILT_IN:
        return BUILT_IN[name]
    match = None if pin is None else _PIN.fullmatch(pin)
    if match is None:
        raise SettingsError(f"task {name} has not been read: its sizes are not known; start with --task {name}")
    return Task(name, int(match[1]), int(match[2]))


def slug(name: str) -> str:
    """The name of a task as a part of names of runs, keys and files: `pendulum.doublependulum`."""
    return name if name in BUILT_IN else re.sub(r"[^a-z0-9_.-]", ".", name.lower())[-MAX_SLUG:].lstrip("_.-")
