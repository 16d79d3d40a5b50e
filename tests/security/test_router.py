"""Through a router, with the configuration that `zenohd` is given; the router here is Zenoh's own, in this process."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import Queue
from typing import Any

import pytest
import zenoh
from guarded_sides import KEYS, REFUSED_S, GuardedLearner, Outside, until
from samples import heartbeat, question, rollout

from common.errors import SessionError
from common.settings import TransportSettings
from common.wire.credentials import Credentials
from common.wire.endpoint import free_port
from common.wire.keys import JOIN
from common.wire.messages import Orders
from scripts.document_router import FILE, content


@pytest.fixture
def router(certificates: Path, tmp_path: Path) -> Iterator[str]:
    """Its address. Only places of files and the address differ from the file."""
    endpoint = f"tls/127.0.0.1:{free_port()}"
    made = FILE.read_text().replace("/certs/", f"{certificates / 'learner'}/").replace("tls/0.0.0.0:7447", endpoint)
    (tmp_path / "zenohd.json5").write_text(made)
    with zenoh.open(zenoh.Config.from_file(str(tmp_path / "zenohd.json5"))):
        yield endpoint


def test_the_file_is_current() -> None:
    """It is what `python -m scripts.document_router` writes; what nobody may do is denied in it."""
    assert FILE.read_text() == content()
    settings: dict[str, Any] = json.loads("\n".join(line for line in content().splitlines() if line[:2] != "//"))
    assert settings["access_control"]["default_permission"] == "deny"


def test_a_run_through_a_router(
    router: str,
    certificates: Path,
    learners: Callable[[TransportSettings], GuardedLearner],
    outside: Callable[..., Outside],
) -> None:
    """An actor joins, hears orders, fetches the policy, pushes, and is missed when it goes; a viewer only watches."""
    learner = learners(TransportSettings(endpoint=router, certificates=certificates / "learner", router=True))
    actor = outside(router, Credentials(certificates / "actor"))
    assert actor.join("a").accepted
    actor.session.declare_alive(KEYS.alive("actor", "a"))
    heard, gone = Queue[bool](), Queue[bool]()
    actor.session.subscribe(KEYS.policy_notify, lambda key, data: heard.put(Orders.decode(data).finished))
    actor.session.watch_alive(KEYS.alive("learner", "learner"), lambda key, alive: gone.put(not alive))
    assert gone.get(timeout=15) is False
    beat = actor.session.publisher(KEYS.heartbeat(0))

    def at_work() -> bool:
        beat.put(heartbeat(0, "a", "collecting").encode())
        return actor.report().actors[0].state == "collecting"

    until(at_work)
    assert actor.push(rollout(0, "a")).status == "accepted"
    learner.hub.announce()
    assert heard.get(timeout=15) is False
    viewer = outside(router, Credentials(certificates / "viewer"))
    assert len(viewer.report().actors) == 1
    for key, payload in ((JOIN, question("v").encode()), (KEYS.rollout(0), rollout(0, "a", seq=1).encode())):
        with pytest.raises(SessionError):
            viewer.session.ask(key, payload, REFUSED_S)
    viewer.session.publisher(KEYS.policy_notify).put(Orders("run-1", 9, "d", 1, {}, {}, True, 1).encode())
    viewer.report()
    assert True not in heard.queue
    actor.session.close()
    until(lambda: viewer.report().actors == [])
