"""Faults in settings as sentences: what was given, where it came from, what is wrong with it, what could be meant."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from common.config.tree import leaves
from common.suggestions import nearest_path

PREFIX = "RESKPN_"
COMMAND_LINE = "the command line"
ENVIRONMENT = "the environment"
CALL = "the call"

Location = tuple[int | str, ...]


@dataclass(frozen=True)
class Source:
    """A source of settings by its name, and the values that it sets, in the shape of the tree."""

    name: str
    values: Mapping[str, Any]

    def sets(self, location: Location) -> bool:
        """Return whether it sets the value at a place of the tree, or the list that has it as an element."""
        values: Any = self.values
        for part in location:
            if isinstance(values, list | tuple | str):
                return True
            if not isinstance(values, Mapping) or part not in values:
                return False
            values = values[part]
        return bool(location)


def explain(error: ValidationError, sources: Sequence[Source]) -> str:
    """One line for each fault: the setting, where its value came from, the value, and what is wrong with it."""
    lines = []
    for fault in error.errors(include_url=False, include_context=False):
        location: Location = fault["loc"]
        name = ".".join(str(part) for part in location)
        source = next((source.name for source in sources if source.sets(location)), "")
        text = fault["msg"].removeprefix("Value error, ")
        if fault["type"] == "extra_forbidden":
            lines.append(unknown_setting(spelled(name, source), source))
            continue
        if not name:
            lines.append(text + _origins(text, sources))
            continue
        if not text.startswith(repr(fault["input"])):
            text = f"{fault['input']!r}: {text}"
        lines.append(f"{name}{f' (from {source})' if source else ''}: {text}")
    return "\n".join(lines)


def unknown_setting(given: str, source: str) -> str:
    """The sentence for a name that is not a setting, with the nearest one as it is spelled in that source."""
    section, _, rest = given.partition(".")
    if source not in (COMMAND_LINE, ENVIRONMENT) and given in leaves() and rest:
        text = f"in a file, write {rest!r} indented under {section!r}:"
    else:
        text = _suggestion(given, source, leaves()) or "docs/settings.md and `reskpn train --help` list all of them"
    return f"{given}{f' (from {source})' if source else ''} is not a setting; {text}"


def unknown_option(given: str, command: str, allowed: Iterable[str]) -> str:
    """The sentence for an option that a command does not have, with the nearest of those that it has."""
    near = _suggestion(given, COMMAND_LINE, (_plain(name) for name in allowed)) if given.startswith("-") else ""
    help_text = near or f"`{command} --help` lists all of them"
    return f"{given} (from {COMMAND_LINE}) is not an option of `{command}`; {help_text}"


def spelled(name: str, source: str) -> str:
    """A dotted name as a source spells it: `--algorithm.learning-rate`, `RESKPN_ALGORITHM__LEARNING_RATE`."""
    if source == COMMAND_LINE:
        return f"--{name.replace('_', '-')}"
    return f"{PREFIX}{name.replace('.', '__').upper()}" if source == ENVIRONMENT else name


def _suggestion(given: str, source: str, allowed: Iterable[str]) -> str:
    near = nearest_path(_plain(given), allowed, ".")
    return f"did you mean {spelled(near, source)}?" if near else ""


def _plain(given: str) -> str:
    """A name of any source as a dotted name."""
    name = given.removeprefix("--").removeprefix(PREFIX)
    return name.replace("__", ".").replace("-", "_").lower()


def _origins(text: str, sources: Sequence[Source]) -> str:
    """The sources of the settings that a sentence about several of them names."""
    found = []
    for name in leaves():
        source = next((source.name for source in sources if source.sets(tuple(name.split(".")))), "")
        if source and re.search(rf"(?<![\w.]){re.escape(name)}(?![\w.]*\w)", text):
            found.append(f"{name} is from {source}")
    return f" ({', '.join(found)})" if found else ""
