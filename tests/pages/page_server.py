"""The page served in this process, for the tests that look at it."""

from __future__ import annotations

import socket
import threading
from dataclasses import dataclass, field

from common.wire.listening_socket import address_of, listen
from services.dashboard.service import Served, serve


@dataclass
class Server:
    """A page that is served, and can be stopped and started again at the same address."""

    served: Served
    port: int | None = None
    stop: threading.Event = field(default_factory=threading.Event)
    thread: threading.Thread | None = None
    address: str = ""

    def start(self) -> str:
        """Serve; returns the address once it can be opened."""
        self.stop = threading.Event()
        listening: socket.socket = listen("127.0.0.1", self.port)
        self.port = listening.getsockname()[1]
        self.address = address_of(listening, self.served.token)
        ready = threading.Event()

        def run() -> None:
            with listening:
                serve(listening, self.served, self.stop, ready.set)

        self.thread = threading.Thread(target=run)
        self.thread.start()
        assert ready.wait(20.0)
        return self.address

    def end(self) -> None:
        self.stop.set()
        if self.thread is not None:
            self.thread.join()
