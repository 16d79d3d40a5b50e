"""What a person sees: plain lines in a file or pipe, a live line on a terminal."""

from __future__ import annotations

import io
from types import SimpleNamespace

import pytest
from rich.console import Console

from common.wire.report import Progress
from services.learner.reporting import display
from services.learner.reporting.display import PLAIN_PERIOD_S, LiveDisplay, PlainDisplay, make_display

STATUS = Progress(
    phase="training",
    text="",
    version=12,
    updates=100,
    env_steps=12_000,
    total_steps=100_000,
    steps_per_s=2_000.0,
    train_return=34.56,
    step_reward=0.987,
    staleness=0.0,
    centres=12,
    capacity=100,
    actors=1,
    slots=2,
)
UNKNOWN = STATUS.model_copy(
    update=dict(
        phase="starting",
        text="waiting for 2 of 2 rollouts",
        steps_per_s=None,
        train_return=None,
        step_reward=None,
        centres=None,
    )
)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A clock that moves when it is told to: `clock.now = 3.0`."""
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(display, "time", SimpleNamespace(monotonic=lambda: clock.now))
    return clock


def plain() -> tuple[PlainDisplay, io.StringIO]:
    out = io.StringIO()
    return PlainDisplay(Console(file=out, highlight=False), "the title"), out


def test_a_plain_line_has_all_numbers() -> None:
    """Title, then phase, update, steps, speed, return, reward, staleness, actors and centres."""
    shown, out = plain()
    shown.show(STATUS)
    assert out.getvalue().splitlines() == [
        "the title",
        "training | update 12/100 | steps 12,000 | steps/s 2,000 | return 34.6 | reward 0.99 | staleness 0 "
        "| actors 1/2 | centres 12/100",
    ]


def test_what_is_not_known_is_a_dash() -> None:
    """And the text says what is waited for. A learner without an expansion shows no centres."""
    shown, out = plain()
    shown.show(UNKNOWN.model_copy(update=dict(capacity=0)))
    assert out.getvalue().splitlines()[1] == (
        "starting | update 12/100 | steps 12,000 | steps/s - | return - | reward - | staleness 0 | actors 1/2 "
        "| waiting for 2 of 2 rollouts"
    )


def test_diverged_simulations_are_shown_where_there_are_any() -> None:
    """They hint at a policy or a task that is out of hand; most runs have none."""
    shown, out = plain()
    shown.show(STATUS.model_copy(update={"diverged": 1_234}))
    assert "| diverged 1,234 |" in out.getvalue()


def test_plain_lines_come_with_the_phase_and_every_few_seconds(clock: SimpleNamespace) -> None:
    """Not with every update: a log file stays short."""
    shown, out = plain()
    times = [0.0, 1.0, PLAIN_PERIOD_S - 0.01, PLAIN_PERIOD_S, PLAIN_PERIOD_S + 1.0]
    for version, passed in enumerate(times):
        clock.now = 100.0 + passed
        shown.show(STATUS.model_copy(update=dict(version=version)))
    shown.show(STATUS.model_copy(update=dict(version=9, phase="evaluating")))
    # Version 0 is the first, 3 the first after the period, 9 another phase.
    assert [line.split(" | ")[1] for line in out.getvalue().splitlines()[1:]] == [
        "update 0/100",
        "update 3/100",
        "update 9/100",
    ]


def test_notes_are_printed_as_they_are() -> None:
    """Square brackets are no markup, and long lines are not broken."""
    shown, out = plain()
    text = "[red]slot 0[/red] " + "x" * 300
    shown.note(text)
    shown.close()
    assert out.getvalue().splitlines()[1] == text


def test_the_remaining_time() -> None:
    """(100,000 - 12,000) / 2,000 = 44 s; not known without a speed."""
    assert STATUS.remaining_s == 44.0
    assert UNKNOWN.remaining_s is None


def test_a_live_display_shows_the_same_numbers() -> None:
    """On a terminal: share done, time left, numbers, and notes that stay."""
    out = io.StringIO()
    shown = LiveDisplay(Console(file=out, force_terminal=True, width=140, color_system=None), "the title")
    shown.note("[a note]")
    shown.show(UNKNOWN.model_copy(update=dict(env_steps=0)))
    shown.show(STATUS)
    shown.close()
    text = out.getvalue()
    assert "the title" in text
    assert "[a note]" in text
    last = text[text.rindex("training") :]
    # 12,000 of 100,000 steps are 12 %; 44 s are left
    assert " 12%" in last
    assert "0:44 left" in last
    assert "update 12/100 · steps 12,000 · steps/s 2,000 · return 34.6" in last


def test_a_live_display_before_anything_is_known() -> None:
    """No speed, no time left; and it can be closed without ever having shown anything."""
    out = io.StringIO()
    shown = LiveDisplay(Console(file=out, force_terminal=True, width=140, color_system=None), "the title")
    shown.show(UNKNOWN)
    shown.close()
    assert "--:-- left" in out.getvalue()
    assert "waiting for 2 of 2 rollouts" in out.getvalue()
    LiveDisplay(Console(file=io.StringIO(), force_terminal=True), "another").close()


@pytest.mark.parametrize("width", [40, 60, 80, 100])
def test_a_live_display_fits_its_terminal(width: int) -> None:
    """No line is broken and no word is cut: what is least needed is left out, the update never."""
    out = io.StringIO()
    shown = LiveDisplay(Console(file=out, force_terminal=True, width=width, color_system=None), "the title")
    shown.show(STATUS)
    shown.close()
    last = out.getvalue()[out.getvalue().rindex("training") :].splitlines()
    assert " 12%" in last[0]
    assert "0:44 left" in last[0]
    assert "update 12/100" in last[1]
    words = "update 12/100 · steps 12,000 · steps/s 2,000 · return 34.6 · reward 0.99 · staleness 0 · actors 1/2 · "
    shown_numbers = [part.strip() for part in last[1].split("·")]
    assert set(shown_numbers) <= {part.strip() for part in f"{words}centres 12/100".split("·")}
    # 13 characters of update, 14 of return, 16 of steps/s: with their separators the three need 47.
    assert ("steps/s 2,000" in shown_numbers) == (width >= 60)
    assert ("staleness 0" in shown_numbers) == (width > 100)


def test_no_terminal_means_plain_lines(capsys: pytest.CaptureFixture[str]) -> None:
    """Where standard output is a pipe or a file."""
    shown = make_display("the title")
    assert isinstance(shown, PlainDisplay)
    assert capsys.readouterr().out == "the title\n"


def test_a_terminal_means_a_live_display(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where standard output is one."""
    monkeypatch.setattr(display, "Console", lambda **options: Console(file=io.StringIO(), force_terminal=True))
    shown = make_display("the title")
    shown.close()
    assert isinstance(shown, LiveDisplay)
