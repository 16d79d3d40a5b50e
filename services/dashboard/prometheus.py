"""The newest figures of the runs that are running, for Prometheus."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from prometheus_client import CollectorRegistry, Metric, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.registry import Collector

from common.wire.report import RunReport
from services.dashboard.collection import ShownRun
from services.dashboard.points import text

MOST_RUNS = 16
"""Runs of one answer: the newest."""

CURVES = {
    "run/return": ("return", "mean return of the newest training episodes"),
    "run/step_reward": ("step_reward", "mean reward of a step of the newest batch"),
    "run/steps_per_s": ("steps_per_second", "environment steps a second since training began"),
    "train/policy_loss": ("policy_loss", "loss of the policy in the newest update"),
    "train/value_loss": ("value_loss", "loss of the value in the newest update"),
    "train/kl": ("kl", "divergence of the newest update's policy from the one before, nats"),
    "policy/std": ("policy_std", "mean standard deviation of the policy's actions"),
    "rkhs/centres": ("centres", "centres of the kernel expansion"),
    "rkhs/share": ("kernel_share", "share of the kernel part in the mean action, by squares"),
    "staleness/mean": ("staleness", "versions between the policy that acted and the one updated, mean"),
}

RUN = ("run", "task", "learner")


class _Figures(Collector):
    """The figures of these runs as metric families, each with a sample for a run."""

    def __init__(self, runs: Sequence[ShownRun]) -> None:
        self._runs = runs

    def collect(self) -> Iterator[Metric]:
        runs = [(run, run.view.state, run.view.latest) for run in self._runs[:MOST_RUNS]]
        labelled = [(_labels(run, state), run, state, latest) for run, state, latest in runs]
        updates = [(labels, latest.get("version")) for labels, _, _, latest in labelled]
        yield _gauge("update", "updates made", updates)
        steps = [(labels, latest.get("env_steps")) for labels, _, _, latest in labelled]
        yield _gauge("environment_steps", "environment steps used", steps)
        for name, (metric, help_) in CURVES.items():
            yield _gauge(metric, help_, [(labels, latest.get(name)) for labels, _, _, latest in labelled])
        evaluations = [(labels, run.view.evaluation) for labels, run, _, _ in labelled]
        yield _gauge(
            "evaluation_return",
            "mean return of the newest evaluation, without exploration",
            [(labels, found and found["return_mean"]) for labels, found in evaluations],
        )
        yield self._phases(labelled)
        yield from self._fleet([(labels, run.fresh_report()) for labels, run, _, _ in labelled])

    def _phases(self, labelled: Sequence[tuple[list[str], ShownRun, Any, dict[str, Any]]]) -> Metric:
        family = GaugeMetricFamily(
            "reskpn_update_seconds", "seconds of the newest update by phase", labels=[*RUN, "phase"]
        )
        for labels, _, _, latest in labelled:
            for name, value in latest.items():
                if name.startswith("seconds/"):
                    family.add_metric([*labels, name.removeprefix("seconds/")], value)
        return family

    def _fleet(self, reported: Sequence[tuple[list[str], RunReport | None]]) -> Iterator[Metric]:
        yield _gauge(
            "learner_up", "1 if the learner answers", [(labels, float(bool(found))) for labels, found in reported]
        )
        known = [(labels, report) for labels, report in reported if report is not None]
        yield _gauge("actors", "actors that hold a slot", [(labels, len(report.actors)) for labels, report in known])
        yield _gauge("slots", "slots of the run", [(labels, report.slots) for labels, report in known])
        rollouts = CounterMetricFamily(
            "reskpn_rollouts", "rollouts pushed since the learner's start, by outcome", labels=[*RUN, "outcome"]
        )
        speed = GaugeMetricFamily(
            "reskpn_actor_steps_per_second", "environment steps a second of an actor", labels=[*RUN, "slot"]
        )
        heard = GaugeMetricFamily("reskpn_actor_heard_seconds", "seconds since its heartbeat", labels=[*RUN, "slot"])
        for labels, report in known:
            for outcome in ("accepted", "refused", "busy", "repeated"):
                rollouts.add_metric([*labels, outcome], report.totals.model_dump()[outcome])
            for actor in report.actors[:256]:
                speed.add_metric([*labels, str(actor.slot)], actor.steps_per_s)
                heard.add_metric([*labels, str(actor.slot)], actor.heard_s)
        yield from (rollouts, speed, heard)


def exposition(runs: Sequence[ShownRun]) -> bytes:
    """The figures in Prometheus' text format."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Figures(runs))
    return generate_latest(registry)


def _labels(run: ShownRun, state: dict[str, Any]) -> list[str]:
    return [run.identity, text(state.get("task")), text(state.get("learner"))]


def _gauge(name: str, help_: str, values: Sequence[tuple[list[str], Any]]) -> Metric:
    family = GaugeMetricFamily(f"reskpn_{name}", help_, labels=list(RUN))
    for labels, value in values:
        if isinstance(value, int | float):
            family.add_metric(labels, value)
    return family
