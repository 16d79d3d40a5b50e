"""The trajectories of a run's log, and the choice of one of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from common.errors import CodecError, LogReadError, SettingsError
from common.log.reader import LogReader
from common.printable import printable
from common.tasks import slug
from common.wire.divergence import Divergence
from common.wire.message import Message
from common.wire.motion import Motion, Motions

Kind = TypeVar("Kind", bound=Message)

SHOWN = 12
"""Versions or episodes that a sentence lists before it shortens."""


@dataclass(frozen=True, eq=False)
class Take:
    """One trajectory of a log.

    Attributes:
        version: of the policy.
        episode: number among the takes of its version, or among the diverged simulations of the run; from 0.
        source: as in `/eval`, or the place of a diverged simulation.
        step_s: simulated seconds per step.
    """

    version: int
    episode: int
    source: str
    step_s: float
    motion: Motion
    diverged: bool = False

    @property
    def seconds(self) -> float:
        """Simulated seconds from the first state to the last."""
        return (self.motion.steps - 1) * self.step_s

    @property
    def name(self) -> str:
        """The take in a few words."""
        if self.diverged:
            return f"divergence {self.episode}: policy {self.version}, {self.source}"
        return f"policy {self.version}, episode {self.episode} ({self.source})"


@dataclass(frozen=True, eq=False)
class Footage:
    """The trajectories of one run, and the model that they move.

    Attributes:
        mjcf: the model; `files`: by name, what it may refer to.
        evaluated: trajectories of evaluations by version; `diverged`: those of diverged simulations.
    """

    path: Path
    run: str
    task: str
    mjcf: str
    files: Mapping[str, bytes]
    evaluated: Sequence[Take]
    diverged: Sequence[Take]

    @property
    def versions(self) -> list[int]:
        """Versions of the policy that have trajectories, in order."""
        return sorted({take.version for take in self.evaluated})


def read_footage(path: Path) -> Footage:
    """Read the trajectories of a run.

    Raises:
        LogReadError: there is no log, it is damaged, or it has no model.
    """
    reader = LogReader(path)
    spec = next((message.json() for message in reader.messages(["/spec"])), None)
    if not isinstance(spec, dict) or not isinstance(settings := spec.get("settings"), dict):
        raise LogReadError(f"{path}: the log has no /spec with the settings of its run; give the log of a run")
    task = printable(str(settings.get("task", "")))
    files = {name: content for name, (_, content) in reader.attachments().items()}
    model = files.get(f"{slug(task)}.xml")
    if model is None:
        raise LogReadError(f"{path}: the log has no model of {task!r}, so that nothing of it can be shown")
    evaluated, diverged = _takes(reader)
    return Footage(path, printable(str(spec.get("run", ""))), task, model.decode(), files, evaluated, diverged)


def _takes(reader: LogReader) -> tuple[list[Take], list[Take]]:
    # A run that was killed at its end and resumed has its own evaluation twice; the later one counts.
    evaluations: dict[tuple[int, str], Motions] = {}
    divergences: list[Divergence] = []
    for message in reader.messages(["/motion", "/divergence"]):
        if message.topic == "/motion":
            motions = _decoded(Motions.decode, message.data, message.topic, message.sequence)
            evaluations[motions.version, motions.source] = motions
        else:
            divergences.append(_decoded(Divergence.decode, message.data, message.topic, message.sequence))
    evaluated: list[Take] = []
    # The run's own evaluation comes before those of evaluators.
    for (version, source), motions in sorted(evaluations.items(), key=lambda item: (item[0][0], item[0][1] != "run")):
        first = sum(take.version == version for take in evaluated)
        evaluated += [
            Take(version, first + number, printable(source), motions.step_s, motion)
            for number, motion in enumerate(motions.each())
        ]
    diverged = [
        Take(found.policy_version, number, _place(found), found.step_s, found.motion, diverged=True)
        for number, found in enumerate(divergences)
    ]
    return evaluated, diverged


def _place(found: Divergence) -> str:
    return f"step {found.step} of environment {found.env} in rollout {found.seq} of slot {found.slot}"


def _decoded(decode: Callable[[bytes], Kind], data: bytes, topic: str, sequence: int) -> Kind:
    try:
        return decode(data)
    except CodecError as error:
        raise LogReadError(f"message {sequence} of {topic} cannot be read: {error}") from None


def choose_version(footage: Footage, version: int | None) -> list[Take]:
    """The takes of a version of the policy; of the newest if None.

    Raises:
        LogReadError: the log has no trajectories.
        SettingsError: it has none of that version.
    """
    if not footage.evaluated:
        raise LogReadError(
            f"{footage.path}: the log has no trajectories; evaluations leave them there, unless "
            "evaluation.trajectories is 0 or the run is of an earlier release"
        )
    known = footage.versions
    if version is not None and version not in known:
        raise SettingsError(f"--version is {version}; the log has trajectories of {_listed(known)}")
    wanted = known[-1] if version is None else version
    return [take for take in footage.evaluated if take.version == wanted]


def choose(footage: Footage, *, version: int | None, episode: int, diverged: bool) -> Take:
    """One take: an episode of a version, or one of the diverged simulations.

    Raises:
        LogReadError, SettingsError: there is no such take.
    """
    takes = diverged_takes(footage, version) if diverged else choose_version(footage, version)
    if not 0 <= episode < len(takes):
        what = "diverged simulations" if diverged else f"trajectories of version {takes[0].version}"
        raise SettingsError(f"--episode is {episode}; the log has {len(takes)} {what}, counted from 0")
    return takes[episode]


def diverged_takes(footage: Footage, version: int | None = None) -> list[Take]:
    """The diverged simulations, of all versions if None; numbered anew.

    Raises:
        LogReadError: the log has none.
        SettingsError: it has none of that version.
    """
    if not footage.diverged:
        raise LogReadError(
            f"{footage.path}: the log has no diverged simulation; none diverged, log.divergences is 0, or the run is "
            "of an earlier release"
        )
    takes = [take for take in footage.diverged if version in (None, take.version)]
    if not takes:
        versions = sorted({take.version for take in footage.diverged})
        raise SettingsError(f"--version is {version}; simulations diverged under {_listed(versions)}")
    return [replace(take, episode=number) for number, take in enumerate(takes)]


def _listed(versions: Sequence[int]) -> str:
    shown: Iterator[str] = map(str, versions if len(versions) <= SHOWN else [*versions[: SHOWN - 1], versions[-1]])
    parts = list(shown)
    if len(versions) > SHOWN:
        parts.insert(-1, "...")
    return f"version{'s' if len(versions) > 1 else ''} {', '.join(parts)}"
