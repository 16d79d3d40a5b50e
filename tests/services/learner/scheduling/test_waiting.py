"""What a run waits for, in words."""

from __future__ import annotations

import pytest
from samples import RUN, heartbeat, rollout

from services.learner.scheduling.fleet import Fleet


@pytest.fixture
def fleet() -> Fleet:
    """Two slots; slot 0 compiles and was heard of at 10 s, when it had done so for 4 s."""
    fleet = Fleet(RUN, 2)
    fleet.begin(0)
    fleet.join("a", "native", 0.0)
    fleet.record_heartbeat(heartbeat(0, "a", "compiling", state_s=4.0), 10.0)
    return fleet


def test_seconds_go_on_between_heartbeats(fleet: Fleet) -> None:
    """4 s at the heartbeat and 1 s since then."""
    assert fleet.waiting_for(11.0) == ("waiting for 2 of 2 rollouts: slot 0 compiling 5 s, slot 1 has no actor yet")


def test_an_actor_that_misses_heartbeats_is_silent(fleet: Fleet) -> None:
    """It beats twice a second: after more than 1.5 s without, somebody should look at it."""
    assert "silent" not in fleet.waiting_for(11.5)
    assert "slot 0 compiling 7 s (silent for 3 s)" in fleet.waiting_for(13.0)


def test_a_slow_disk_is_named(fleet: Fleet) -> None:
    """A rollout that was brought and is not in the log yet is not its actor's fault."""
    made = rollout(0, "a")
    assert fleet.admit(made) is None
    assert "waiting for 2 of 2 rollouts: slot 0 being written to the log" in fleet.waiting_for(11.0)
    fleet.accept(made)
    assert fleet.waiting_for(11.0) == "waiting for 1 of 2 rollouts: slot 1 has no actor yet"


def test_nothing_is_waited_for_when_all_is_there(fleet: Fleet) -> None:
    """Nor after the last version."""
    fleet.join("b", "native", 0.0)
    for slot, name in enumerate("ab"):
        made = rollout(slot, name)
        assert fleet.admit(made) is None
        fleet.accept(made)
    assert fleet.waiting_for(11.0) == ""
    fleet.begin(1, collect=False)
    assert fleet.waiting_for(11.0) == ""
