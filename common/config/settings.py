"""The settings of a run: one frozen, typed tree, validated once.

Precedence, highest first: command line, environment (`RESKPN_TASK`, `RESKPN_ALGORITHM__GAMMA`), the YAML file
given by `--config`, the defaults below (those of the paper's Table 1, as far as it has them).
`common.config.sources` reads these sources; this module says what is possible.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from common.config import critic as critics
from common.config.algorithm import AlgorithmSettings
from common.config.critic import CriticSettings
from common.config.device_memory import DeviceMemorySettings
from common.config.kinds import (
    Count,
    Names,
    Port,
    Positive,
    Section,
    Seed,
    Staleness,
    Trackers,
)
from common.config.randomisation import NOT_RANDOMISED, RandomisationSettings
from common.config.records import EvaluationSettings, LogSettings
from common.config.rkhs import RkhsSettings, impossibility
from common.engine_names import PHYSICS
from common.learners import LEARNERS
from common.suggestions import unknown_name
from common.tasks import EPISODE_LENGTH, GYMNASIUM, Task, find_task, task_fault


class TransportSettings(Section):
    """Zenoh between learner and actors."""

    endpoint: str = "tcp/127.0.0.1:7447"
    """address on which the learner listens and to which actors connect: tcp/HOST:PORT or tls/HOST:PORT"""
    router: bool = False
    """the endpoint is that of a Zenoh router, to which the learner connects as well"""
    insecure: bool = False
    """allow an endpoint beyond loopback without authentication"""
    certificates: Path | None = None
    """directory with this process's certificate (made by `reskpn certs`); required for tls/ endpoints"""
    users: Path | None = None
    """file of user:password lines: at the learner all users that may connect, at an actor its own in the first line"""
    actor_names: Names = ("actor",)
    """names, of certificates or users, that may work for the run"""
    viewer_names: Names = ("viewer",)
    """names, of certificates or users, that may only watch the run"""
    queue_bytes: Count = 256 << 20
    """bytes of rollouts that may wait at the learner before actors are told to try later"""
    max_message_bytes: Count = 256 << 20
    """size of the largest message that is accepted, in bytes"""
    push_timeout_s: Positive = 30.0
    """seconds that an actor waits for the learner's answer before it repeats a request"""
    lease_s: Positive = 2.0
    """seconds of silence after which a peer counts as lost"""
    health_port: Port | None = None
    """port of the learner on 127.0.0.1 for health checks over plain HTTP; by default none"""


def _is_none(value: object) -> bool:
    return value is None


