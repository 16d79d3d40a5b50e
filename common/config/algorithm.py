"""Settings of the actor-critic networks and of their objective."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from common.config.kinds import Count, Fraction, NotNegative, Positive, Section, Widths


class AlgorithmSettings(Section):
    """Actor-critic networks and their objective (paper, Table 1; PureJaxRL where the paper does not say)."""

    objective: Literal["auto", "clip", "dpo"] = "auto"
    """what trains the policy's networks: PPO's clip, DPO's drift, or auto for the learner's own"""
    gamma: Fraction = 0.99
    """discount factor"""
    gae_lambda: Fraction = 0.95
    """lambda of generalised advantage estimation"""
    epochs: Count = 4
    """passes over a batch in one update"""
    minibatches: Count = 32
    """minibatches of one pass, each of at least two transitions"""
    learning_rate: Positive = 3e-4
    """Adam's step size for the networks"""
    adam_eps: Positive = 1e-5
    """Adam's epsilon"""
    max_grad_norm: Positive = 0.5
    """global norm to which network gradients are clipped"""
    clip: Positive = 0.2
    """PPO's clip range of the probability ratio, and of the change of the value"""
    value_coefficient: NotNegative = 0.5
    """weight of the value loss"""
    entropy_coefficient: NotNegative = 0.0
    """weight of the entropy bonus"""
    max_log_std: Positive | None = None
    """bound on |log_std|, kept after every step of Adam; default: none"""
    dpo_alpha: Positive = 2.0
    """DPO drift for positive advantages"""
    dpo_beta: Positive = 0.6
    """DPO drift for negative advantages"""
    hidden: Widths = (256, 256)
    """widths of the tanh layers of the feature network and the critic; the last is the feature size d"""
    precision: Literal["float32", "bfloat16", "auto"] = "float32"
    """of the hidden layers' matrix products; auto: bfloat16 where the learner's device multiplies it faster"""
    devices: Count = 1
    """devices of the learner that share the work of every minibatch"""
    normalise_observations: bool = True
    """normalise observations by their running mean and variance"""
    normalise_rewards: bool = True
    """divide rewards by the running standard deviation of the discounted return"""
    bootstrap_at_truncation: bool = False
    """bootstrap from the critic where the time limit truncates an episode; the paper does not"""

    @field_validator("hidden")
    @classmethod
    def _has_layers(cls, hidden: tuple[int, ...]) -> tuple[int, ...]:
        if not hidden:
            raise ValueError("needs at least one layer, for example 256,256")
        return hidden
