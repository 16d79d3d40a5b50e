"""The nearest known name for one that was mistyped, and the sentence that offers it."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

CUTOFF = 0.5
"""Least similarity (`difflib`'s ratio) of a name that is worth suggesting."""


def unknown_name(kind: str, given: str, allowed: Iterable[str]) -> str:
    """The sentence for a name that is not in a table, with the nearest one that is."""
    names = list(allowed)
    near = nearest_name(given, names)
    hint = f"did you mean {near!r}? " if near else ""
    article = "an" if kind[0] in "aeiou" else "a"
    return f"{given!r} is not {article} {kind}; {hint}allowed: {', '.join(names)}"


def nearest_name(given: str, allowed: Iterable[str]) -> str | None:
    """The name that `given` most likely stands for; None where none is similar.

    Letter case, and whether words are joined by "-" or "_", make no difference.
    """
    by_plain = {_plain(name): name for name in allowed}
    near = difflib.get_close_matches(_plain(given), by_plain, n=1, cutoff=CUTOFF)
    return by_plain[near[0]] if near else None


def nearest_path(given: str, allowed: Iterable[str], separator: str) -> str | None:
    """The name of a tree's leaf that `given` most likely stands for, such as `algorithm.gamma`; None where none is.

    Names are compared whole, and then by their last part alone: `gamma` and `lr` stand for `algorithm.gamma` and
    `algorithm.learning_rate`, which as wholes have little in common with them.
    """
    names = list(allowed)
    section, _, leaf = given.rpartition(separator)
    inside = [name for name in names if _plain(name.rpartition(separator)[0]) == _plain(section)]
    for candidates in (inside, names):
        by_leaf = {_plain(name.rpartition(separator)[2]).lstrip("_"): name for name in reversed(candidates)}
        key = _plain(leaf).lstrip("_")
        if key in by_leaf:
            return by_leaf[key]
        initials = {"".join(word[0] for word in re.split("_", name) if word): full for name, full in by_leaf.items()}
        if len(key) > 1 and key in initials:
            return initials[key]
    whole = nearest_name(given, names)
    if whole is not None:
        return whole
    near = difflib.get_close_matches(key, by_leaf, n=1, cutoff=CUTOFF)
    return by_leaf[near[0]] if near else None


def _plain(name: str) -> str:
    return name.lower().replace("-", "_")
