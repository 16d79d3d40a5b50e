"""The results as JSON and as Markdown, written anew whenever there is something new."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.gpu.rows import Row
from benchmarks.gpu.session import Outcome

JSON, MARKDOWN = "results.json", "results.md"

PHASES = ("wait", "learner", "publish", "physics", "policy", "push")
"""Phases of the service that are shown; the JSON has all of them."""


@dataclass(frozen=True)
class Facts:
    """What the results are of: device as JAX names it, machine, software and sizes."""

    device: Mapping[str, str]
    machine: Mapping[str, str]
    scale: str
    sizes: Mapping[str, Any]
    budget_s: float


def write(folder: Path, facts: Facts, outcomes: Sequence[Outcome]) -> None:
    """Write both files; whoever is killed in between leaves the former ones whole."""
    content = asdict(facts) | {"cases": [asdict(outcome) for outcome in outcomes]}
    _replace(folder / JSON, json.dumps(content, indent=2) + "\n")
    _replace(folder / MARKDOWN, "\n".join(lines(facts, outcomes)) + "\n")


def lines(facts: Facts, outcomes: Sequence[Outcome]) -> Iterator[str]:
    """The Markdown."""
    yield f"# {facts.device['devices']}, {facts.machine['date']}"
    yield ""
    yield from _head(facts)
    for title, kind, table in TABLES:
        rows = [row for outcome in outcomes if outcome.kind == kind for row in outcome.rows]
        if rows:
            yield from ("", f"## {title}", "", *table(rows))
    left = [outcome for outcome in outcomes if outcome.state != "done"]
    if left:
        yield from ("", "## Not measured, or not to the end", "")
    for outcome in left:
        yield f"- {outcome.name}: {outcome.state}{': ' + _one_line(outcome.reason) if outcome.reason else ''}"


def _head(facts: Facts) -> Iterator[str]:
    device, machine = facts.device, facts.machine
    memory = f", {device['memory']}" if device.get("memory") else ""
    yield f"- device: {device['backend']}, {device['devices']}{memory}; driver {device.get('driver') or 'unknown'}"
    yield f"- {machine['cores']} cores of {machine['cpu']}, load {machine['load']} at the start"
    names = ("python", "jax", "jaxlib", "mujoco", "mujoco-mjx", "brax", "eclipse-zenoh")
    yield f"- commit {machine['commit'][:12]}; {', '.join(f'{name} {machine[name]}' for name in names)}"
    if facts.scale == "full":
        yield f"- {facts.sizes['num_envs']} environments x {facts.sizes['num_steps']} steps an update"
    else:
        yield "- scale small: whether every case runs; its figures mean nothing"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield f"| {' | '.join(head)} |"
    yield f"|{'---|' * len(head)}"
    yield from (f"| {' | '.join(cells)} |" for cells in rows)


def _physics(rows: Sequence[Row]) -> Iterator[str]:
    head = ("task", "engine", "environments", "environment steps/s", "compiling", "diverged", "")
    yield from _table(head, [_physics_cells(row) for row in rows])


def _physics_cells(row: Row) -> list[str]:
    first = [row["task"], row["engine"], f"{row['envs']:,}"]
    if "steps_s" not in row:
        return [*first, "-", "-", "-", row["note"]]
    return [*first, f"{row['steps_s']:,.0f}", f"{row['compile_s']:.0f} s", f"{row['diverged']}", row.get("note", "")]


def _updates(rows: Sequence[Row]) -> Iterator[str]:
    head = ("task", "learner", "products", "ms an update", "by ppo in the same precision", "compiling")
    cells = [
        [row["task"], row["case"], row["precision"], f"{row['ms']:.1f}", f"{row['by_ppo']:.2f}",
         f"{row['compile_s']:.0f} s"]
        for row in rows
    ]  # fmt: skip
    yield from _table(head, cells)


def _service(rows: Sequence[Row]) -> Iterator[str]:
    head = ("settings", "mode", "actors", "environment steps/s", "5e7 steps", "ms an update", *PHASES)
    cells = []
    for row in rows:
        ms = [f"{row['ms'][name]:.1f}" if name in row["ms"] else "-" for name in ("update", *PHASES)]
        settings = " ".join(word.removeprefix("--") for word in row["settings"])
        speed = [f"{row['steps_s']:,.0f}", f"{row['minutes_of_paper']:.1f} min"]
        cells.append([settings, row["mode"], str(row["actors"]), *speed, *ms])
    yield from _table(head, cells)


Table = Callable[[Sequence[Row]], Iterator[str]]

TABLES: tuple[tuple[str, str, Table], ...] = (
    ("Physics alone", "physics", _physics),
    ("Updates", "update", _updates),
    ("Runs of the service", "service", _service),
)


def _one_line(reason: str) -> str:
    return " / ".join(line.strip() for line in reason.splitlines() if line.strip())


def _replace(path: Path, text: str) -> None:
    part = path.with_name(path.name + ".part")
    part.write_text(text)
    os.replace(part, path)
