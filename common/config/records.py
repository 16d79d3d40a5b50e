"""The settings of what a run records: its log and its evaluations."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from common.config.kinds import Count, Kept, Natural, Section


class LogSettings(Section):
    """The MCAP log of the run."""

    segment_bytes: Count = 1 << 30
    """size in bytes at which the log continues in a new file"""
    compression: Literal["none", "lz4"] = "none"
    """compression of the log's chunks"""
    policy_every: Count = 10
    """number of versions from one logged policy to the next"""
    checkpoint_every: Count = 50
    """number of versions from one checkpoint to the next"""
    keep: Kept = "everything"
    """segments that are kept: everything, or what the newest K checkpoints need (K: a number; 2 or more is safer)"""
    signing_key: Path | None = None
    """PEM file with the Ed25519 private key that signs the chain of the log; default: no signatures"""
    divergences: Natural = 20
    """simulations that diverged of which the log keeps the last steps; 0: none"""


class EvaluationSettings(Section):
    """The final evaluation with the deterministic policy, and the trajectories of all evaluations."""

    episodes: Natural = 64
    """episodes of the final evaluation; 0: none"""
    trajectories: Natural = 1
    """episodes of each evaluation, also of evaluators, whose trajectories are logged for `reskpn view`; 0: none"""
    trajectory_records: Natural = 256
    """evaluations of evaluators in one run whose trajectories are logged, each with up to 768 KiB; 0: none"""
