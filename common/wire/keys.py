"""Every Zenoh key expression of the service.

reskpn/v1/join                          asked by a process that knows only the learner's address
reskpn/v1/status                        asked by whoever watches: the run and its actors at this moment
reskpn/v1/<run>/rollout/<slot>          query push of rollouts
               /evaluation/<slot>       query push of evaluations
               /environment/<slot>      query push of environment states; asked with nothing, the one to go on from
               /assessment/<id>         query push of what an evaluator found
               /divergence/<slot>       query push of the steps before a simulation diverged
               /policy/notify           what the learner wants now, and the newest version
               /policy/latest           the newest snapshot, asked for
               /heartbeat/<slot>
               /status                  how far the run is, put for dashboards
               /alive/<role>/<id>       liveliness tokens
               /metrics                 the record of every update, for dashboards
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from common.errors import CodecError, SettingsError

ROOT = "reskpn/v1"
JOIN = f"{ROOT}/join"
STATUS = f"{ROOT}/status"

RUN_ID = re.compile(r"[a-z0-9][a-z0-9_.-]{0,79}")
"""What a run may be called: one chunk of a key, so no slash and none of Zenoh's `* $ ? # @`."""

_ALIVE = re.compile(rf"{ROOT}/{RUN_ID.pattern}/alive/(?P<role>{RUN_ID.pattern})/(?P<id>{RUN_ID.pattern})")


@dataclass(frozen=True)
class Keys:
    """The keys of one run.

    Raises `SettingsError` for a run, role or id that cannot be one chunk of a key.
    """

    run: str

    def __post_init__(self) -> None:
        _chunk("run id", self.run)

    @property
    def _base(self) -> str:
        return f"{ROOT}/{self.run}"

    def rollout(self, slot: int) -> str:
        return f"{self._base}/rollout/{_slot(slot)}"

    def evaluation(self, slot: int) -> str:
        return f"{self._base}/evaluation/{_slot(slot)}"

    def environment(self, slot: int) -> str:
        return f"{self._base}/environment/{_slot(slot)}"

    def assessment(self, identity: str) -> str:
        return f"{self._base}/assessment/{_chunk('id', identity)}"

    def divergence(self, slot: int) -> str:
        return f"{self._base}/divergence/{_slot(slot)}"

    def heartbeat(self, slot: int) -> str:
        return f"{self._base}/heartbeat/{_slot(slot)}"

    def alive(self, role: str, identity: str) -> str:
        return f"{self._base}/alive/{_chunk('role', role)}/{_chunk('id', identity)}"

    @property
    def rollouts(self) -> str:
        """Wildcard: `rollout` of every slot."""
        return f"{self._base}/rollout/*"

    @property
    def evaluations(self) -> str:
        """Wildcard: `evaluation` of every slot."""
        return f"{self._base}/evaluation/*"

    @property
    def environments(self) -> str:
        """Wildcard: `environment` of every slot."""
        return f"{self._base}/environment/*"

    @property
    def assessments(self) -> str:
        """Wildcard: `assessment` of every id."""
        return f"{self._base}/assessment/*"

    @property
    def divergences(self) -> str:
        """Wildcard: `divergence` of every slot."""
        return f"{self._base}/divergence/*"

    @property
    def heartbeats(self) -> str:
        """Wildcard: `heartbeat` of every slot."""
        return f"{self._base}/heartbeat/*"

    @property
    def all_alive(self) -> str:
        """Wildcard: `alive` of every role and id."""
        return f"{self._base}/alive/*/*"

    @property
    def policy_notify(self) -> str:
        return f"{self._base}/policy/notify"

    @property
    def policy_latest(self) -> str:
        return f"{self._base}/policy/latest"

    @property
    def status(self) -> str:
        return f"{self._base}/status"

    @property
    def metrics(self) -> str:
        return f"{self._base}/metrics"


def parse_alive(key: str) -> tuple[str, str]:
    """The (role, id) of a liveliness key; `CodecError("bad_key")` for any other key."""
    match = _ALIVE.fullmatch(key)
    if match is None:
        raise CodecError("bad_key", f"{key!r} is not a liveliness key: expected {ROOT}/<run>/alive/<role>/<id>")
    return match["role"], match["id"]


def _chunk(kind: str, text: str) -> str:
    if not RUN_ID.fullmatch(text):
        raise SettingsError(
            f"{text!r} cannot be a {kind}: use 1 to 80 of a-z, 0-9, '_', '.' and '-', starting with a letter or digit"
        )
    return text


def _slot(slot: int) -> int:
    if slot < 0:
        raise SettingsError(f"{slot} cannot be a slot: slots count from 0")
    return slot
