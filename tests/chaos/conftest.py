"""What the chaos tests share: the run that nobody disturbs, and a table of the promises with what was found."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.chaos.interruptions import OPTIONS, UPDATES, Processes, audited, processes

PROMISE, FOUND = "promise", "found"


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Processes]:
    """Starts processes that end with the test."""
    with processes(tmp_path) as made:
        yield made


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The digests of the run of `OPTIONS` that nobody disturbs."""
    folder = tmp_path_factory.mktemp("undisturbed")
    with processes(folder) as made:
        made.start("train", *OPTIONS, "--run-dir", folder / "run").end()
    return audited(folder / "run", UPDATES)


@pytest.fixture
def found(record_property: Callable[[str, object], None]) -> Callable[[str], None]:
    """Says for the table what a test has found."""
    return lambda text: record_property(FOUND, text)


@pytest.fixture(autouse=True)
def _promise(request: pytest.FixtureRequest, record_property: Callable[[str, object], None]) -> None:
    """The promise of a test is the first sentence of what it says of itself."""
    text = " ".join((inspect.getdoc(request.function) or "").split())
    record_property(PROMISE, text.partition(". ")[0].rstrip("."))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """A line for every test: its promise, and what was found; then the count."""
    reports = [
        (outcome, report)
        for outcome in ("passed", "failed", "skipped", "error")
        for report in terminalreporter.stats.get(outcome, [])
        if PROMISE in dict(getattr(report, "user_properties", []))
    ]
    if not reports:
        return
    terminalreporter.section("promises")
    for outcome, report in reports:
        said = dict(report.user_properties)
        name = report.nodeid.rpartition("/")[2].replace(".py::", ": ")
        verdict = {"passed": "kept", "skipped": "not tried"}.get(outcome, "BROKEN")
        terminalreporter.write_line(f"{verdict:9} {report.duration:4.0f} s  {name}")
        terminalreporter.write_line(f"{'':18}{said[PROMISE]}")
        if FOUND in said:
            terminalreporter.write_line(f"{'':18}found: {said[FOUND]}")
    kept = sum(outcome == "passed" for outcome, _ in reports)
    terminalreporter.write_line(f"{len(reports)} tests: {kept} promises kept, {len(reports) - kept} not")
