"""A port for health checks: plain HTTP on loopback, which clients of the learner's listener cannot keep busy."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from common.errors import SessionError

REQUEST_S = 5.0
HOST = "127.0.0.1"


READY_PATH = "/ready"
"""Asks for a learner that takes actors; any other path for one that is alive, as while it resumes a run."""


class Readiness:
    """The state of the learner: it starts, resumes a run, or serves requests to join."""

    def __init__(self) -> None:
        self._run = ""
        self._responds: Callable[[], bool] = lambda: False
        self._resuming: Callable[[], str] | None = None

    def resume(self, text: Callable[[], str]) -> None:
        """Answer with this text, which says how far a resuming learner is, until joins are granted."""
        self._resuming = text

    def serve(self, run: str, responds: Callable[[], bool]) -> None:
        """Answer with this run as soon as `responds` says that requests to join are answered."""
        self._run = run
        self._responds = responds

    def answer(self, path: str = "/") -> tuple[int, str]:
        """(HTTP status, a line of text)."""
        if not self._responds():
            if self._resuming is None:
                return 503, "the learner is starting"
            return 503 if path == READY_PATH else 200, f"the learner is {self._resuming()}"
        return 200, f"the learner answers joins for run {self._run}"


@contextmanager
def health_port(port: int | None) -> Iterator[Readiness]:
    """Serve GET on loopback while it is entered; nothing without a port. SessionError where the port is in use."""
    readiness = Readiness()
    if port is None:
        yield readiness
        return

    class Handler(BaseHTTPRequestHandler):
        timeout = REQUEST_S

        def do_GET(self) -> None:
            status, text = readiness.answer(self.path)
            content = f"{text}\n".encode()
            self.send_response(status)
            self.send_header("Content-Type", "text/plain; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: object) -> None:
            """Nothing is printed: checks come every few seconds."""

    try:
        server = ThreadingHTTPServer((HOST, port), Handler)
    except OSError as error:
        raise SessionError(
            f"health checks cannot be served on port {port} of {HOST} ({error.strerror}): choose another "
            "transport.health_port"
        ) from None
    server.daemon_threads = True
    server.handle_error = lambda *_: None  # type: ignore[method-assign]  # a check that was broken off
    thread = threading.Thread(target=server.serve_forever, name="health", daemon=True)
    thread.start()
    try:
        yield readiness
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
