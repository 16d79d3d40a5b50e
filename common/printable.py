"""Texts that came over the network, made fit for a terminal and a log."""

from __future__ import annotations

import re


def printable(text: str, limit: int = 200) -> str:
    """One line of at most `limit` characters; what a terminal would obey instead of showing becomes "?"."""
    shown = "".join(character if character.isprintable() else "?" for character in text[:limit])
    return shown if len(text) <= limit else shown[: limit - 3] + "..."


_SECRET = re.compile(r"[0-9a-f]{32,}")


def shortened(incarnation: str) -> str:
    """What others may see of an incarnation as actors make them: whoever knows all of one can act for its slot."""
    return incarnation[:8] if _SECRET.fullmatch(incarnation) else incarnation
