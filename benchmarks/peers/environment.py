"""The environment of the peers, `build/peers/.venv`: where it is, and what it should hold."""

from __future__ import annotations

import re
from pathlib import Path

from common.errors import ProcessError

ROOT = Path(__file__).parents[2]
PYTHON = ROOT / "build" / "peers" / ".venv" / "bin" / "python"
_PINNED = ("requirements.in", "requirements.txt", "zoo.txt")


def python() -> Path:
    """The interpreter of the peers' environment; ProcessError where it has not been made."""
    if not PYTHON.exists():
        raise ProcessError(
            f"the peers are not installed ({PYTHON.relative_to(ROOT)} is missing): `make peers` installs them in an "
            "environment of their own; or leave them out"
        )
    return PYTHON


def pins(*packages: str) -> dict[str, str]:
    """The pinned versions of these packages; torch's is in requirements.in."""
    text = "\n".join((Path(__file__).parent / name).read_text(encoding="utf-8") for name in _PINNED)
    found = dict(re.findall(r"^([a-zA-Z0-9_-]+)==([^\s;\\]+)", text, re.MULTILINE))
    return {package: found[package] for package in packages}
