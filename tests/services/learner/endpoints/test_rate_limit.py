"""The token bucket."""

from __future__ import annotations

from services.learner.endpoints.rate_limit import RateLimit


def test_a_burst_and_then_the_rate() -> None:
    """10 at once, 2 a second: after 10, nothing; after 1.5 s, 3; never more than 10."""
    clock = [0.0]
    limit = RateLimit(10, 2, lambda: clock[0])
    assert limit.take(10)
    assert not limit.take(1)
    clock[0] = 1.5
    assert limit.take(3)
    assert not limit.take(0.5)
    clock[0] = 1000.0
    assert not limit.take(11)
    assert limit.take(10)
