"""The settings of a run: one frozen, typed tree, validated once.

Precedence, highest first: command line, environment (`RESKPN_TASK`, `RESKPN_ALGORITHM__GAMMA`), the YAML file
given by `--config`, the defaults below (which are the paper's Table 1 where it speaks).
`common.config.sources` reads those places; this module only says what is possible.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Self

from pydantic import field_validator, model_validator

from common.config.kinds import Count, Fraction, Names, Natural, NotNegative, Positive, Section, Seed, Staleness
from common.config.rkhs import RkhsSettings, impossibility
from common.learners import LEARNERS
from common.tasks import EPISODE_LENGTH, TASKS, unknown_name

PHYSICS = ("auto", "mjx", "native")


class AlgorithmSettings(Section):
    """Actor-critic networks and their objective (paper, Table 1; PureJaxRL where the paper is silent)."""

    objective: Literal["auto", "clip", "dpo"] = "auto"
    """what trains the policy's networks: PPO's clip, DPO's drift, or auto for the learner's own"""
    gamma: Fraction = 0.99
    """discount"""
    gae_lambda: Fraction = 0.95
    """lambda of generalised advantage estimation"""
    epochs: Count = 4
    """passes over a batch"""
    minibatches: Count = 32
    """minibatches a pass"""
    learning_rate: Positive = 3e-4
    """Adam's step size for the networks"""
    adam_eps: Positive = 1e-5
    """Adam's epsilon"""
    max_grad_norm: Positive = 0.5
    """global norm at which network gradients are clipped"""
    clip: Positive = 0.2
    """PPO's clip of the ratio and of the value's change"""
    value_coefficient: NotNegative = 0.5
    """weight of the value loss"""
    entropy_coefficient: NotNegative = 0.0
    """weight of the entropy bonus"""
    dpo_alpha: Positive = 2.0
    """DPO drift for positive advantages"""
    dpo_beta: Positive = 0.6
    """DPO drift for negative advantages"""
    hidden: tuple[Count, ...] = (256, 256)
    """widths of the tanh layers of features and critic; the last is the feature size d"""
    normalise_observations: bool = True
    """whiten observations by running mean and variance"""
    normalise_rewards: bool = True
    """divide rewards by the running standard deviation of the discounted return"""
    bootstrap_at_truncation: bool = False
    """value an episode cut by the time limit by the critic; false as in the paper"""

    @field_validator("hidden")
    @classmethod
    def _has_layers(cls, hidden: tuple[int, ...]) -> tuple[int, ...]:
        if not hidden:
            raise ValueError("needs at least one layer, for example [256, 256]")
        return hidden


class TransportSettings(Section):
    """Zenoh between learner and actors."""

    endpoint: str = "tcp/127.0.0.1:7447"
    """where the learner listens and actors connect"""
    router: bool = False
    """the endpoint is a Zenoh router's, to which the learner connects like the others"""
    insecure: bool = False
    """allow an endpoint beyond loopback without authentication"""
    certificates: Path | None = None
    """folder with ca.crt, tls.crt and tls.key, for tls/ endpoints; `reskpn certs` makes them"""
    users: Path | None = None
    """file of user:password lines: all whom the learner lets in, or first of all the one that an actor is"""
    actor_names: Names = ("actor",)
    """names, in certificates or of users, that may work for the run"""
    viewer_names: Names = ("viewer",)
    """names that may only watch it"""
    queue_bytes: Count = 256 << 20
    """rollouts waiting at the learner before actors are told to wait, in bytes"""
    max_message_bytes: Count = 256 << 20
    """largest message accepted"""
    push_timeout_s: Positive = 30.0
    """time an actor waits for the learner's answer before it asks again"""
    lease_s: Positive = 2.0
    """silence after which a peer counts as gone"""


