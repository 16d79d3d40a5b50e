"""A TCP socket for a page in the browser: on a port that is given, or on the first free one from a default on."""

from __future__ import annotations

import errno
import socket

from common.errors import SessionError

PORT = 6007
TRIED = 20
"""Ports from the default on that are tried in turn."""


def listen(host: str, port: int | None) -> socket.socket:
    """A socket that listens there; without a port on the default or, where that is taken, on one of the next.

    Raises:
        SessionError: the port is in use, or it is not a host of this machine.
    """
    ports = range(PORT, PORT + TRIED) if port is None else [port]
    for candidate in ports:
        try:
            return _bound(host, candidate)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                reason = error.strerror or str(error)
                raise SessionError(f"cannot serve the page on {host}:{candidate}: {reason}") from None
    if port is None:
        raise SessionError(f"ports {PORT} to {PORT + TRIED - 1} of {host} are all in use; give another with --port")
    raise SessionError(f"port {port} of {host} is in use; give another with --port, or none for the next that is free")


def _bound(host: str, port: int) -> socket.socket:
    family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    found = socket.socket(family, kind, protocol)
    try:
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind(address)
        found.listen(128)
    except OSError:
        found.close()
        raise
    return found


def address_of(listening: socket.socket, token: str | None = None) -> str:
    """The address to open in a browser of this machine."""
    host, port = listening.getsockname()[:2]
    host = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)
    return f"http://{host}:{port}/" + (f"?token={token}" if token else "")
