"""The report: what a learner wrote is what a watcher reads, and nothing else is taken for one."""

from __future__ import annotations

import json

import pytest

from common.errors import CodecError
from common.wire.report import MAX_REPORT_BYTES, ActorReport, Progress, RefusalReport, RunReport, Totals, VacancyReport

ACTOR = ActorReport(
    slot=0, generation=1, incarnation="5f", host="h", state="collecting", state_s=0.5, physics="native", version=3,
    snapshot_age_s=None, env_steps=100, steps_per_s=20.0, heard_s=0.1, accepted=4, refused=3, busy=2, repeated=1,
)  # fmt: skip
PROGRESS = Progress(
    phase="training", text="", version=3, updates=9, env_steps=300, total_steps=900, steps_per_s=None,
    train_return=1.5, step_reward=0.5, staleness=0.0, age_s=0.2,
)  # fmt: skip
REPORT = RunReport(
    run="r", task="hopper", learner="ppo", endpoint="tcp/127.0.0.1:7447", t_ns=5, up_s=60.0, progress=PROGRESS,
    waiting_for="", rollouts_there=1, slots=2, actors=[ACTOR], vacancies=[VacancyReport(slot=1, lost=True, for_s=2.0)],
    totals=Totals(accepted=4, joined=2, lost=1), refusals={"rollout": {"stale": 3}}, refused_joins={"no_slot": 7},
    last_refusal=RefusalReport(kind="rollout", reason="stale", text="old", ago_s=1.0),
)  # fmt: skip


def test_a_report_comes_back_as_it_was() -> None:
    """Through its JSON."""
    assert RunReport.decode(REPORT.encode()) == REPORT


def test_a_report_of_a_newer_release_can_be_read() -> None:
    """What this side does not know is left out."""
    assert RunReport.decode(json.dumps(json.loads(REPORT.encode()) | {"of_the_future": [1]}).encode()) == REPORT


def test_a_report_of_an_older_release_can_be_read() -> None:
    """The reward of a step was not told in the first."""
    old = json.loads(REPORT.encode())
    del old["progress"]["step_reward"]
    progress = RunReport.decode(json.dumps(old).encode()).progress
    assert progress is not None
    assert (progress.step_reward, progress.train_return) == (None, 1.5)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff",
        b"[]",
        b"{}",
        b"[" * 100_000,
        REPORT.encode()[:-1],
        REPORT.encode().replace(b'"slots":2', b'"slots":"two"'),
        REPORT.encode().replace(b'"up_s":60.0', b'"up_s":NaN'),
        REPORT.encode().replace(b'"run":"r"', b'"run":"' + b"r" * 5000 + b'"'),
    ],
)
def test_what_is_no_report_is_refused(data: bytes) -> None:
    """Whatever the bytes are, in one sentence."""
    with pytest.raises(CodecError, match="this is not the report of a learner") as caught:
        RunReport.decode(data)
    assert caught.value.reason == "bad_value"


def test_a_report_that_is_too_large_is_not_read() -> None:
    """Its size is looked at first."""
    with pytest.raises(CodecError, match="a report of") as caught:
        RunReport.decode(b" " * (MAX_REPORT_BYTES + 1))
    assert caught.value.reason == "too_large"


def test_former_names_stay_readable_in_the_json() -> None:
    """`told_s` is `age_s`, and `turned_away` is `refused_joins`."""
    told = json.loads(REPORT.encode())
    assert (told["progress"]["told_s"], told["progress"]["age_s"]) == (0.2, 0.2)
    assert told["turned_away"] == told["refused_joins"] == {"no_slot": 7}


def test_a_figure_that_is_not_finite_is_not_known() -> None:
    """JSON has no infinity: a mean that overflows leaves the rest of the report readable."""
    shown = Progress(**PROGRESS.model_dump(exclude={"told_s"}) | {"train_return": float("inf")})
    assert shown.train_return is None
    assert json.loads(shown.encode())["train_return"] is None
