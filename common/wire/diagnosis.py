"""Sentences on what keeps a session from being opened or answered.

Zenoh says only that a connection did not come about, so the same address is tried here by hand.
"""

from __future__ import annotations

import re
import socket
import ssl
from collections.abc import Sequence

from common.wire.credentials import CA, CERTIFICATE, KEY, Credentials
from common.wire.endpoint import Endpoint

TRY_S = 2.0
"""How long one attempt may take."""

_BY_PASSWORD = "the user or the password was not accepted, or the learner asks for none where one was given"


def plain(error: Exception) -> str:
    """Zenoh's sentence without the places in its source code."""
    return re.sub(r"\s*at /\S+\.rs:\d+\.?", "", str(error)).strip()


def no_connection(connect: Sequence[str], timeout_s: float, credentials: Credentials) -> str:
    """The sentence for a connection that was not made in time."""
    return (
        f"no connection to {', '.join(connect)} within {timeout_s:g} s. Likely causes: no learner is running there; "
        "the address or the port is wrong; a firewall drops the connection; one side speaks TLS and the other does "
        "not, or a certificate, user or password was not accepted. Seen from here: "
        + why_no_connection(connect[0], credentials)
    )


def unserved(endpoint: str) -> str:
    """The sentence for a peer that is connected and answers nothing."""
    return (
        f"{endpoint} is connected, but serves nothing to this process: it is still starting or is no learner, or it "
        "does not give the name in this certificate, or this user, the right to work (transport.actor_names there)"
    )


def cannot_open(listen: Sequence[str], text: str) -> str:
    """The sentence for Zenoh's reason, `text`, for not opening a session."""
    where = ", ".join(listen)
    if "Address already in use" in text:
        ports = ", ".join(str(Endpoint.parse(endpoint).port) for endpoint in listen)
        return f"port {ports} of {where} is in use: stop the process that has it, or choose another port to listen on"
    if "Cannot assign requested address" in text or "failed to lookup" in text:
        return f"{where} is not an address of this machine: listen on 127.0.0.1, 0.0.0.0 or one of its own addresses"
    return f"cannot open a Zenoh session{f' on {where}' if where else ''}: {text}"


def why_no_connection(endpoint: str, credentials: Credentials) -> str:
    """A clause for a person: the cause where it can be seen from here, else the likely ones. Takes up to 4 s."""
    there = Endpoint.parse(endpoint)
    if there.protocol == "quic":
        return "no learner is there, a firewall drops the connection, or a certificate was not accepted"
    try:
        with socket.create_connection((there.host, there.port), TRY_S) as line:
            if there.protocol == "tls":
                return _by_tls(line, there.host, credentials)
    except socket.gaierror:
        return f"there is no host {there.host}: check the name"
    except ConnectionRefusedError:
        return "nothing listens at that port: no learner is running there, or the address or the port is wrong"
    except OSError as error:
        return (
            f"the host cannot be reached ({error.strerror or error}): the address is wrong, a firewall drops the "
            "connection, or the network is down"
        )
    if credentials.users is not None:
        return f"{_BY_PASSWORD}; or what listens there is not a learner, or speaks TLS (tls/...)"
    return (
        "something listens there, but does not let this process in. Likely causes: it speaks TLS (tls/...) and wants a "
        "certificate, it wants a user and password, or it is not a learner"
    )


def _by_tls(line: socket.socket, host: str, credentials: Credentials) -> str:
    folder = credentials.certificates
    assert folder is not None, "an address with TLS is refused without certificates"
    context = ssl.create_default_context(cafile=folder / CA)
    if credentials.users is None:
        context.load_cert_chain(folder / CERTIFICATE, folder / KEY)
    try:
        with context.wrap_socket(line, server_hostname=host) as secured:
            # Whether this side's certificate is accepted shows in what comes after the handshake: nothing, if it is.
            secured.settimeout(TRY_S / 2)
            secured.recv(1)
    except TimeoutError:
        return _BY_PASSWORD if credentials.users is not None else "it is busy, or not a learner of this release"
    except ssl.SSLCertVerificationError as error:
        return (
            f"the certificate that the learner shows was not accepted here ({error.verify_message}): it must be of "
            f"the authority in {folder / CA}, be made for the name {host}, and be valid by this machine's clock"
        )
    except ssl.SSLError as error:
        return _alert(error, credentials)
    except OSError:
        return "what listens there ends the connection: it speaks no TLS (try tcp/...), or is not a learner"
    return "what listens there ends the connection: it is not a learner, or its certificate authority is another one"


def _alert(error: ssl.SSLError, credentials: Credentials) -> str:
    reason = (error.reason or "").lower()
    if "alert" not in reason and "certificate" not in reason:
        return f"what listens there does not speak TLS ({reason.replace('_', ' ') or error}): try tcp/..."
    return (
        f"the learner did not accept the certificate {credentials.certificates}/{CERTIFICATE} "
        f"({reason.replace('_', ' ')}): it must be of the learner's own authority and be valid by its clock"
    )
