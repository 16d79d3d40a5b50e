"""The audit of a recorded run beside its re-execution: its other records, and what lies beside its log.

The re-execution compares states and metrics. Here the other figures of each update are compared with its rollouts, the
logged policies and episodes with the update they belong to, and the end of the log with the checkpoints and the
summary that lie beside it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from common.errors import CheckpointError, CodecError
from common.files import read_text
from common.log.chain import ChainCheck
from common.log.records import LogMessage
from common.log.segments import LOG_DIRECTORY
from common.runs.directory import SUMMARY
from common.runs.recorded_run import RecordedRun
from common.runs.recorded_updates import RecordedUpdate
from common.wire.messages import Snapshot
from services.learner.reporting.evaluations import is_of_the_run
from services.learner.reporting.statistics import Episodes, TrainingReturn
from services.learner.reporting.summary import train_return
from services.learner.training.checkpoints import list_checkpoints, read_checkpoint
from services.replay.beginning import ReplayBeginning, describe_removed, directory_of

RELATIVE_ERROR = 1e-5
"""Means of episodes are summed in single precision, whose order other releases of NumPy may choose otherwise."""


@dataclass
class _Logged:
    """The records that belong to one update, written before it."""

    episode: Mapping[str, Any] | None = None
    policy_digest: str | None = None


@dataclass
class Audit:
    """Collects what does not fit. `updates` feeds the re-execution, `check` follows it, `conclude` ends it.

    Args:
        policy_digest: of the policy that the re-execution has come to.
        begins: where the re-execution begins.

    Attributes:
        findings: a sentence for each.
    """

    run: RecordedRun
    chain: ChainCheck
    policy_digest: Callable[[], str]
    begins: ReplayBeginning = field(default_factory=ReplayBeginning)
    findings: list[str] = field(default_factory=list)
    _logged: dict[int, _Logged] = field(default_factory=dict)
    _digests: dict[int, str] = field(default_factory=dict)
    _evaluation: Mapping[str, Any] | None = None
    _env_steps: int = 0
    _returns: TrainingReturn = field(init=False)

    def __post_init__(self) -> None:
        settings, before = self.run.newest_settings(), self.run.before
        self._returns = TrainingReturn(settings.updates, episodes=before.earlier_episodes)
        for ended in before.window:
            self._returns.recall(asdict(ended))
        if not self.run.whole and settings.log.keep == "everything":
            self.findings.append(f"{describe_removed(self.run)}, although log.keep is everything")

    def updates(self, until: int | None) -> Iterator[RecordedUpdate]:
        """The updates of the run; what is logged of each is kept until it is checked."""
        for message, content in self.run.messages(self.chain, after=self.begins.version):
            if isinstance(content, RecordedUpdate):
                yield content
                if content.version == until:
                    return
            else:
                self._keep(message)

    def check(self, update: RecordedUpdate, *, exact: bool) -> None:
        """Compare the records of an update that was just made again; `exact`: its state is the recorded one."""
        version, settings = update.version, self.run.settings
        logged = self._logged.pop(version, _Logged())
        self._digests[version] = update.state_digest
        self._env_steps = update.env_steps
        self._compare(f"env_steps of update {version}", update.env_steps, version * settings.batch_size)
        self._returns.add(version, Episodes.of(update.rollouts))
        behind = [version - 1 - rollout.policy_version for rollout in update.rollouts]
        staleness = {"min": min(behind), "mean": sum(behind) / len(behind), "max": max(behind)}
        self._compare_all(f"staleness of update {version}", update.staleness, staleness)
        self._check_episode(version, logged.episode, Episodes.of(update.rollouts).record(version))
        if logged.policy_digest is None:
            if version % settings.log.policy_every == 0:
                self.findings.append(f"the policy of version {version} is not in the log")
        elif exact and logged.policy_digest != self.policy_digest():
            self.findings.append(f"the policy of version {version} in the log is not the one that the update leads to")

    def conclude(self) -> None:
        """Compare the end of the log with what lies beside it."""
        last = max(self._digests, default=0)
        run_dir = directory_of(self.run)
        if not (run_dir / LOG_DIRECTORY).is_dir():
            return
        for path in list_checkpoints(run_dir):
            self._check_checkpoint(path, last)
        try:
            summary = json.loads(read_text(run_dir / SUMMARY))
        except FileNotFoundError:
            return
        except (OSError, ValueError, RecursionError) as error:
            self.findings.append(f"{SUMMARY} cannot be read: {error}")
            return
        if isinstance(summary, dict):
            self._check_summary(summary, last)

    def _keep(self, message: LogMessage) -> None:
        if message.topic == "/episode":
            record = message.json()
            self._of(record).episode = record
            if int(record.get("version", 0)) <= self.begins.version:
                self._returns.recall(record)
        elif message.topic == "/update":
            self._pass_over(message.json())
        elif message.topic == "/policy":
            try:
                snapshot = Snapshot.decode(message.data)
            except CodecError as error:
                self.findings.append(f"message {message.sequence} of /policy is not a policy: {error}")
                return
            self._logged.setdefault(snapshot.version, _Logged()).policy_digest = snapshot.digest
        elif message.topic == "/eval" and is_of_the_run(record := message.json()):
            self._evaluation = record

    def _pass_over(self, record: Mapping[str, Any]) -> None:
        """Take in an update that is not made again: its state is that of the checkpoint, or before it."""
        version, digest = int(record["version"]), str(record.get("state_digest"))
        self._logged.pop(version, None)
        self._digests[version], self._env_steps = digest, version * self.run.settings.batch_size
        if version == self.begins.version:
            self._compare(f"state digest in {self.begins.path}", self.begins.digest, digest)

    def _of(self, record: Mapping[str, Any]) -> _Logged:
        return self._logged.setdefault(int(record.get("version", 0)), _Logged())

    def _check_episode(
        self, version: int, recorded: Mapping[str, Any] | None, computed: Mapping[str, float] | None
    ) -> None:
        if recorded is None or computed is None:
            if (recorded is None) != (computed is None):
                where = "the log" if recorded is None else "its rollouts"
                self.findings.append(f"the episodes that ended in update {version} are not in {where}")
            return
        self._compare_all(f"episodes of update {version}", recorded, computed)

    def _check_checkpoint(self, path: Path, last: int) -> None:
        try:
            state = read_checkpoint(path)
        except CheckpointError as error:
            self.findings.append(str(error))
            return
        if state.version > last:
            self.findings.append(
                f"the log ends at update {last}, but there is a checkpoint of version {state.version}: the end of the "
                "log is missing"
            )
        elif state.version in self._digests:
            self._compare(f"state digest in {path.name}", state.digest, self._digests[state.version])

    def _check_summary(self, summary: Mapping[str, Any], last: int) -> None:
        self._compare(f"run in {SUMMARY}", summary.get("run"), self.run.run)
        self._compare(f"updates in {SUMMARY}", summary.get("updates"), last)
        if summary.get("updates") != last:
            return
        self._compare(f"total_steps in {SUMMARY}", summary.get("total_steps"), self._env_steps)
        self._compare(f"state_digest in {SUMMARY}", summary.get("state_digest"), self._digests.get(last))
        if self.chain.sealed or "train_return_over" in summary:  # earlier releases took other means
            mean, over = train_return(self._returns)
            self._compare(f"train_return_mean in {SUMMARY}", summary.get("train_return_mean"), mean)
            self._compare(f"train_return_over in {SUMMARY}", summary.get("train_return_over"), over)
            self._compare(f"train_episodes in {SUMMARY}", summary.get("train_episodes"), self._returns.episodes)
        evaluation = self._evaluation or {}
        for name in ("return_mean", "return_std", "episodes"):
            found = summary.get(f"eval_{name}")
            self._compare(f"eval_{name} in {SUMMARY}", found, evaluation.get(name, 0 if found == 0 else None))

    def _compare_all(self, what: str, recorded: Mapping[str, Any], computed: Mapping[str, float]) -> None:
        for name in sorted(recorded.keys() & computed.keys()):
            self._compare(f"{name} of the {what}", recorded[name], computed[name])

    def _compare(self, what: str, recorded: Any, computed: Any) -> None:
        same = recorded == computed
        if not same and isinstance(recorded, int | float) and isinstance(computed, int | float):
            same = math.isclose(recorded, computed, rel_tol=RELATIVE_ERROR) and not isinstance(computed, int)
        if not same:
            self.findings.append(f"the {what} is {recorded!r}; it should be {computed!r}")
