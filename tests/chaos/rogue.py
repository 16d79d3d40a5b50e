"""An actor that works as it should, and beside some of its rollouts sends every wrong message that it can think of.

It holds its slot and knows its name, the run and the next number, so each message is wrong in one thing alone. What
became of them is left in a file, with the learner's own account.
"""

from __future__ import annotations

import dataclasses
import json
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import numpy as np

from common.wire.keys import JOIN, STATUS, Keys
from common.wire.messages import Environment, Evaluation, JoinReply, PushReply, digest_arrays
from common.wire.report import RunReport
from common.wire.rollout import Rollout

WRONG_FROM, WRONG_TO = 11, 15
"""Numbers of the rollouts beside which it misbehaves: environments are not asked for at these versions."""

ASK_S = 30.0


class Rogue:
    """Stands in the place of `ActorLink.push`."""

    def __init__(self, account: Path) -> None:
        self._account = account
        self._refused: dict[str, Counter[str]] = {
            "rollout": Counter(),
            "environment": Counter(),
            "evaluation": Counter(),
        }
        self._turned_away = 0
        self._repeated = 0
        self._before: bytes | None = None

    def push(self, push: Callable[..., bool], link: Any, rollout: Rollout, stop: Any) -> bool:
        keys, ask = link._keys, link._session.ask
        if not WRONG_FROM <= rollout.seq < WRONG_TO:
            if rollout.seq == WRONG_TO:
                self._settle(ask)
            self._before = rollout.encode()
            return push(link, rollout, stop)
        for reason, key, data in wrong_rollouts(keys, rollout):
            self._refuse("rollout", reason, ask(key, data, ASK_S))
        for kind, key, data in wrong_otherwise(keys, rollout):
            self._refuse(kind, "stale", ask(key, data, ASK_S))
        assert not JoinReply.decode(ask(JOIN, b"\x80", ASK_S)).accepted
        self._turned_away += 1
        # The answer to the rollout itself is lost on its way, so that the actor sends it again.
        data, key = rollout.encode(), keys.rollout(rollout.slot)
        self._accept(ask(key, data, ASK_S))
        taken = push(link, rollout, stop)
        self._repeated += 1
        for late in (data, data, self._before or data):  # once more, and the one before after it
            self._accept(ask(key, late, ASK_S))
            self._repeated += 1
        self._before = data
        return taken

    def _refuse(self, kind: str, reason: str, answer: bytes) -> None:
        reply = PushReply.decode(answer)
        assert (reply.status, reply.slug) == ("refused", reason), (kind, reason, reply)
        self._refused[kind][reason] += 1

    def _accept(self, answer: bytes) -> None:
        assert PushReply.decode(answer).status == "accepted"

    def _settle(self, ask: Callable[[str, bytes, float], bytes]) -> None:
        report = RunReport.decode(ask(STATUS, b"", ASK_S))
        mine = {"refused": self._refused, "turned_away": self._turned_away, "repeated": self._repeated}
        self._account.write_text(json.dumps({"sent": mine, "learner": report.model_dump(mode="json")}))


def wrong_rollouts(keys: Keys, good: Rollout) -> Iterator[tuple[str, str, bytes]]:
    """(reason to be refused by, key, message): all but the last two would be read as rollouts."""
    key, data = keys.rollout(good.slot), good.encode()

    def changed(**values: Any) -> bytes:
        return dataclasses.replace(good, **values).encode()

    unknown = good.obs.copy()
    unknown[0, 0, 0] = np.nan
    infinite = good.reward.copy()
    infinite[-1, -1] = np.inf
    yield "not_finite", key, changed(obs=unknown)
    yield "not_finite", key, changed(reward=infinite)
    yield "too_big", key, changed(reward=np.full_like(good.reward, 1e30))
    yield "bad_log_prob", key, changed(log_prob=np.full_like(good.log_prob, -1e6))
    yield "bad_shape", key, changed(obs=good.obs[:-1])
    yield "bad_shape", key, changed(last_obs=good.last_obs[:, :-1])
    always, cut = np.ones_like(good.terminated), np.zeros((good.terminated.size, good.obs.shape[-1]), np.float32)
    yield "bad_value", key, changed(terminated=always, truncated=always, truncated_obs=cut)
    yield "gap", key, changed(seq=good.seq + 1)
    yield "stale", key, changed(policy_version=good.policy_version - 1)
    yield "stale", key, changed(policy_version=good.policy_version + 1)
    yield "incarnation", key, changed(incarnation="somebody-else")
    yield "run", key, changed(run="another-run")
    yield "bad_key", keys.rollout(1 - good.slot), data
    yield "missing_field", key, msgpack.packb({"schema": msgpack.unpackb(data)["schema"]})
    yield "not_msgpack", key, data[: len(data) // 2]
    yield "not_msgpack", key, b"\xc1" + data[1:]
    yield "too_large", key, b"\xdd\x7f\xff\xff\xff" + data


def wrong_otherwise(keys: Keys, good: Rollout) -> Iterator[tuple[str, str, bytes]]:
    """(kind, key, message) that nobody has asked for."""
    run, slot, name = good.run, good.slot, good.incarnation
    version, nothing = good.policy_version, digest_arrays({})
    environment = Environment(run, slot, name, good.generation, good.seq, version, nothing, {})
    yield "environment", keys.environment(slot), environment.encode()
    evaluation = Evaluation(run, slot, name, version, np.ones(1, np.float32), np.ones(1, np.int32))
    yield "evaluation", keys.evaluation(slot), evaluation.encode()
