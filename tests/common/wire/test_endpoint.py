"""Addresses: what may be given, and which of them other machines can reach."""

import socket

import pytest

from common.errors import SessionError
from common.wire.endpoint import Endpoint, free_port, is_loopback


@pytest.mark.parametrize(
    ("text", "protocol", "host", "port", "loopback"),
    [
        ("tcp/127.0.0.1:7447", "tcp", "127.0.0.1", 7447, True),
        ("tcp/127.8.0.9:1", "tcp", "127.8.0.9", 1, True),
        ("tcp/[::1]:65535", "tcp", "::1", 65535, True),
        ("tls/localhost:7447", "tls", "localhost", 7447, True),
        ("tcp/0.0.0.0:7447", "tcp", "0.0.0.0", 7447, False),
        ("tcp/[::]:7447", "tcp", "::", 7447, False),
        ("tcp/10.0.0.7:7447", "tcp", "10.0.0.7", 7447, False),
        ("quic/learner.example:7447", "quic", "learner.example", 7447, False),
        ("tcp/localhost.example:7447", "tcp", "localhost.example", 7447, False),
        ("tcp/10.0.0.7:7447#iface=eth0", "tcp", "10.0.0.7", 7447, False),
    ],
)
def test_addresses(text, protocol, host, port, loopback):
    """An address comes apart, and only this machine's own ones are loopback."""
    assert Endpoint.parse(text) == Endpoint(protocol, host, port)
    assert is_loopback(text) is loopback


@pytest.mark.parametrize(
    "text",
    [
        "",
        "127.0.0.1:7447",
        "tcp/127.0.0.1",
        "tcp/127.0.0.1:0",
        "tcp/127.0.0.1:65536",
        "tcp/127.0.0.1:x",
        "tcp/:7447",
        "tcp/::1:7447",
        "http/127.0.0.1:7447",
        "tcp/a/b:7447",
    ],
)
def test_what_is_not_an_address(text):
    """Zenoh would try these for ever; here they are refused with an example."""
    with pytest.raises(SessionError, match=r"as in tcp/127\.0\.0\.1:7447"):
        is_loopback(text)


def test_a_free_port_can_be_bound():
    """The port is a real one and nobody has it."""
    port = free_port()
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", port))
        assert probe.getsockname()[1] == port > 0
