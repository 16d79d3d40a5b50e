"""Write the table of sizes in docs/operations.md from the code: `python -m scripts.document_sizing`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from common.config.settings import RunSettings
from common.tasks import TASKS
from reskpn.doctor.needs import needs, rollout_bytes

PAGE = Path(__file__).parent.parent / "docs" / "operations.md"
BEGIN = "<!-- Made by `python -m scripts.document_sizing`; a test holds it against the code. -->"
END = "<!-- So far. -->"

MILLION = 1_000_000
ACTORS = 2


def page(text: str) -> str:
    """The page with the table as the code has it; ValueError where the page has no place for it."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"{PAGE} lacks {BEGIN!r} or {END!r}")
    return f"{before}{BEGIN}\n{table()}{END}{after}"


def table() -> str:
    """The bytes that a step, a rollout and a million steps of every task take in the log."""
    return "".join(f"{line}\n" for line in _lines())


def _lines() -> Iterator[str]:
    yield "| task | numbers a step | log, bytes a step | one rollout | log of a million steps |"
    yield "| --- | --- | --- | --- | --- |"
    for task in TASKS.values():
        settings = sized(task.name)
        a_step = needs(settings, 0, 0).log / (settings.updates * settings.batch_size)
        numbers = task.observation_size + task.action_size + 4
        yield (
            f"| `{task.name}` | {numbers} | {a_step:,.0f} | {rollout_bytes(settings) / 1e6:,.2f} MB "
            f"| {a_step * MILLION / 1e9:,.2f} GB |"
        )


def sized(task: str) -> RunSettings:
    """The default run of a task, with two actors."""
    return RunSettings(task=task, actors=ACTORS)


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text()))
