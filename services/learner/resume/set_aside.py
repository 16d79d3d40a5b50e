"""A logged batch that no update can be made of is set aside, so that a run can go on without it."""

from __future__ import annotations

from typing import Any

from common.errors import SettingsError
from common.wire.rollout import Rollout
from services.learner.resume.logged_run import LoggedRun


def next_batch(logged: LoggedRun) -> list[Rollout]:
    """The logged rollouts that the update after the last one would be made of.

    Raises:
        SettingsError: the log does not have all of them.
    """
    settings = logged.settings
    batch = logged.unused[: settings.actors]
    if settings.mode == "sync":
        batch = [rollout for rollout in logged.unused if rollout.policy_version == logged.last]
    if len(batch) < settings.actors:
        raise SettingsError(
            f"--skip-batch: the log in {logged.run_dir} has {len(batch)} of {settings.actors} rollouts for the update "
            f"after {logged.last}: there is no complete batch to skip; resume the run without --skip-batch"
        )
    return batch


def set_aside_record(version: int, batch: list[Rollout]) -> dict[str, Any]:
    """The `/set_aside` message of a batch that would have updated that version."""
    return {
        "version": version,
        "rollouts": [
            {
                "slot": rollout.slot,
                "incarnation": rollout.incarnation,
                "generation": rollout.generation,
                "seq": rollout.seq,
                "policy_version": rollout.policy_version,
            }
            for rollout in batch
        ],
        "reason": "--skip-batch",
    }
