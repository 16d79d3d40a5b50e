"""Addresses as Zenoh writes them: `tcp/127.0.0.1:7447`, `tls/learner.example:7447`, `tcp/[::1]:7447`."""

from __future__ import annotations

import ipaddress
import re
import socket
from dataclasses import dataclass
from typing import Self

from common.errors import SessionError

_ENDPOINT = re.compile(r"(?P<protocol>tcp|tls|quic)/(?P<host>\[[^]]+\]|[^][:/?#]+):(?P<port>\d{1,5})(?:[?#].*)?")


@dataclass(frozen=True)
class Endpoint:
    """One address, taken apart; an IPv6 `host` is without its brackets."""

    protocol: str
    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> Self:
        """Raises `SessionError` for what is not an address with a port from 1 to 65535.

        Zenoh itself would try to reach an impossible address for ever, and does not tell which port it got for 0.
        """
        match = _ENDPOINT.fullmatch(text)
        if match is None or not 1 <= int(match["port"]) <= 65535:
            raise SessionError(
                f"{text!r} is not an address: give <protocol>/<host>:<port> with protocol tcp, tls or quic "
                "and a port from 1 to 65535, as in tcp/127.0.0.1:7447"
            )
        return cls(match["protocol"], match["host"].strip("[]"), int(match["port"]))

    @property
    def is_loopback(self) -> bool:
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"


def is_loopback(endpoint: str) -> bool:
    """True if only processes of this machine can reach the endpoint; `SessionError` if it is not an address."""
    return Endpoint.parse(endpoint).is_loopback


def free_port() -> int:
    """A TCP port of 127.0.0.1 that is free now; nothing keeps it free until it is used."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port
