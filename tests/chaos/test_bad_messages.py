"""Wrong, repeated and lost messages in a real run: it ends in the state in which it ends without them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from common.errors import SessionError
from common.wire.keys import Keys
from common.wire.session import open_session
from tests.chaos.interruptions import OPTIONS, UPDATES, Apart, Processes, audited
from tests.chaos.rogue import WRONG_FROM, WRONG_TO

pytestmark = pytest.mark.timeout(400)

AGREED_BYTES = 1_000_000


def test_a_rogue_actor_and_a_bad_line(
    started: Processes, tmp_path: Path, undisturbed: list[str], found: Callable[[str], None]
) -> None:
    """Duplicate, late, corrupt, oversized and wrong-shape messages, NaN observations, lost answers and orders: counted
    by reason, and the run ends in the state in which it ends without them."""
    run_dir, account = tmp_path / "run", tmp_path / "account.json"
    apart = Apart(
        started,
        run_dir,
        [*OPTIONS, "--transport.max-message-bytes", AGREED_BYTES],
        # One slot's actor lies, the other does not hear every order.
        actor_faults=([f"rogue {account}"], ["drop 6 services.actor.link:ActorLink._on_orders"]),
    )
    send_too_much(apart)
    apart.end()
    assert audited(run_dir, UPDATES) == undisturbed
    told = json.loads(account.read_text())
    sent, learner = told["sent"], told["learner"]
    wrong = WRONG_TO - WRONG_FROM
    assert sent["refused"]["rollout"] == {
        reason: times * wrong
        for reason, times in {
            "not_finite": 2,
            "too_big": 1,
            "bad_log_prob": 1,
            "bad_shape": 2,
            "bad_value": 1,
            "gap": 1,
            "stale": 2,
            "incarnation": 1,
            "run": 1,
            "bad_key": 1,
            "missing_field": 1,
            "not_msgpack": 2,
            "too_large": 1,
        }.items()
    }
    counted = {kind: learner["refusals"][kind] for kind in sent["refused"]}
    assert counted == sent["refused"]
    assert learner["turned_away"] == {"malformed": wrong}
    assert learner["totals"]["repeated"] == sent["repeated"] == 4 * wrong
    assert learner["totals"]["lost"] == 0
    refused = sum(sum(reasons.values()) for reasons in counted.values())
    found(
        f"{refused} wrong messages refused, each counted by one of {len(counted['rollout'])} reasons; "
        f"{sent['repeated']} repeats, none used; {UPDATES} of {UPDATES} digests equal"
    )


def send_too_much(apart: Apart) -> None:
    """From a stranger whose own limit is higher: the learner does not take it in, and stays."""
    run = apart.report_once(lambda report: True).run
    with (
        open_session(connect=[apart.endpoint], connect_timeout_s=10.0, max_message_size=10 * AGREED_BYTES) as stranger,
        pytest.raises(SessionError, match=r"refuses messages as large as 2,000,000 bytes|nobody connected"),
    ):
        stranger.ask(Keys(run).rollout(0), bytes(2 * AGREED_BYTES), 2.0)
    assert apart.learner.ended() is None, apart.learner.printed()
