"""The entrants: the command that starts each, what decides its run, and how its progress is read.

All have Gymnasium's tasks in version 5: this project's own `hopper-v5`, `Hopper-v5` of the peers. Every entrant starts
without compiled programs of earlier runs.
"""

from __future__ import annotations

import hashlib
import json
import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

from pydantic import ValidationError

from benchmarks.peers import environment
from benchmarks.race.wall import Report, parse_reports
from common.config.settings import RunSettings
from common.config.sources import PRESETS, load
from common.errors import LogReadError, SettingsError
from common.log.reader import LogReader
from common.runs.directory import SETTINGS
from common.runtime import software_versions
from common.suggestions import unknown_name
from common.tasks import GYMNASIUM
from reskpn.study.results import relevant, revision

REVISION = 1
"""Of the race. Raise it when the same settings are measured in another way: results from before count as missing."""

NEVER = 10**9
"""Environment steps of a run of our own, which is stopped before."""

ENVIRONMENTS = {
    "ant": "Ant-v5",
    "halfcheetah": "HalfCheetah-v5",
    "hopper": "Hopper-v5",
    "humanoid": "Humanoid-v5",
    "humanoidstandup": "HumanoidStandup-v5",
    "inverteddoublependulum": "InvertedDoublePendulum-v5",
    "invertedpendulum": "InvertedPendulum-v5",
    "pusher": "Pusher-v5",
    "reacher": "Reacher-v5",
    "swimmer": "Swimmer-v5",
    "walker2d": "Walker2d-v5",
}
"""Gymnasium's name of each task of the race; ours is this one in lower case."""


@dataclass(frozen=True)
class Run:
    """One run of an entrant. `folder` is a new, empty one for its files."""

    task: str
    seed: int
    folder: Path

    @property
    def own_task(self) -> str:
        return ENVIRONMENTS[self.task].lower()


class Entrant(ABC):
    """Somebody who trains on a task.

    Attributes:
        name: the name in files and tables; `what`: the note that says more.
        given: the name on the command line.
    """

    name: str
    what: str

    @property
    def given(self) -> str:
        return self.name

    @abstractmethod
    def command(self, run: Run) -> list[str]:
        """The words that start it. ProcessError where it is not installed."""

    @abstractmethod
    def decided_by(self, task: str) -> Mapping[str, Any]:
        """What decides a run besides task, seed and time, as JSON values."""

    def progress(self, run: Run, output: list[str], launched_s: float) -> tuple[dict[str, Any], list[Report]]:
        """Settings and versions ("settings", "versions"), and all reports, of a run that was stopped."""
        return parse_reports(output, launched_s)

    def identity(self, task: str) -> str:
        """Hex digest of what decides a run besides its seed and time."""
        text = json.dumps([REVISION, self.name, task, self.decided_by(task)], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:10]


class Own(Entrant):
    """`reskpn train --config NAME`, NAME being a preset or a file of settings."""

    def __init__(self, config: str) -> None:
        self._config = config
        self.name = Path(config).stem
        self.what = f"{self.name}: `reskpn train --config {config}`, learner and actors as processes, everything logged"

    @property
    def given(self) -> str:
        return self._config

    def command(self, run: Run) -> list[str]:
        options = ["--config", self._config, "--task", run.own_task, "--seed", str(run.seed)]
        options += ["--episode-length", str(GYMNASIUM[run.own_task].episode_length), "--initial-states", "new"]
        options += ["--total-steps", str(NEVER), "--evaluation.episodes", "0"]
        return [sys.executable, "-m", "reskpn", "train", *options, "--run-dir", str(run.folder / "run")]

    def settings(self, task: str) -> RunSettings:
        """The settings of its runs on a task, with seed 0. SettingsError where they are not possible."""
        own_task = ENVIRONMENTS[task].lower()
        tree = load(config=self._config, environment={}).model_dump(mode="json")
        tree["evaluation"]["episodes"] = 0
        tree |= {
            "task": own_task,
            "seed": 0,
            "episode_length": GYMNASIUM[own_task].episode_length,
            "initial_states": "new",
            "total_steps": NEVER,
        }
        try:
            return RunSettings.model_validate(tree)
        except ValidationError as error:
            text = error.errors(include_url=False)[0]["msg"].removeprefix("Value error, ")
            raise SettingsError(f"{self._config} cannot run on {task}: {text}; leave one of them out") from None

    def decided_by(self, task: str) -> Mapping[str, Any]:
        settings = self.settings(task)
        return relevant(settings) | {"revision": revision(settings)}

    def progress(self, run: Run, output: list[str], launched_s: float) -> tuple[dict[str, Any], list[Report]]:
        folder = run.folder / "run"
        if not (folder / SETTINGS).exists():
            raise LogReadError(
                f"{self.name} did not get as far as its settings in the time it had; give it more minutes"
            )
        settings = RunSettings.model_validate_json((folder / SETTINGS).read_text(encoding="utf-8"))
        about = {"settings": relevant(settings), "versions": software_versions()}
        return about, list(_from_log(folder, launched_s))


