"""Why there is no connection, found by trying the address by hand."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from common.wire.credentials import NO_CREDENTIALS, Credentials
from common.wire.diagnosis import plain, unserved, why_no_connection
from common.wire.endpoint import free_port
from reskpn.authority import make_all


@pytest.fixture
def listener() -> Iterator[str]:
    """The address of a program that takes connections and says nothing."""
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        yield f"127.0.0.1:{server.getsockname()[1]}"


def test_nobody_listens() -> None:
    """Seen at once."""
    assert why_no_connection(f"tcp/127.0.0.1:{free_port()}", NO_CREDENTIALS).startswith("nothing listens at that port")


def test_no_such_host() -> None:
    """Its name is in the sentence (.invalid is never a host)."""
    assert (
        why_no_connection("tcp/learner.invalid:7447", NO_CREDENTIALS)
        == "there is no host learner.invalid: check the name"
    )


def test_somebody_listens(listener: str) -> None:
    """Then it is what this process says of itself, or fails to say."""
    assert "it speaks TLS (tls/...) and wants a certificate" in why_no_connection(f"tcp/{listener}", NO_CREDENTIALS)
    users = Credentials(users=Path("users"))
    assert "the user or the password was not accepted" in why_no_connection(f"tcp/{listener}", users)


@pytest.mark.parametrize("says", [b"HTTP/1.1 400 Bad Request\r\n\r\n", b""], ids=["another protocol", "nothing"])
def test_no_tls_there(says: bytes, tmp_path: Path) -> None:
    """A program that answers in another protocol, or hangs up, is known by that."""
    make_all(tmp_path / "c", ["127.0.0.1"], days=1)
    with closing(socket.create_server(("127.0.0.1", 0))) as server:

        def answer() -> None:
            line, _ = server.accept()
            with line:
                line.recv(10_000)
                line.sendall(says)

        thread = threading.Thread(target=answer)
        thread.start()
        endpoint = f"tls/127.0.0.1:{server.getsockname()[1]}"
        why = why_no_connection(endpoint, Credentials(tmp_path / "c" / "actor"))
        thread.join()
    assert "does not speak TLS" in why
    assert why.endswith("try tcp/...")


def test_other_sentences() -> None:
    """The places in Zenoh's source are left out; a learner that serves nothing to this process may mean its name."""
    assert plain(RuntimeError("Timeout! at /root/x/orchestrator.rs:388.")) == "Timeout!"
    assert "transport.actor_names" in unserved("tls/10.0.0.5:7447")
