"""A report for a person."""

from __future__ import annotations

import io

import pytest
from reports import actor, progress, report
from rich.console import Console

from common.wire.report import EvaluationReport, RefusalReport, RunReport, Totals, VacancyReport
from reskpn.commands.status_view import COLUMNS, actor_row, duration, head, number, tail, vacancy_row, view


def shown(given: RunReport, width: int = 160) -> list[str]:
    output = io.StringIO()
    Console(file=output, width=width, highlight=False).print(view(given))
    return [line.rstrip() for line in output.getvalue().splitlines()]


def test_the_run_in_three_lines() -> None:
    """Which one, how far it is, and what it waits for."""
    assert head(report(waiting_for="waiting for 1 of 2 rollouts: slot 1 compiling 12 s")) == [
        "hopper-ppo-s0-ab12: ppo on hopper at tcp/127.0.0.1:7447, up 61 s",
        "training | update 7/100 | steps 7,000/100,000 | steps/s 2,500 | return 12.2 | reward 0.75 | actors 2/2",
        "waiting for 1 of 2 rollouts: slot 1 compiling 12 s",
    ]


def test_a_learner_that_is_at_work() -> None:
    """It waits for nothing; how old the figures are is said once it matters."""
    lines = head(report(progress=progress(age_s=75.0)))
    assert lines[1].endswith("actors 2/2 (reported 75 s ago)")
    assert lines[2] == "all rollouts have arrived: the learner is computing"


def test_diverged_simulations() -> None:
    """Counted where there are any."""
    assert "diverged" not in head(report())[1]
    assert head(report(progress=progress(diverged=12)))[1].endswith("actors 2/2 | diverged 12")


def test_a_learner_that_has_just_begun() -> None:
    """Before its loop has told anything."""
    lines = head(report(progress=None, waiting_for="waiting for 2 of 2 rollouts: slot 0 has no actor yet"))
    assert lines[1] == "starting; waiting for 2 of 2 rollouts: slot 0 has no actor yet"


@pytest.mark.parametrize(
    ("phase", "text"), [("compiling", "compiling the update for 4 s"), ("evaluating", "waiting for 64 episodes")]
)
def test_other_things_than_rollouts_are_waited_for(phase: str, text: str) -> None:
    """In the learner's words; figures that there are not are dashes."""
    unknown = {"steps_per_s": None, "train_return": None, "step_reward": None}
    lines = head(report(progress=progress(phase=phase, text=text, **unknown)))
    assert "steps/s - | return - | reward - |" in lines[1]
    assert lines[2] == text


def test_an_actor_in_a_row() -> None:
    """Its first eight letters, and how far its policy is behind the newest."""
    assert actor_row(actor(), 7) == [
        "0", "5f31aa00", "host-1", "collecting 0.2 s", "native", "7", "0.5 s", "1,234", "0.2 s", "41", "3", "2", "1",
    ]  # fmt: skip
    assert actor_row(actor(), 9)[5] == "7 (-2)"
    assert actor_row(actor(snapshot_age_s=None), None)[5:7] == ["7", "-"]
    assert actor_row(actor(state="compiling", version=0), 9)[5:7] == ["-", "-"]


def test_an_actor_that_is_silent_stands_out() -> None:
    """Once it has missed two heartbeats."""
    assert actor_row(actor(heard_s=1.4), 7)[8] == "1.4 s"
    assert actor_row(actor(heard_s=1.9), 7)[8] == "1.9 s SILENT"


def test_a_slot_that_nobody_holds() -> None:
    """A row of its own, with the reason and since when."""
    assert vacancy_row(VacancyReport(slot=3, lost=True, for_s=4.0))[:4] == ["3", "-", "-", "lost its actor 4.0 s"]
    row = vacancy_row(VacancyReport(slot=3, lost=False, for_s=4.0))
    assert row[3] == "no actor yet 4.0 s"
    assert len(row) == len(COLUMNS)