class Reference(Entrant):
    """PureJaxRL's PPO, as this project's independent reference has it."""

    name = "reference"
    what = (
        "reference: `benchmarks.reference`, an independent PPO in one file after PureJaxRL, with PureJaxRL's sizes for "
        "MuJoCo tasks, on this project's engine in place of brax's"
    )

    def command(self, run: Run) -> list[str]:
        words = ["-m", "benchmarks.race.reference", "--task", run.own_task, "--seed", str(run.seed)]
        return [sys.executable, *words]

    def decided_by(self, task: str) -> Mapping[str, Any]:
        from benchmarks.race.reference import recipe  # with JAX and brax, which take seconds to load

        return asdict(recipe(ENVIRONMENTS[task].lower()))


class StableBaselines(Entrant):
    """PPO of Stable-Baselines3 or SBX, in the peers' environment."""

    packages: ClassVar[dict[str, tuple[str, ...]]] = {
        "sb3": ("stable-baselines3", "torch", "gymnasium", "mujoco", "rl-zoo3"),
        "sbx": ("sbx-rl", "stable-baselines3", "jax", "gymnasium", "mujoco", "rl-zoo3"),
    }
    labels: ClassVar[dict[str, str]] = {"sb3": "Stable-Baselines3", "sbx": "SBX"}

    def __init__(self, name: str) -> None:
        self.name = name
        self.what = f"{name}: PPO of {self.labels[name]} with the settings of RL Baselines3 Zoo for the task"

    def command(self, run: Run) -> list[str]:
        words = ["-W", "ignore", "-m", "benchmarks.peers.stable_baselines", "--library", self.name]
        words += ["--environment", ENVIRONMENTS[run.task], "--seed", str(run.seed)]
        return [str(environment.python()), *words]

    def decided_by(self, task: str) -> Mapping[str, Any]:
        return environment.pins(*self.packages[self.name])


class RslRl(Entrant):
    """PPO of rsl_rl on this project's environments, in the peers' environment."""

    name = "rsl_rl"
    what = "rsl_rl: its PPO on this project's environments, sizes of Isaac Lab's ant (4,096 environments, 32 steps)"

    def command(self, run: Run) -> list[str]:
        words = ["-W", "ignore", "-m", "benchmarks.peers.rsl", "--task", run.own_task, "--seed", str(run.seed)]
        return [str(environment.python()), *words]

    def decided_by(self, task: str) -> Mapping[str, Any]:
        return environment.pins("rsl-rl-lib", "torch", "jax", "mujoco")


class Brax(Entrant):
    """PPO of brax on MJX, with brax's own task of that name."""

    name = "brax"
    what = "brax: its PPO on MJX, on brax's own task, sizes of the paper's Table 1 (2,048 environments, 10 steps)"
    tasks: ClassVar[dict[str, str]] = {
        "inverteddoublependulum": "inverted_double_pendulum",
        "invertedpendulum": "inverted_pendulum",
    }

    def command(self, run: Run) -> list[str]:
        task = self.tasks.get(run.task, run.task)
        words = ["-W", "ignore", "-m", "benchmarks.peers.brax_ppo", "--task", task, "--seed", str(run.seed)]
        return [sys.executable, *words]

    def decided_by(self, task: str) -> Mapping[str, Any]:
        return environment.pins("brax", "jax", "mujoco-mjx")


OTHERS: dict[str, Entrant] = {
    each.name: each for each in (StableBaselines("sb3"), StableBaselines("sbx"), Reference(), RslRl(), Brax())
}
"""The entrants that are not of this project, by name."""


def entrant(name: str) -> Entrant:
    """The entrant of a name: a preset, a file of settings, or one of `OTHERS`. SettingsError where there is none."""
    if name in OTHERS:
        return OTHERS[name]
    if name in PRESETS or (name.endswith((".yaml", ".yml")) and Path(name).exists()):
        return Own(name)
    names = unknown_name("known entrant", name, [*PRESETS, *OTHERS])
    raise SettingsError(f"{names}, or a .yaml file of settings that exists")


def known_task(name: str) -> str:
    """The name, if it is a task of the race; else SettingsError."""
    if name not in ENVIRONMENTS:
        raise SettingsError(unknown_name("task of the race", name, ENVIRONMENTS))
    return name


def _from_log(folder: Path, launched_s: float) -> list[Report]:
    """One report an update of a recorded run, by the time at which the learner had made it."""
    ended: dict[int, tuple[int, float]] = {}
    reports = []
    for message in LogReader(folder).messages(["/update", "/episode"]):
        record = message.json()
        if message.topic == "/episode":
            ended[record["version"]] = record["count"], record["count"] * record["return_mean"]
            continue
        count, total = ended.pop(record["version"], (0, 0.0))
        reports.append(Report((message.t_ns - round(launched_s * 1e9)) / 1e9, record["env_steps"], count, total))
    return reports
