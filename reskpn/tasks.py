"""The parts of a task of one's own: `from reskpn.tasks import Data, Task`. See docs/tasks.md."""

from __future__ import annotations

from common.physics.simulation import Data
from common.physics.task import Task

__all__ = ["Data", "Task"]
