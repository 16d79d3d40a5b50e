"""Text from the network, made safe to show on a terminal and in a log."""

from __future__ import annotations

import re


def printable(text: str, limit: int = 200) -> str:
    """One line of at most `limit` characters, with control characters replaced by "?"."""
    shown = "".join(character if character.isprintable() else "?" for character in text[:limit])
    return shown if len(text) <= limit else shown[: limit - 3] + "..."


_SECRET = re.compile(r"[0-9a-f]{32,}")


def shortened(incarnation: str) -> str:
    """The part of an incarnation that others may see: whoever knows the whole can act for its slot."""
    return incarnation[:8] if _SECRET.fullmatch(incarnation) else incarnation


def shortened_within(text: str) -> str:
    """The text with every incarnation in it shortened."""
    return re.sub(rf"\b{_SECRET.pattern}\b", lambda found: f"{shortened(found.group())}...", text)


def quoted(value: object, limit: int = 60) -> str:
    """A value that came over the network, for an error text: its repr, of at most `limit` characters of it.

    Nothing but the part that is shown is ever formatted: the repr of a value can take several times its memory.
    """
    if isinstance(value, str | bytes):
        return repr(value[:limit]) + ("..." if len(value) > limit else "")
    if value is None or isinstance(value, bool | int | float):
        return repr(value)[:limit]
    return f"a value of type {type(value).__name__}"