def test_what_was_not_used() -> None:
    """By kind and by reason, the most frequent first, and the newest one in full."""
    last = RefusalReport(kind="rollout", reason="bad_shape", text="obs has shape (1,)", ago_s=3.0)
    lines = tail(
        report(
            totals=Totals(accepted=1200, refused=5, busy=2, repeated=1, joined=4, lost=2),
            refusals={"rollout": {"stale": 2, "bad_shape": 3}, "heartbeat": {"incarnation": 1}},
            refused_joins={"no_slot": 9},
            last_refusal=last,
        )
    )
    assert lines == [
        "rollouts: 1,200 accepted, 5 refused, 2 busy, 1 repeated; actors: 4 joined, 2 lost",
        "not used: heartbeat incarnation 1; rollout bad_shape 3, stale 2",
        "joins refused: no_slot 9",
        "last, 3.0 s ago: rollout bad_shape: obs has shape (1,)",
    ]


def test_the_newest_evaluation() -> None:
    """How far it is behind, how good the policy was, and how many evaluators are here; without any, no line of it."""
    found = EvaluationReport(
        version=40, env_steps=4000, episodes=16, return_mean=512.34, return_std=3.1, length_mean=512.0, source="5f",
        behind=3, ago_s=4.2,
    )  # fmt: skip
    line = "evaluation: policy 40 (-3): return 512.3 ± 3.1 over 16 episodes, 4.2 s ago; 1 evaluator"
    assert tail(report(evaluators=1, evaluation=found))[0] == line
    assert tail(report(evaluators=2))[0] == "evaluation: none yet; 2 evaluators"
    assert tail(report())[0].startswith("rollouts:")


def test_slots_are_in_their_order() -> None:
    """Held or not."""
    lines = shown(report(slots=3, actors=[actor(0), actor(2)], vacancies=[VacancyReport(slot=1, lost=True, for_s=9)]))
    assert lines[3].split()[:3] == ["slot", "actor", "host"]
    assert [line.split()[0] for line in lines[4:7]] == ["0", "1", "2"]


def test_names_of_others_cannot_move_the_terminal() -> None:
    """Nothing of what they hold reaches it as more than a letter."""
    bad = "\x1b[2J\r\n"
    hostile = report(
        run=bad, task=bad, waiting_for=bad, refusals={bad: {bad: 1}},
        actors=[actor(0, incarnation=bad, host=bad, state=bad, physics=bad)],
    )  # fmt: skip
    text = "\n".join(shown(hostile))
    assert "\x1b" not in text
    assert "\r" not in text
    assert "?[2J??" in text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (-0.1, "0.0 s"), (0.04, "0.0 s"), (9.94, "9.9 s"), (12.4, "12 s"), (119.0, "119 s"), (185.0, "3 min 05 s"),
        (7800.0, "2 h 10 min"), (1e308, "long"),
    ],
)  # fmt: skip
def test_durations(seconds: float, text: str) -> None:
    """Short at every size."""
    assert duration(seconds) == text


def test_numbers() -> None:
    """Whole ones with commas, huge ones short."""
    assert [number(value) for value in (None, 0.0, 1234.6, 1e308)] == ["-", "0", "1,235", "1.0e+308"]


@pytest.mark.parametrize("width", [80, 60, 40])
def test_a_narrow_terminal(width: int) -> None:
    """No line is wider, no word is broken: the least needed columns are left out, and lines end between figures."""
    given = report(slots=3, actors=[actor(0), actor(2)], vacancies=[VacancyReport(slot=1, lost=True, for_s=9)])
    lines = shown(given, width)
    assert max(map(len, lines)) <= width
    table = next(index for index, line in enumerate(lines) if line.startswith("slot"))
    assert [line.split()[0] for line in lines[table : table + 4]] == ["slot", "0", "1", "2"]
    names = [column.name for column in COLUMNS]
    assert set(lines[table].split()) < set(names)
    assert "lost its actor 9.0 s" in lines[table + 2]
    figures = ["update 7/100", "steps 7,000/100,000", "steps/s 2,500", "return 12.2", "reward 0.75", "actors 2/3"]
    assert all(any(figure in line for line in lines) for figure in figures)


def test_columns_at_eighty() -> None:
    """What is left of the table in the usual terminal."""
    lines = shown(report(), 80)
    assert next(line for line in lines if line.startswith("slot")).split() == [
        "slot", "host", "state", "policy", "steps/s", "heard", "accepted", "refused", "busy",
    ]  # fmt: skip
