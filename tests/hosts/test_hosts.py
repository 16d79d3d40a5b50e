"""One run over several hosts, which are network namespaces of this machine: one story, told in order.

`make test-hosts`; skipped, with the reason, where there is no root or no iproute2.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from network import CannotBuild, Network
from run_on_hosts import DEADLINE_S, RunOnHosts

from reskpn.authority import make_all

PARTITION_S = 10.0
LEASE_S = 2.0
SLOW_BITS_PER_S = 200_000


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunOnHosts]:
    """With certificates and access control."""
    try:
        with Network(["learner", "actor-0", "actor-1", "viewer", "outsider"]) as network:
            folder = tmp_path_factory.mktemp("hosts")
            with RunOnHosts(network, folder) as made:
                yield made
    except CannotBuild as error:
        pytest.skip(f"no hosts can be made here: {error}")


def test_actors_on_other_hosts_work(run: RunOnHosts) -> None:
    """With nothing but the learner's address and their certificates."""
    report = run.report(lambda told: min([actor["accepted"] for actor in told["actors"]], default=0) > 3, "both work")
    assert len(report["actors"]) == 2
    assert report["totals"]["lost"] == 0


def test_an_outsider_is_refused(run: RunOnHosts, tmp_path: Path) -> None:
    """A host with certificates of another run is told what is wrong, and counted."""
    make_all(tmp_path / "foreign", [run.network.address("learner")], days=1)
    credentials = ["--certificates", str(tmp_path / "foreign" / "actor"), "--connect-timeout", "2"]
    outsider = run.start("outsider", "outsider", ["actor", "--endpoint", run.endpoint, *credentials])
    assert outsider.wait(DEADLINE_S) == 3
    assert "the certificate that the learner shows was not accepted here" in run.words("outsider").read_text()
    del run.processes["outsider"]
    run.report(lambda told: told["refusals"].get("connection", {}).get("untrusted", 0) > 0, "the outsider is counted")


def test_a_slow_link(run: RunOnHosts) -> None:
    """The run keeps its actor, and goes on at the pace of the link."""
    run.network.slow("actor-1", f"{SLOW_BITS_PER_S}bit")
    first = run.report(lambda told: True, "a report")["progress"]["version"]
    # What was under way is over by then.
    before = run.report(lambda told: told["progress"]["version"] > first + 2, "updates")
    after = run.report(lambda told: told["progress"]["version"] > before["progress"]["version"] + 10, "more of them")
    pace = (after["progress"]["version"] - before["progress"]["version"]) / (after["up_s"] - before["up_s"])
    print(f"slow link: {pace:.2f} updates/s at {SLOW_BITS_PER_S:,} bit/s")
    # A rollout's observations alone, 32 environments x 8 steps x 4 float32, have to pass for every update.
    assert pace < SLOW_BITS_PER_S / (8 * 32 * 8 * 4 * 4)
    assert {actor["slot"]: actor["generation"] for actor in after["actors"]} == {0: 0, 1: 0}
    assert after["totals"]["lost"] == 0
    run.network.slow("actor-1", "1gbit")


def test_a_partition_heals(run: RunOnHosts) -> None:
    """The run goes on without the actor, which joins again by itself when the link is back; no process is restarted."""
    before = run.report(lambda told: len(told["actors"]) == 2, "two actors")
    run.network.unplug("actor-1")
    began_s = time.monotonic()
    lost = run.report(lambda told: len(told["actors"]) == 1, "the loss is seen")
    noticed_s = time.monotonic() - began_s
    run.report(lambda told: told["progress"]["version"] > lost["progress"]["version"] + 5, "updates go on")
    threading.Event().wait(max(0.0, PARTITION_S - (time.monotonic() - began_s)))
    apart = run.report(lambda told: True, "a report")
    run.network.plug("actor-1")
    healed_s = time.monotonic()
    run.report(
        lambda told: [actor["accepted"] > 3 for actor in told["actors"] if actor["generation"] == 1] == [True],
        "the actor is back at work",
    )
    print(
        f"partition: noticed after {noticed_s:.1f} s, "
        f"{apart['progress']['version'] - before['progress']['version']} updates meanwhile, "
        f"back at work {time.monotonic() - healed_s:.1f} s after it ended"
    )
    assert noticed_s < LEASE_S + 5.0
    assert {name: process.poll() for name, process in run.processes.items()} == dict.fromkeys(run.processes)


def test_nothing_was_lost_or_doubled(run: RunOnHosts) -> None:
    """Every rollout is in the log once, and was used in one update, but for those of the update that was cut off."""
    codes = run.finish()
    assert codes == {"learner": 130, "actor-0": 0, "actor-1": 0}
    written, used = run.logged()
    assert len(written) == len(set(written))
    assert len(used) == len(set(used))
    assert set(used) <= set(written)
    assert len(set(written) - set(used)) <= 2
    by_life: dict[tuple[int, str], list[int]] = {}
    for slot, incarnation, seq in written:
        by_life.setdefault((slot, incarnation), []).append(seq)
    assert len(by_life) == 3
    assert all(seqs == list(range(len(seqs))) for seqs in by_life.values())
