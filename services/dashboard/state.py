"""The present state of a run as plain JSON: how far it is, its fleet, and one line about what it waits for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from common.printable import printable
from common.wire.report import ActorReport, RunReport, VacancyReport
from services.dashboard.points import number, text, whole

MOST_ACTORS = 256

Phase = Literal["finished", "running", "waiting"]


@dataclass(frozen=True)
class Facts:
    """The facts about a run that its settings tell; "-" or None where they do not."""

    run: str = "-"
    task: str = "-"
    learner: str = "-"
    seed: int | None = None
    mode: str = "-"
    updates: int | None = None
    total_steps: int | None = None
    slots: int | None = None
    details: Mapping[str, str] = field(default_factory=dict)


def facts_of_settings(run: str, settings: Mapping[str, Any]) -> Facts:
    """The facts in a run's settings, of this or another release."""
    total, batch = whole(settings.get("total_steps")), _batch(settings)
    rkhs, algorithm = settings.get("rkhs"), settings.get("algorithm")
    return Facts(
        run=text(run, 80) or "-",
        task=text(settings.get("task"), 80) or "-",
        learner=text(settings.get("learner"), 40) or "-",
        seed=whole(settings.get("seed")),
        mode=text(settings.get("mode"), 10) or "sync",
        updates=total // batch if total and batch else None,
        total_steps=total // batch * batch if total and batch else None,
        slots=whole(settings.get("actors")),
        details=_details(settings, rkhs, algorithm),
    )


def _batch(settings: Mapping[str, Any]) -> int | None:
    envs, steps = whole(settings.get("num_envs")), whole(settings.get("num_steps"))
    return envs * steps if envs and steps else None


def _details(settings: Mapping[str, Any], rkhs: object, algorithm: object) -> dict[str, str]:
    """A few settings by name, as text, for the table that compares runs."""
    found = {
        name: settings.get(name)
        for name in ("task", "learner", "seed", "mode", "actors", "num_envs", "num_steps", "total_steps")
    }
    if isinstance(algorithm, Mapping):
        found |= {f"algorithm.{name}": algorithm.get(name) for name in ("learning_rate", "gamma", "epochs", "clip")}
    if isinstance(rkhs, Mapping):
        found |= {f"rkhs.{name}": rkhs.get(name) for name in ("representation", "kernel", "bandwidth", "step", "eta")}
    return {name: printable(str(value), 60) for name, value in found.items() if value is not None}


def state_of_report(report: RunReport) -> dict[str, Any]:
    """The state that a learner reports."""
    progress = report.progress
    state: dict[str, Any] = {
        "actors": [_actor(actor, progress.version if progress else None) for actor in report.actors[:MOST_ACTORS]],
        "vacancies": [_vacancy(vacancy) for vacancy in report.vacancies[:MOST_ACTORS]],
        "slots": report.slots,
        "evaluators": report.evaluators,
        "totals": report.totals.model_dump(),
        "refused": {text(kind, 40): sum(counts.values()) for kind, counts in list(report.refusals.items())[:20]},
        "last_refusal": text(report.last_refusal.text, 300) if report.last_refusal else "",
        "waits": text(report.waiting_for, 400),
        "up_s": number(report.up_s),
    }
    if progress is None:
        return state | {"phase": "starting"}
    return state | {
        "phase": text(progress.phase, 20),
        "waits": text(progress.text, 400) or state["waits"],
        "version": progress.version,
        "updates": progress.updates,
        "env_steps": progress.env_steps,
        "total_steps": progress.total_steps,
        "steps_per_s": number(progress.steps_per_s),
        "remaining_s": number(progress.remaining_s),
        "return": number(progress.train_return),
        "step_reward": number(progress.step_reward),
        "staleness": number(progress.staleness),
        "diverged": progress.diverged,
        "centres": progress.centres,
        "capacity": progress.capacity,
    }


def state_of_log(facts: Facts, latest: Mapping[str, Any], slots: Mapping[int, Mapping[str, Any]]) -> dict[str, Any]:
    """The state as far as the log of a run has it."""
    speed, steps = latest.get("run/steps_per_s"), latest.get("env_steps", 0)
    left = None if facts.total_steps is None or not speed else max(0.0, (facts.total_steps - steps) / speed)
    return {
        "version": latest.get("version", 0),
        "updates": facts.updates,
        "env_steps": steps,
        "total_steps": facts.total_steps,
        "steps_per_s": speed,
        "remaining_s": number(left),
        "return": latest.get("run/return"),
        "step_reward": latest.get("run/step_reward"),
        "staleness": latest.get("staleness/mean"),
        "centres": whole(int(latest["rkhs/centres"])) if latest.get("rkhs/centres") is not None else None,
        "slots": facts.slots,
        "logged_slots": [{"slot": slot, **used} for slot, used in sorted(slots.items())],
    }


def _actor(actor: ActorReport, newest: int | None) -> dict[str, Any]:
    return {
        "slot": actor.slot,
        "actor": text(actor.incarnation)[:8],
        "host": text(actor.host, 40),
        "state": text(actor.state, 20),
        "state_s": number(actor.state_s),
        "engine": text(actor.physics, 10),
        "version": actor.version,
        "behind": 0 if newest is None else max(0, newest - actor.version),
        "policy_age_s": number(actor.snapshot_age_s),
        "steps_per_s": number(actor.steps_per_s),
        "heard_s": number(actor.heard_s),
        "accepted": actor.accepted,
        "refused": actor.refused + actor.busy,
    }


def _vacancy(vacancy: VacancyReport) -> dict[str, Any]:
    return {"slot": vacancy.slot, "lost": vacancy.lost, "for_s": number(vacancy.for_s)}