class RunSettings(Section):
    """All settings of one training run."""

    task_pin: str | None = Field(default=None, exclude_if=_is_none)
    """sizes and digest of a task of your own, found at start; processes with another version of it are refused"""
    task: str = "inverted_pendulum"
    """task to train on: a name that `reskpn tasks` lists, or module:Class"""
    learner: str = "reskpn"
    """learning algorithm"""
    physics: str = "auto"
    """physics engine of the actors: mjx, native, or auto (mjx on an accelerator, native on a CPU)"""
    total_steps: Count = 2_200_000
    """environment steps of the whole run; rounded down to whole updates"""
    actors: Count = 2
    """slots of the run: rollouts that make one update, and actor processes that `train` starts"""
    slot_wait_s: Positive | None = None
    """seconds after which a slot that no actor has taken yet is left to the other actors; by default never"""
    num_envs: Count = 2048
    """environments, over all actors"""
    num_steps: Count = 10
    """steps of each environment in one update"""
    seed: Seed = 0
    """random seed of networks, environments and sampling"""
    mode: Literal["sync", "async"] = "sync"
    """sync: updates use rollouts of the newest policy, and runs repeat bit for bit; async: actors go on collecting"""
    max_staleness: Staleness = 1
    """versions that a rollout's policy may lie behind the policy that it updates (mode async; in mode sync it is 0)"""
    run_dir: Path | None = None
    """directory of the run; by default runs/<task>-<learner>-s<seed>-<time>"""
    episode_length: Count = EPISODE_LENGTH
    """steps after which the time limit truncates an episode"""
    track: Trackers = ()
    """wandb, trackio or both: send the curves there, too; the packages are not installed with this one"""
    initial_states: Literal["fixed", "new"] = "fixed"
    """fixed: every environment starts all its episodes in the same state; new: each episode's state is drawn anew"""

    randomisation: RandomisationSettings = Field(default=NOT_RANDOMISED, exclude_if=RandomisationSettings.is_off)
    algorithm: AlgorithmSettings = AlgorithmSettings()
    rkhs: RkhsSettings = RkhsSettings()
    critic: CriticSettings = CriticSettings()
    transport: TransportSettings = TransportSettings()
    log: LogSettings = LogSettings()
    evaluation: EvaluationSettings = EvaluationSettings()
    device_memory: DeviceMemorySettings = DeviceMemorySettings()

    @model_validator(mode="before")
    @classmethod
    def _usual_length(cls, values: Any) -> Any:
        """Take the usual episode length of Gymnasium's tasks for the default."""
        task = GYMNASIUM.get(str(values.get("task"))) if isinstance(values, dict) else None
        return values if task is None else {"episode_length": task.episode_length, **values}

    @field_validator("task")
    @classmethod
    def _known_task(cls, task: str, info: ValidationInfo) -> str:
        if (fault := task_fault(task, info.data.get("task_pin"))) is not None:
            raise ValueError(fault)
        return task

    @field_validator("learner")
    @classmethod
    def _known_learner(cls, learner: str) -> str:
        if learner not in LEARNERS:
            raise ValueError(unknown_name("learner", learner, LEARNERS))
        return learner

    @field_validator("physics")
    @classmethod
    def _known_physics(cls, physics: str) -> str:
        if physics not in PHYSICS:
            raise ValueError(unknown_name("physics engine", physics, PHYSICS))
        return physics

    @model_validator(mode="after")
    def _possible(self) -> Self:
        """Refuse combinations that no run can have, with the numbers."""
        batch, minibatches = self.batch_size, self.algorithm.minibatches
        if self.num_envs % self.actors:
            raise ValueError(
                f"num_envs ({self.num_envs}) must be a multiple of actors ({self.actors}): "
                f"each actor runs num_envs / actors environments; try num_envs {_round_to(self.num_envs, self.actors)}"
            )
        if batch % minibatches:
            raise ValueError(
                f"a batch of {batch} transitions (num_envs {self.num_envs} x num_steps {self.num_steps}) cannot be "
                f"divided into {minibatches} minibatches; try algorithm.minibatches "
                f"{_nearest_divisor(batch, minibatches)}"
            )
        if batch // minibatches % self.algorithm.devices:
            raise ValueError(
                f"algorithm.devices ({self.algorithm.devices}) must divide a minibatch, of {batch // minibatches} "
                f"transitions (num_envs {self.num_envs} x num_steps {self.num_steps} over {minibatches} minibatches)"
            )
        if batch == minibatches:
            # Advantages are normalised within a minibatch: that of a single transition is 0, and teaches nothing.
            raise ValueError(
                f"algorithm.minibatches ({minibatches}) leaves one transition in each minibatch of a batch of {batch} "
                f"(num_envs {self.num_envs} x num_steps {self.num_steps}), whose normalised advantage is always 0; "
                f"try algorithm.minibatches {_nearest_divisor(batch, minibatches)}"
                + (", with more environments or steps" if batch == 1 else "")
            )
        if self.total_steps < batch:
            raise ValueError(
                f"total_steps ({self.total_steps}) is less than one update of {batch} transitions "
                f"(num_envs {self.num_envs} x num_steps {self.num_steps}); ask for more steps or fewer environments"
            )
        if self.num_steps > self.episode_length:
            raise ValueError(
                f"num_steps ({self.num_steps}) must not be longer than an episode ({self.episode_length} steps)"
            )
        reasons = (
            impossibility(self.rkhs, batch, self.num_envs),
            self._untrained_features(),
            critics.impossibility(self.critic, batch, self.num_envs),
        )
        if (reason := next(filter(None, reasons), None)) is not None:
            raise ValueError(reason)
        return self

    def _untrained_features(self) -> str | None:
        """The reason why nothing would train the learner's features; None where something does."""
        learner = LEARNERS[self.learner]
        if self.rkhs.feature_gradient or not learner.features or learner.residual != "none":
            return None
        return (
            f"rkhs.feature_gradient false leaves nothing that trains the features of {self.learner}, which has no "
            "residual layer; choose learner reskpn, or rkhs.feature_gradient true"
        )

    @property
    def sizes(self) -> Task:
        """The sizes of the task. SettingsError for a task of one's own that has not been read yet."""
        return find_task(self.task, self.task_pin)

    @property
    def batch_size(self) -> int:
        """Transitions of one update, B = N * T."""
        return self.num_envs * self.num_steps

    @property
    def staleness(self) -> int:
        """The largest staleness in this mode: `max_staleness` in mode async, else 0."""
        return self.max_staleness if self.mode == "async" else 0

    @property
    def updates(self) -> int:
        """Updates of the run."""
        return self.total_steps // self.batch_size

    @property
    def envs_per_actor(self) -> int:
        return self.num_envs // self.actors

    @property
    def samples(self) -> int:
        """Transitions of one functional gradient, n, or pairs of them."""
        if self.rkhs.samples != "batch":
            return self.rkhs.samples
        return self.branches or self.batch_size

    @property
    def branches(self) -> int:
        """Environments whose last step of a rollout is repeated under the mirrored action; 0 for none."""
        return self.num_envs if LEARNERS[self.learner].rkhs and self.rkhs.estimate == "symmetric" else 0

    @property
    def capacity(self) -> int:
        """Centres, landmarks or features that h has room for; 0 where the learner has no h."""
        if not LEARNERS[self.learner].rkhs:
            return 0
        return self.rkhs.room(self.updates, self.samples, self.batch_size)


def _nearest_divisor(batch: int, minibatches: int) -> int:
    """The number of minibatches nearest to the given one that divides the batch into parts of two or more."""
    # The nearest divisor is no further away than 1 is.
    divisors = [m for m in range(1, min(batch // 2, 2 * minibatches) + 1) if batch % m == 0] or [1]
    return min(divisors, key=lambda m: abs(m - minibatches))


def _round_to(value: int, multiple: int) -> int:
    return max(1, round(value / multiple)) * multiple
