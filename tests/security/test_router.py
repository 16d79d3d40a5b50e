"""Through a router: `reskpn router`, or Zenoh's own in this process with the configuration that `zenohd` is given."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import Queue
from types import TracebackType
from typing import Any, Self

import pytest
import zenoh
from guarded_sides import KEYS, REFUSED_S, GuardedLearner, Outside, until
from samples import heartbeat, question, rollout, snapshot

from common.config.settings import TransportSettings
from common.errors import SessionError, SettingsError
from common.wire.credentials import Credentials
from common.wire.endpoint import free_port
from common.wire.keys import JOIN
from common.wire.messages import Orders
from scripts.document_router import FILE, content
from services.learner.endpoints.listening import open_listener
from services.router.service import run_router


class RouterService:
    """`reskpn router` on a thread; may be ended and entered again, at the same address."""

    def __init__(self, certificates: Path) -> None:
        self.endpoint = f"tls/127.0.0.1:{free_port()}"
        self.said: list[str] = []
        self._transport = TransportSettings(endpoint=self.endpoint, certificates=certificates / "learner")
        self._codes: list[int] = []

    def __enter__(self) -> Self:
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        until(lambda: any("listening" in line for line in self.said) or not self._thread.is_alive())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        assert self._codes.pop() == 0

    def _run(self) -> None:
        self._codes.append(run_router(self._transport, stop=self._stop, say=self.said.append))


@contextmanager
def by_file(certificates: Path, folder: Path) -> Iterator[str]:
    """Its address. Only places of files and the address differ from the file."""
    endpoint = f"tls/127.0.0.1:{free_port()}"
    made = FILE.read_text().replace("/certs/", f"{certificates / 'learner'}/").replace("tls/0.0.0.0:7447", endpoint)
    (folder / "zenohd.json5").write_text(made)
    with zenoh.open(zenoh.Config.from_file(str(folder / "zenohd.json5"))):
        yield endpoint


@pytest.fixture(params=["service", "file"])
def router(request: pytest.FixtureRequest, certificates: Path, tmp_path: Path) -> Iterator[str]:
    """Its address."""
    if request.param == "file":
        with by_file(certificates, tmp_path) as endpoint:
            yield endpoint
    else:
        with RouterService(certificates) as service:
            yield service.endpoint


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


def test_the_router_tells_whom_it_refused(certificates: Path, foreign: Path, outside: Callable[..., Outside]) -> None:
    """Each reason once, and all of them counted when it stops."""
    with RouterService(certificates) as service:
        assert service.said == [f"router: listening on {service.endpoint}; lets in learner, actor, viewer"]
        with pytest.raises(SessionError, match="was not accepted here"):
            outside(service.endpoint, Credentials(foreign / "actor"), connect_timeout_s=REFUSED_S)
        until(lambda: len(service.said) > 1)
        assert "refused (1 times so far): a client did not accept" in service.said[1]
    assert service.said[-1].startswith("router: stopped; refused connections: untrusted ")


def test_a_router_that_is_started_again(
    certificates: Path,
    learners: Callable[[TransportSettings], GuardedLearner],
    outside: Callable[..., Outside],
) -> None:
    """Learner and actor find each other again, and go on with nothing lost."""
    service = RouterService(certificates)
    with service:
        transport = TransportSettings(endpoint=service.endpoint, certificates=certificates / "learner", router=True)
        learner = learners(transport)
        actor = outside(service.endpoint, Credentials(certificates / "actor"))
        assert actor.join("a").accepted
        assert actor.push(rollout(0, "a")).status == "accepted"
    with service:
        assert actor.ask(KEYS.policy_latest)
        learner.hub.publish(snapshot(1))
        assert actor.push(rollout(0, "a", 1, 1)).status == "accepted"
    assert learner.logged() == 2


def test_at_a_router_the_learner_is_a_user(tmp_path: Path) -> None:
    """With passwords it goes in by the first line of its file, and must be known to the router: refused at once."""
    others = tmp_path / "others"
    others.write_text("actor:secret\n")
    here = TransportSettings(endpoint=f"tcp/127.0.0.1:{free_port()}", users=others)
    with pytest.raises(SettingsError, match="has no learner: nobody could serve the others"):
        run_router(here, stop=threading.Event(), say=print)
    with pytest.raises(SettingsError, match="begins with 'actor'; give it a file that begins with learner:password"):
        open_listener(here.model_copy(update={"router": True}))


def test_a_run_with_passwords_through_a_router(
    tmp_path: Path, learners: Callable[[TransportSettings], GuardedLearner], outside: Callable[..., Outside]
) -> None:
    """The router's file has everyone; the learner's begins with itself."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    everyone, own, worker = (tmp_path / name for name in ("everyone", "own", "worker"))
    everyone.write_text("actor:secret\nlearner:word\nviewer:pass\n")
    own.write_text("learner:word\n")
    worker.write_text("actor:secret\n")
    stop, said = threading.Event(), list[str]()
    router = threading.Thread(
        target=run_router,
        args=(TransportSettings(endpoint=endpoint, users=everyone),),
        kwargs={"stop": stop, "say": said.append},
    )
    router.start()
    try:
        until(lambda: bool(said))
        learner = learners(TransportSettings(endpoint=endpoint, users=own, router=True))
        actor = outside(endpoint, Credentials(users=worker))
        assert actor.join("a").accepted
        assert actor.push(rollout(0, "a")).status == "accepted"
        assert learner.logged() == 1
    finally:
        stop.set()
        router.join()


def test_a_router_that_asks_nobody_stays_on_this_machine() -> None:
    """Unless it is said that it may not."""
    with pytest.raises(SettingsError, match=r"--endpoint tcp/0\.0\.0\.0:7447 can be reached .* say --insecure"):
        run_router(TransportSettings(endpoint="tcp/0.0.0.0:7447"), stop=threading.Event(), say=print)
