"""The HTML of a report: pictures, figures, settings and versions, with nothing loaded from anywhere."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from common.config.presets import default_settings
from reskpn.study.recorded import RunRecord, result_of
from reskpn.study.report import pictures

MOST_EVENTS = 40

INCARNATION = re.compile(r"\b([0-9a-f]{8})[0-9a-f]{16,}\b")
"""Whoever knows all of an incarnation could speak for it while the run goes on: the page has its beginning."""

PRIVATE = {"run_dir", "transport"}
"""Settings that say where a run is kept and reached: a page is for sending."""

STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.45 system-ui, sans-serif; color: #1c1c1c; background: #fff; margin: 0 auto; max-width: 72rem;
  padding: 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.1rem; margin: 1.6rem 0 .4rem; }
.pictures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 30rem), 1fr)); gap: 1rem; }
figure { margin: .6rem 0 0; break-inside: avoid; } figure svg { width: 100%; height: auto; }
figcaption { color: #444; font-size: .9rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .85rem; }
th, td { text-align: left; padding: .15rem .7rem .15rem 0; border-bottom: 1px solid #ddd; vertical-align: top;
  overflow-wrap: anywhere; }
th:first-child, td:first-child { white-space: nowrap; overflow-wrap: normal; }
code { font-size: .95em; }
details > summary { cursor: pointer; font-weight: 600; margin-top: 1.2rem; }
@media print { body { max-width: none; padding: 0; font-size: 11px; } .pictures { grid-template-columns: 1fr 1fr; }
  details > summary { list-style: none; } .wide { overflow: visible; } tr { break-inside: avoid; } }
"""


def page(records: Sequence[RunRecord]) -> str:
    """The report of these runs as one HTML document."""
    title = f"{records[0].run}" if len(records) == 1 else f"{len(records)} runs"
    body = [f"<h1>ResKPN: {escape(title)}</h1>", "<h2>Runs</h2>", _runs(records), '<div class="pictures">']
    body += [_figure(svg, text) for svg, text in _pictures(records) if svg is not None]
    body += ["</div>", _events(records), _settings(records), _origins(records)]
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>ResKPN: {escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(body)
        + "\n</body>\n</html>\n"
    )


def _pictures(records: Sequence[RunRecord]) -> list[tuple[str | None, str]]:
    metric = pictures.metric_picture
    variance = ("variance/gradient", "variance/of_q", "variance/of_a", "variance/of_a_residual")
    found = [
        (
            pictures.return_picture(records),
            "Return of training episodes; diamonds: evaluations without exploration. Where no episode terminates: the "
            "reward of a step times the length of an episode.",
        ),
        (metric(records, variance, "variance", "log"), "Variance of the functional gradient (equation 10)."),
        (metric(records, ("rkhs/centres",), "centres"), "Centres, landmarks or features of the kernel expansion."),
        (
            metric(records, ("rkhs/norm", "rkhs/share"), "norm; share of h"),
            "Norm of h, and its share of the mean.",
        ),
        (metric(records, ("train/kl", "rkhs/step_kl"), "KL divergence", "log"), "KL divergence of an update."),
        (metric(records, ("policy/std",), "standard deviation"), "Standard deviation of the policy."),
        (pictures.staleness_picture(records), "Versions between the policies that acted and the one updated."),
    ]
    for record in records:
        found.append((pictures.timeline_picture(record), f"Where the time of an update went: {record.run}."))
    return found


def _figure(svg: str, text: str) -> str:
    return f"<figure>{svg}<figcaption>{escape(text)}</figcaption></figure>"


def _runs(records: Sequence[RunRecord]) -> str:
    """The figures of each run, a column a run."""
    header = ["", *(record.run for record in records)]
    rows: dict[str, list[str]] = {}
    for record in records:
        result = result_of(record)
        scores, settings = result.scores, record.settings
        for name, value in {
            "task": settings.task,
            "learner": settings.learner,
            "seed": str(settings.seed),
            "updates": f"{record.curve.updates:,} of {settings.updates:,}",
            "environment steps": f"{record.curve.updates * settings.batch_size:,}",
            "return, last tenth": _number(scores.last_tenth),
            "return, whole run": _number(scores.area),
            "evaluation": _number(scores.evaluation),
            "seconds": f"{result.timing.wall_s:,.1f}",
            "steps a second": f"{result.timing.env_steps_per_s:,.0f}",
            "state digest": record.digest,
        }.items():
            rows.setdefault(name, []).append(value)
    return _table(header, [[name, *values] for name, values in rows.items()])


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:,.1f}"


def _events(records: Sequence[RunRecord]) -> str:
    rows = [
        [f"{at_s:,.1f} s", record.run, INCARNATION.sub(r"\1...", text)]
        for record in records
        for at_s, text in record.events[:MOST_EVENTS]
    ]
    left = sum(max(0, len(record.events) - MOST_EVENTS) for record in records)
    more = f"<p>{left} later events are in the logs.</p>" if left else ""
    return "<h2>Events</h2>" + (_table(["time", "run", "event"], rows) if rows else "<p>none</p>") + more


def _settings(records: Sequence[RunRecord]) -> str:
    """All settings, those first in which a run differs from the defaults or from another run."""
    defaults = _leaves(default_settings().model_dump(mode="json", exclude=PRIVATE))
    trees = [_leaves(record.settings.model_dump(mode="json", exclude=PRIVATE)) for record in records]
    header = ["setting", *(record.run for record in records)]

    def row(name: str) -> list[str]:
        return [name, *(tree.get(name, "-") for tree in trees)]

    changed = [name for name in trees[0] if {tree.get(name) for tree in trees} != {defaults.get(name)}]
    others = [name for name in trees[0] if name not in changed]
    return (
        "<h2>Settings other than the defaults</h2>"
        + _table(header, [row(name) for name in changed])
        + "<details><summary>All other settings</summary>"
        + _table(header, [row(name) for name in others])
        + "</details>"
    )


def _origins(records: Sequence[RunRecord]) -> str:
    sections: list[Mapping[str, str]] = [
        {"commit": record.metadata.get("run", {}).get("commit", "unknown")}
        | dict(record.metadata.get("versions", {}))
        | {name: text for name, text in record.metadata.get("hardware", {}).items() if name != "host"}
        for record in records
    ]
    names = list(dict.fromkeys(name for section in sections for name in section))
    rows = [[name, *(section.get(name, "-") for section in sections)] for name in names]
    return "<h2>Versions and machine</h2>" + _table(["", *(record.run for record in records)], rows)


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _leaves(tree: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    leaves: dict[str, str] = {}
    for name, value in tree.items():
        leaves |= _leaves(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: str(value)}
    return leaves
