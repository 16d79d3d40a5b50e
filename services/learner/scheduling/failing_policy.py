"""Evidence that nobody can act by a published policy: actor after actor makes rollouts that are not finite."""

from __future__ import annotations

from common.wire.rollout import Rollout

ENOUGH_ACTORS = 3
"""Actors that fail with the same version before the policy is held responsible, and not their machines."""

NOT_USABLE = ("not_finite", "too_big")
"""Slugs of the refusals that count: the rollout is well-formed, and its numbers cannot be used."""


class FailingPolicy:
    """Counts the actors that failed with the newest version, until one succeeds with it."""

    def __init__(self) -> None:
        self._version = 0
        self._failed: set[str] = set()
        self._works = False

    def refused(self, slug: str, rollout: Rollout, version: int) -> None:
        """Take in a refusal of a rollout of an actor that holds its slot; `version` is the newest."""
        self._begin(version)
        if slug in NOT_USABLE and rollout.policy_version == version:
            self._failed.add(rollout.incarnation)

    def accepted(self, rollout: Rollout, version: int) -> None:
        """Take in a rollout that was accepted: a version that one actor can act by is not to blame."""
        self._begin(version)
        self._works |= rollout.policy_version == version

    @property
    def problem(self) -> str | None:
        """The reason why the version is of no use; None while there is not enough evidence."""
        if self._works or len(self._failed) < ENOUGH_ACTORS:
            return None
        return (
            f"{len(self._failed)} actors in succession made rollouts with policy {self._version} whose numbers are not "
            "finite or too large, and none made a usable one"
        )

    def _begin(self, version: int) -> None:
        if version != self._version:
            self._version, self._works = version, False
            self._failed.clear()
