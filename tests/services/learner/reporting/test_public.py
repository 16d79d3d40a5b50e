"""What of the learner's records others may see."""

from __future__ import annotations

from services.learner.reporting.public import public_update


def test_published_updates_do_not_open_slots() -> None:
    """Incarnations are shortened in what is published; the record itself, which the log gets, is left as it is."""
    secret = "0123456789abcdef" * 2
    record = {"version": 3, "rollouts": [{"slot": 0, "incarnation": secret, "seq": 7}]}
    assert public_update(record) == {"version": 3, "rollouts": [{"slot": 0, "incarnation": "01234567", "seq": 7}]}
    assert record["rollouts"] == [{"slot": 0, "incarnation": secret, "seq": 7}]
