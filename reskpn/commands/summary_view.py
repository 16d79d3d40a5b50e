"""The summary of a finished run as text."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from common.printable import printable
from common.runs.listing import read_summary
from reskpn.commands.status_view import duration, number


def finished_summary(run_dir: Path) -> dict[str, Any] | None:
    """The summary of a run that made all its updates; None if it has not finished."""
    summary = read_summary(run_dir)
    return summary if summary is not None and summary.get("complete") is True else None


def print_summary(run_dir: Path, summary: dict[str, Any], *, as_json: bool) -> None:
    """Print it as lines, or as one JSON object."""
    if as_json:
        print(json.dumps(summary), flush=True)
        return
    for line in describe_summary(run_dir, summary):
        print(line, flush=True)


def describe_summary(run_dir: Path, summary: dict[str, Any]) -> list[str]:
    """The lines; figures that the file does not have are dashes."""
    name = printable(f"{summary.get('run')}: {summary.get('learner')} on {summary.get('task')}")
    figures = {key: value for key, value in summary.items() if _is_number(value)}
    wall_s = figures.get("wall_s")
    lines = [
        f"{name} has finished; {run_dir}",
        f"{number(figures.get('total_steps'))} steps in {number(figures.get('updates'))} updates, seed "
        f"{number(figures.get('seed'))}, {'-' if wall_s is None else duration(wall_s)}, "
        f"{number(figures.get('env_steps_per_s'))} steps/s",
    ]
    if figures.get("eval_episodes"):
        lines.append(
            f"final evaluation: return {number(figures.get('eval_return_mean'), 1)} ± "
            f"{number(figures.get('eval_return_std'), 1)} over {number(figures['eval_episodes'])} episodes"
        )
    lines.append(f"return while training: {number(figures.get('train_return_mean'), 1)}")
    lines.append(f"state digest {printable(str(summary.get('state_digest')))}")
    return lines


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