class LogSettings(Section):
    """The MCAP log of the run."""

    segment_bytes: Count = 1 << 30
    """size at which a new file is begun"""
    compression: Literal["none", "lz4"] = "none"
    """chunk compression"""
    policy_every: Count = 10
    """versions between policies in the log"""
    checkpoint_every: Count = 50
    """versions between checkpoint files"""


class EvaluationSettings(Section):
    """The final evaluation with the deterministic policy."""

    episodes: Natural = 64
    """episodes at the end of the run; 0 for none"""


class RunSettings(Section):
    """All settings of one training run."""

    task: str = "inverted_pendulum"
    """environment to train on"""
    learner: str = "reskpn"
    """algorithm"""
    physics: str = "auto"
    """engine of the actors: mjx, native, or auto (mjx on an accelerator, native on a CPU)"""
    total_steps: Count = 2_200_000
    """environment steps; rounded down to whole updates"""
    actors: Count = 2
    """rollouts an update is made of, and the actor processes that `train` starts"""
    slot_wait_s: Positive | None = None
    """seconds until slots that nobody has held yet are left to others; default: never, so that a run can be repeated"""
    num_envs: Count = 2048
    """environments over all actors"""
    num_steps: Count = 10
    """steps each environment takes for one update"""
    seed: Seed = 0
    """seed of networks, environments and sampling"""
    mode: Literal["sync", "async"] = "sync"
    """sync: updates use rollouts of the newest policy only, bit for bit repeatable; async: actors work on meanwhile"""
    max_staleness: Staleness = 1
    """versions that a rollout may lie behind the policy that it updates; in mode sync none ever does"""
    run_dir: Path | None = None
    """where the run is kept; default: runs/<task>-<learner>-s<seed>-<time>"""
    episode_length: Count = EPISODE_LENGTH
    """steps after which an episode is truncated"""

    algorithm: AlgorithmSettings = AlgorithmSettings()
    rkhs: RkhsSettings = RkhsSettings()
    transport: TransportSettings = TransportSettings()
    log: LogSettings = LogSettings()
    evaluation: EvaluationSettings = EvaluationSettings()

    @field_validator("task")
    @classmethod
    def _known_task(cls, task: str) -> str:
        if task not in TASKS:
            raise ValueError(unknown_name("task", task, TASKS))
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
        """Refuse at start what no run could do, with the numbers."""
        batch, minibatches = self.batch_size, self.algorithm.minibatches
        if self.num_envs % self.actors:
            raise ValueError(
                f"num_envs ({self.num_envs}) must be a multiple of actors ({self.actors}): "
                f"each actor runs num_envs / actors environments; try num_envs {_round_to(self.num_envs, self.actors)}"
            )
        if batch % minibatches:
            # The nearest divisor is no further away than 1 is.
            divisors = [m for m in range(1, min(batch, 2 * minibatches) + 1) if batch % m == 0]
            near = min(divisors, key=lambda m: abs(m - minibatches))
            raise ValueError(
                f"a batch of {batch} transitions (num_envs {self.num_envs} x num_steps {self.num_steps}) cannot be "
                f"divided into {minibatches} minibatches; try algorithm.minibatches {near}"
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
        if (reason := impossibility(self.rkhs, batch, self.num_envs)) is not None:
            raise ValueError(reason)
        return self

    @property
    def batch_size(self) -> int:
        """Transitions of one update, B = N * T."""
        return self.num_envs * self.num_steps

    @property
    def staleness(self) -> int:
        """The bound on staleness that the mode makes of `max_staleness`."""
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
        """Environments whose last step of a rollout is made once more under the mirrored action; 0 for none."""
        return self.num_envs if LEARNERS[self.learner].rkhs and self.rkhs.estimate == "symmetric" else 0

    @property
    def capacity(self) -> int:
        """Centres, landmarks or features that h has room for; 0 where the learner has no h."""
        if not LEARNERS[self.learner].rkhs:
            return 0
        return self.rkhs.room(self.updates, self.samples, self.batch_size)


def _round_to(value: int, multiple: int) -> int:
    return max(1, round(value / multiple)) * multiple
