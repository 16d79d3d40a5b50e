"""Two thousand wrong messages at every door; tests/chaos has a hundred thousand."""

from __future__ import annotations

from pathlib import Path

from under_fire import HUB_KINDS, memory_growth, siege


def test_wrong_messages_do_no_harm(tmp_path: Path) -> None:
    """Each is answered and counted by its reason, good actors are served all the same, and memory stays flat."""
    with siege(tmp_path / "log", seed=1) as under, memory_growth() as growth:
        under.run(2_000)
        under.check()
        assert growth() < 64 << 20
    # The suite reaches every door, and is refused there for more than one reason.
    for kind in HUB_KINDS:
        assert under.refused[kind], kind
    assert len(under.refused["rollout"]) >= 10
    assert len(under.ways) == 18
