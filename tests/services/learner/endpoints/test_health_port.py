"""The port for health checks: loopback, plain HTTP, and as good as the learner is."""

from __future__ import annotations

import socket

import pytest

from common.errors import SessionError
from common.wire.endpoint import free_port
from reskpn.health import port_health
from services.learner.endpoints.health_port import health_port

DEADLINE_S = 15.0


def test_it_says_when_joins_are_answered() -> None:
    """Not while the learner starts, then with the run's name; and after it no longer."""
    port = free_port()
    with health_port(port) as readiness:
        assert port_health(port, DEADLINE_S).text == "the learner is starting"
        readiness.serve("run-1", lambda: False)
        assert not port_health(port, DEADLINE_S).good
        readiness.serve("run-1", lambda: True)
        found = port_health(port, DEADLINE_S)
        assert (found.good, found.text) == (True, "the learner answers joins for run run-1")
    assert not port_health(port, DEADLINE_S).good


def test_others_that_connect_do_not_keep_it_busy() -> None:
    """Twenty connections that say nothing."""
    port = free_port()
    with health_port(port) as readiness:
        readiness.serve("run-1", lambda: True)
        silent = [socket.create_connection(("127.0.0.1", port), DEADLINE_S) for _ in range(20)]
        assert port_health(port, DEADLINE_S).good
        for one in silent:
            one.close()


def test_a_port_in_use_is_named() -> None:
    """With the setting to change."""
    port = free_port()
    with (
        health_port(port),
        pytest.raises(SessionError, match=rf"port {port} of 127.0.0.1 .* transport.health_port"),
        health_port(port),
    ):
        pass


def test_without_a_port_nothing_is_served() -> None:
    """The default."""
    with health_port(None) as readiness:
        readiness.serve("run-1", lambda: True)
        assert readiness.answer() == (200, "the learner answers joins for run run-1")
