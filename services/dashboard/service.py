"""The dashboard as a process: a socket, a web server, and the threads that follow runs."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import uvicorn

from common.errors import SettingsError
from common.wire.credentials import NO_CREDENTIALS, Credentials
from services.dashboard.app import Page
from services.dashboard.collection import RunCollection, check_paths
from services.dashboard.learner_link import first_report
from services.dashboard.live_run import WatchedLearner
from services.dashboard.security import Guard, own_names

SHORTEST_TOKEN = 16

CHECK_S = 0.2


@dataclass(frozen=True)
class Served:
    """Where the page is served, and what of.

    Attributes:
        paths: run directories and folders of runs.
        endpoint: address of a learner whose runs are shown as well; None for none.
        token: that a reader must know; None for none.
        names: by which the page may be asked for, besides addresses and this machine's own names.
    """

    paths: Sequence[Path]
    endpoint: str | None = None
    credentials: Credentials = NO_CREDENTIALS
    token: str | None = None
    names: frozenset[str] = frozenset()


def is_loopback(host: str) -> bool:
    """True if only processes of this machine can reach the host."""
    try:
        found = {info[4][0] for info in socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)}
    except OSError:
        return False
    return all(str(address).startswith("127.") or address == "::1" for address in found)


def check_token(host: str, token: str | None) -> None:
    """SettingsError for a host that others can reach without a token, and for a token that could be guessed."""
    if token is None and not is_loopback(host):
        raise SettingsError(
            f"--host {host} lets other machines read the page: give a token with --token-file FILE or "
            "RESKPN_DASHBOARD_TOKEN, have one made with --new-token, or leave --host out and use an SSH tunnel"
        )
    if token is not None and len(token) < SHORTEST_TOKEN:
        raise SettingsError(
            f"the token has {len(token)} characters, and could be guessed: at least {SHORTEST_TOKEN} are needed, as "
            "`openssl rand -hex 16` makes them"
        )


def serve(listening: socket.socket, served: Served, stop: threading.Event, ready: Callable[[], None]) -> None:
    """Serve the page until `stop` is set; `ready` is called once it can be opened.

    Raises:
        SettingsError: a path holds no run.
        SessionError: no learner answers at the endpoint.
    """
    check_paths(served.paths)
    report = None if served.endpoint is None else first_report(served.endpoint, served.credentials)
    runs = RunCollection(served.paths, served.credentials, stop)
    threads: list[RunCollection | WatchedLearner] = [runs]
    if served.endpoint is not None and report is not None:
        threads.append(WatchedLearner(served.endpoint, served.credentials, report, runs.add, stop))
    port = listening.getsockname()[1]
    guarded = Guard(Page(runs, stop).application(), served.token, own_names() | served.names, port)
    config = uvicorn.Config(
        guarded,
        loop="asyncio",
        http="h11",
        ws="none",
        log_config=None,
        access_log=False,
        server_header=False,
        date_header=False,
        lifespan="off",
        timeout_graceful_shutdown=2,
        limit_concurrency=128,
        h11_max_incomplete_event_size=16384,
    )
    for each in threads:
        each.start()
    try:
        asyncio.run(_serve(_Server(config), listening, stop, ready))
    finally:
        stop.set()
        for each in threads:
            each.join()


class _Server(uvicorn.Server):
    """Leaves signals to this program, which stops by an event."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


async def _serve(
    server: uvicorn.Server, listening: socket.socket, stop: threading.Event, ready: Callable[[], None]
) -> None:
    serving = asyncio.create_task(server.serve(sockets=[listening]))
    while not server.started and not serving.done():
        await asyncio.sleep(0.01)
    ready()
    while not stop.is_set() and not serving.done():
        await asyncio.sleep(CHECK_S)
    server.should_exit = True
    await serving
