"""The learners by name: one table of switches, one update path (docs/method.md).

The paper's Algorithm 1 and its baselines differ only in these switches; no code is written per learner.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Objective = Literal["ppo", "dpo"]


@dataclass(frozen=True)
class Learner:
    """What a learner is made of.

    rkhs: the policy mean has the RKHS part h (paper, equation 5).
    objective: what trains the networks: PPO's clip (equation 4) or DPO's drift (section B.1).
    text: one line for `--help` and the docs.
    """

    name: str
    rkhs: bool
    objective: Objective
    text: str


LEARNERS: dict[str, Learner] = {
    learner.name: learner
    for learner in (
        Learner("reskpn", True, "ppo", "kernel expansion over learned features plus a residual layer (eq. 8, 9)"),
        Learner(
            "ppo",
            False,
            "ppo",
            "proximal policy optimisation, the same networks without the expansion (eq. 4)",
        ),
        Learner("dpo", False, "dpo", "discovered policy optimisation: PPO with a drift in place of the clip"),
    )
}
