"""Numbers by environment step as TensorBoard event files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from tensorboardX import SummaryWriter


class Scalars:
    """Event files in a folder; TensorBoard shows the folders of many runs side by side."""

    def __init__(self, folder: Path) -> None:
        self._writer = SummaryWriter(str(folder), flush_secs=5)

    def add(self, env_steps: int, values: Mapping[str, float | None]) -> None:
        """One value a name at this many environment steps; None is left out."""
        for name, value in values.items():
            if value is not None:
                self._writer.add_scalar(name, value, env_steps)

    def close(self) -> None:
        self._writer.close()
