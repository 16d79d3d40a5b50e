"""Texts that came over the network, made fit for a terminal and a log."""

from __future__ import annotations


def printable(text: str, limit: int = 200) -> str:
    """One line of at most `limit` characters; what a terminal would obey instead of showing becomes "?"."""
    shown = "".join(character if character.isprintable() else "?" for character in text[:limit])
    return shown if len(text) <= limit else shown[: limit - 3] + "..."
