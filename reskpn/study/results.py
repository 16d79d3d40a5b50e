"""The result of one run: a small JSON file with its curve, scores, settings, versions and digest."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from common.config.kinds import Section
from common.config.settings import RunSettings
from common.errors import LogReadError, SettingsError
from common.learners import LEARNERS
from reskpn.study.curves import Curve, tail

FORMAT = 1

REVISIONS = {"networks": 1, "kernel": 1}
"""Revision of the update of learners without ("networks") and with ("kernel") a kernel part. Raise it when an update
gives other bits than before: results of an earlier revision then count as missing."""

UNRELATED = {"transport", "log", "run_dir", "slot_wait_s", "device_memory"}
"""Settings that do not change what a run learns."""

NO_EPISODE_ENDS = ("halfcheetah", "humanoidstandup", "pusher", "reacher")
"""Tasks without termination: every episode has the full length, so few end in a short run."""


class Scores(Section):
    """A run in single numbers.

    Attributes:
        last_tenth: mean return of the training episodes that ended in the last tenth of the updates.
        area: mean over all updates of the mean training return, the height of the learning curve.
        reward_last_tenth, reward_area: the same of the mean reward of a step, times the length of an episode.
        evaluation: mean return of the final policy without exploration.
        evaluation_std: standard deviation over its episodes.
    """

    last_tenth: float | None
    area: float | None
    reward_last_tenth: float
    reward_area: float
    evaluation: float | None
    evaluation_std: float | None


class Timing(Section):
    """Seconds of a run: `wall_s` and `cpu_s` (processor time of all threads) of its updates, and `seconds` by phase."""

    wall_s: float
    cpu_s: float | None
    env_steps_per_s: float
    seconds: dict[str, float]


class Result(Section):
    """One finished run.

    Attributes:
        identity: digest of what decides the run (`identity`).
        settings: all of `RunSettings` but those of `UNRELATED`.
        route: "in-process" or "service".
        spreads: quantiles 5, 25, 50, 75 and 95% of each observation and of the first features, over the last batch.
        digest: of the learner's final state.
    """

    format: int = FORMAT
    identity: str
    revision: int
    settings: dict[str, Any]
    route: str
    engine: str
    curve: dict[str, list[float | None]]
    scores: Scores
    spreads: dict[str, list[list[float]]]
    timing: Timing
    digest: str
    commit: str
    versions: dict[str, str]
    machine: dict[str, str]
    finished_at: str

    @property
    def task(self) -> str:
        return str(self.settings["task"])

    @property
    def learner(self) -> str:
        return str(self.settings["learner"])

    @property
    def seed(self) -> int:
        return int(self.settings["seed"])


def relevant(settings: RunSettings) -> dict[str, Any]:
    """The settings that decide what a run learns, as JSON values; none of absent kernel parts."""
    values = settings.model_dump(mode="json", exclude=UNRELATED)
    if not LEARNERS[settings.learner].rkhs:
        del values["rkhs"]
    if settings.critic.representation == "none":
        del values["critic"]
    if settings.algorithm.precision == "float32":
        del values["algorithm"]["precision"]  # as results from before there was a choice
    if settings.algorithm.devices == 1:
        del values["algorithm"]["devices"]
    return values


def revision(settings: RunSettings) -> int:
    """The revision of the update that these settings use."""
    kernel = LEARNERS[settings.learner].rkhs or settings.critic.representation != "none"
    return REVISIONS["kernel" if kernel else "networks"]


def identity(settings: RunSettings) -> str:
    """Hex digest of the settings that decide a run, and of the revision of its update."""
    text = json.dumps([relevant(settings), revision(settings)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def score(curve: Curve, episode_length: int, evaluation: Mapping[str, float] | None) -> Scores:
    """The scores of a finished run. `evaluation`: mean and std of its last evaluation."""
    late = slice(curve.updates - tail(curve.updates), None)
    returns, episodes = curve.returns_by_update(), sum(curve.episodes[late])
    rewards = curve.reward
    return Scores(
        last_tenth=sum(curve.return_sum[late]) / episodes if episodes else None,
        area=None if returns is None else float(returns.mean()),
        reward_last_tenth=episode_length * sum(rewards[late]) / len(rewards[late]),
        reward_area=episode_length * sum(rewards) / len(rewards),
        evaluation=None if evaluation is None else evaluation["mean"],
        evaluation_std=None if evaluation is None else evaluation["std"],
    )


def file_name(settings: RunSettings) -> Path:
    """Where a result lies within a folder of results."""
    return Path(settings.task) / f"{settings.learner}-s{settings.seed}-{identity(settings)[:10]}.json"


def read_result(path: Path) -> Result:
    """The result in a file.

    Raises:
        LogReadError: it cannot be read, or is no result of this format.
    """
    try:
        return Result.model_validate_json(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise LogReadError(f"{path} cannot be read ({error.strerror}); give the file of a result") from None
    except UnicodeDecodeError:
        raise LogReadError(f"{path} is not a text file; give the file of a result") from None
    except ValidationError as error:
        fault = error.errors(include_url=False, include_context=False)[0]
        where = ".".join(str(part) for part in fault["loc"])
        raise LogReadError(
            f"{path} is not a result of format {FORMAT} ({where + ': ' if where else ''}{fault['msg']}); "
            "move it away, and `reskpn paper run` makes it again"
        ) from None


def settings_of(result: Result) -> RunSettings:
    """The settings of a result, as this version has them; SettingsError where it does not know them."""
    try:
        return RunSettings.model_validate(result.settings)
    except ValidationError as error:
        fault = error.errors(include_url=False, include_context=False)[0]
        name = ".".join(str(part) for part in fault["loc"])
        raise SettingsError(
            f"a result of {result.learner} on {result.task} has a setting that this version does not know ({name}); "
            "read it with the version that wrote it, or move it away"
        ) from None
