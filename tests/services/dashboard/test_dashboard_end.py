"""The end of the process that serves the page."""

from __future__ import annotations

import socket
import threading
import urllib.request
from collections.abc import Callable
from pathlib import Path

from dashboard_runs import settings

from services.dashboard.service import Served, serve


def test_no_thread_outlives_the_page(
    make_run: Callable[..., Path], stop: threading.Event, until: Callable[[Callable[[], bool]], None]
) -> None:
    """Also not that which is about to connect to a learner that says nothing: Python's end would abort the process."""
    with socket.create_server(("127.0.0.1", 0)) as silent, socket.create_server(("127.0.0.1", 0)) as listening:
        endpoint = f"tcp/127.0.0.1:{silent.getsockname()[1]}"
        path = make_run(given=settings(transport={"endpoint": endpoint}))
        before, opened = set(threading.enumerate()), threading.Event()
        page = threading.Thread(target=serve, args=(listening, Served([path]), stop, opened.set))
        page.start()
        assert opened.wait(20.0)
        with urllib.request.urlopen(f"http://127.0.0.1:{listening.getsockname()[1]}/stream", timeout=20.0) as stream:
            stream.readline()
            until(lambda: "learner-link" in {thread.name for thread in threading.enumerate()})
            stop.set()
            page.join()
    assert {thread.name for thread in set(threading.enumerate()) - before} & {"runs", "learner-link"} == set()
