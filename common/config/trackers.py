"""The packages that `track` names, which are installed by those who use them."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec

from common.errors import SettingsError


def require_trackers(names: Sequence[str]) -> None:
    """SettingsError for a tracker whose package is not installed."""
    missing = [name for name in names if find_spec(name) is None]
    if missing:
        packages = " ".join(missing)
        raise SettingsError(f"track {','.join(names)}: not installed here; install with: pip install {packages}")
