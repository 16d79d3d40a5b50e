"""The names of the physics engines, as settings and messages have them; docs/physics.md says which is for what."""

from __future__ import annotations

from typing import Final

AUTO: Final = "auto"
MJX: Final = "mjx"
NATIVE: Final = "native"
PHYSICS: Final = (AUTO, MJX, NATIVE)
