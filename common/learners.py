"""The learners by name: one table of switches, one update path (docs/method.md).

The paper's Algorithm 1, its ablations and its baselines differ only in these switches; no code is written per learner.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Objective = Literal["ppo", "dpo", "none"]
Residual = Literal["none", "head", "two heads"]
Target = Literal["A", "Q"]


@dataclass(frozen=True)
class Learner:
    """The switches of a learner.

    features: h and the residual layer see learned features psi(o); without them h sees the whitened observation.
    rkhs: the policy mean has the RKHS part h (paper, equation 5).
    residual: fully connected layers beside h; "two heads" are summed (section D.3).
    target: what weighs the functional gradient: the lambda-return A + V (equation 6) or the normalised advantage
        (equation 7). Without h it has no effect.
    objective: what trains the policy's networks: PPO's clip (equation 4), DPO's drift (section B.1), or nothing: then
        the clip trains log_std alone.
    text: one line for `--help` and the docs.
    """

    name: str
    features: bool
    rkhs: bool
    residual: Residual
    target: Target
    objective: Objective
    text: str


LEARNERS: dict[str, Learner] = {
    learner.name: learner
    for learner in (
        Learner("origin-kernel", False, True, "none", "Q", "none", "kernel expansion over observations (eq. 2, 3)"),
        Learner("kpn", True, True, "none", "Q", "ppo", "kernel expansion over learned features (eq. 5, 6)"),
        Learner("advkpn", True, True, "none", "A", "ppo", "kpn with advantages in the functional gradient (eq. 7)"),
        Learner("reskpn", True, True, "head", "A", "ppo", "advkpn plus a residual layer (eq. 8, 9)"),
        Learner("ppo", True, False, "head", "A", "ppo", "proximal policy optimisation: reskpn without h (eq. 4)"),
        Learner("dpo", True, False, "head", "A", "dpo", "discovered policy optimisation: ppo with a drift (sec. B.1)"),
        Learner("ppo-res", True, False, "two heads", "A", "ppo", "ppo with a second, residual head (sec. D.3)"),
        Learner("dpo-res", True, False, "two heads", "A", "dpo", "dpo with a second, residual head (sec. D.3)"),
    )
}
