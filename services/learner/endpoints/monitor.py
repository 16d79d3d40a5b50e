"""The record that `reskpn status` shows: the actors that are here, and the answers that messages got.

There are no threads or clocks here: the hub holds its lock around every call and passes the time. Nothing grows with
the number of messages: reasons and kinds are words of this program, slots are those of the run.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection
from dataclasses import dataclass, field

from common.config.settings import RunSettings
from common.printable import printable, shortened
from common.wire.messages import PushReply
from common.wire.report import LONGEST, ActorReport, Progress, RefusalReport, RunReport, Totals, VacancyReport
from common.wire.rollout import Rollout
from services.learner.scheduling.fleet import Fleet, Member

KEPT_VERSIONS = 256
"""Versions whose time of publication is kept."""


@dataclass
class SlotRecord:
    """The present or last actor of one slot, and the answers to the rollouts that were pushed for it since then."""

    since_s: float
    incarnation: str | None = None
    host: str = ""
    answers: Counter[str] = field(default_factory=Counter)


@dataclass(frozen=True)
class _Refusal:
    kind: str
    reason: str
    text: str
    at_s: float


class RunMonitor:
    """Kept by the hub beside the fleet, which decides; the monitor only records."""

    def __init__(self, run: str, settings: RunSettings, now_s: float) -> None:
        self._run = run
        self._settings = settings
        self._began_s = now_s
        self._records = [SlotRecord(now_s) for _ in range(settings.actors)]
        self._published: deque[tuple[int, float]] = deque(maxlen=KEPT_VERSIONS)
        self._progress: tuple[Progress, float] | None = None
        self._answers: Counter[str] = Counter()
        self._refused: dict[str, Counter[str]] = {}
        self._refused_joins: Counter[str] = Counter()
        self._last: _Refusal | None = None

    # -- events --------------------------------------------------------------------------------------------

    def joined(self, slot: int, incarnation: str, host: str, now_s: float) -> None:
        """Record that an incarnation holds the slot; the counts of a new one begin at zero."""
        if self._records[slot].incarnation != incarnation:
            self._records[slot] = SlotRecord(now_s, incarnation, printable(host, 64))

    def left(self, slot: int, now_s: float) -> None:
        self._records[slot] = SlotRecord(now_s)

    def join_refused(self, reason: str) -> None:
        """Count a request to join that got no slot."""
        self._refused_joins[reason] += 1

    def published(self, version: int, now_s: float) -> None:
        self._published.append((version, now_s))

    def progressed(self, progress: Progress, now_s: float) -> None:
        """Record the progress that the learner's loop reports at this moment."""
        self._progress = (progress, now_s)

    def answered(self, key: str, reply: PushReply, now_s: float) -> None:
        """Count a rollout pushed on `key` that was not used: refused, busy, or a duplicate, which is accepted."""
        if reply.status == "refused":
            self.refused("rollout", reply.slug, reply.text, now_s)
        self._count(key.rpartition("/")[2], "repeated" if reply.status == "accepted" else reply.status)

    def accepted(self, slot: int) -> None:
        """Count a rollout that is in the log and will be used."""
        self._count(str(slot), "accepted")

    def refused(self, kind: str, reason: str, text: str, now_s: float) -> None:
        """Count a message that was not used; `kind` and `reason` are words of this program, never the sender's."""
        self._refused.setdefault(kind, Counter())[reason] += 1
        self._last = _Refusal(kind, reason, printable(text, 300), now_s)

    def overtaken(self, rollouts: Collection[Rollout], version: int, now_s: float) -> None:
        """Count rollouts that were accepted and are too old to be used by the update of `version`."""
        for rollout in rollouts:
            text = f"made with policy {rollout.policy_version}, overtaken by those of version {version}"
            self.refused("rollout", "overtaken", text, now_s)

    def connection_refused(self, reason: str, text: str, now_s: float) -> bool:
        """Count a refused connection; returns whether it is the first with this reason."""
        self.refused("connection", reason, text, now_s)
        return self._refused["connection"][reason] == 1

    def _count(self, slot: str, what: str) -> None:
        self._answers[what] += 1
        if slot.isdecimal() and len(slot) < 10 and int(slot) < len(self._records):
            self._records[int(slot)].answers[what] += 1

    # -- reports -------------------------------------------------------------------------------------------

    def refusals(self) -> Counter[str]:
        """The number of messages that were not used, by reason."""
        return sum(self._refused.values(), Counter())

    def report(self, fleet: Fleet, waiting_for: str, now_s: float, t_ns: int) -> RunReport:
        """The state of the run at this moment."""
        held = fleet.members()
        free = sorted(set(range(len(self._records))) - {slot for slot, _ in held})
        return RunReport(
            run=self._run,
            task=self._settings.task,
            learner=self._settings.learner,
            endpoint=self._settings.transport.endpoint,
            t_ns=t_ns,
            up_s=now_s - self._began_s,
            progress=self._aged_progress(now_s),
            waiting_for=printable(waiting_for, LONGEST),
            rollouts_there=fleet.available,
            slots=len(self._records),
            actors=[self._actor(slot, member, now_s) for slot, member in held],
            vacancies=[self._vacancy(slot, fleet, now_s) for slot in free],
            totals=Totals(**self._answers, joined=fleet.counts.joined, lost=fleet.counts.lost),
            refusals={kind: dict(counts) for kind, counts in self._refused.items()},
            refused_joins=dict(self._refused_joins),
            last_refusal=self._last_refusal(now_s),
        )

    def _aged_progress(self, now_s: float) -> Progress | None:
        if self._progress is None:
            return None
        progress, reported_s = self._progress
        return progress.model_copy(update={"text": printable(progress.text, LONGEST), "age_s": now_s - reported_s})

    def _actor(self, slot: int, member: Member, now_s: float) -> ActorReport:
        published_s = dict(self._published).get(member.version)
        heard_s = now_s - member.heard_s
        counts = {what: self._records[slot].answers[what] for what in ("accepted", "refused", "busy", "repeated")}
        return ActorReport(
            slot=slot,
            generation=member.generation,
            incarnation=shortened(member.incarnation),
            host=self._records[slot].host,
            state=member.state,
            state_s=member.state_s + heard_s,
            physics=member.physics,
            version=member.version,
            snapshot_age_s=None if published_s is None else now_s - published_s,
            env_steps=member.env_steps,
            steps_per_s=member.steps_per_s,
            heard_s=heard_s,
            **counts,
        )

    def _vacancy(self, slot: int, fleet: Fleet, now_s: float) -> VacancyReport:
        return VacancyReport(slot=slot, lost=fleet.was_held(slot), for_s=now_s - self._records[slot].since_s)

    def _last_refusal(self, now_s: float) -> RefusalReport | None:
        last = self._last
        if last is None:
            return None
        return RefusalReport(kind=last.kind, reason=last.reason, text=last.text, ago_s=now_s - last.at_s)
