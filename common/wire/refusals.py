"""The reasons for which connections were refused before any message, as far as they are found in Zenoh's log lines."""

from __future__ import annotations

import os
import re
import sys
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Self

_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_OURS = re.compile(r"\s(?:WARN|DEBUG|ERROR|INFO)\s.*\b(?:zenoh_link_tls|zenoh_transport)::")

REASONS = {
    "no_certificate": "a client without a certificate was refused",
    "bad_certificate": "a certificate that is not of this run's authority, or has expired, was refused",
    "untrusted": (
        "a client did not accept the certificate shown here: it is of another authority, or was not made for the "
        "address that the client used"
    ),
    "no_tls": "a client that does not speak TLS was refused",
    "bad_user": "a user that is not in the file of users was refused",
    "bad_password": "a user with a wrong password was refused",
    "no_user": "a client without user and password was refused",
    "handshake": "a client connected and did not continue, as a port scan does",
    "stranger": "a client has a certificate of this run's authority, but a name without a role",
}
"""The meaning of each reason that is counted."""

# The first sign that is found in a line decides.
_SIGNS = (
    ("NoCertificatesPresented", "no_certificate"),
    ("peer sent no certificates", "no_certificate"),
    ("invalid peer certificate", "bad_certificate"),
    ("received fatal alert", "untrusted"),
    ("corrupt message", "no_tls"),
    ("Invalid password", "bad_password"),
    ("Invalid user", "bad_user"),
    ("UsrPwd", "no_user"),
    ("auth extension", "no_user"),
    ("handshake eof", "handshake"),
)


def is_zenoh_line(line: str) -> bool:
    """True for a line of Zenoh's log."""
    return _OURS.search(_COLOURS.sub("", line)) is not None


def refusal(line: str) -> str | None:
    """The reason that a line of Zenoh's log gives for refusing a connection; None where it gives none."""
    return next((reason for sign, reason in _SIGNS if sign in line), None)


class StandardOutputTap:
    """While it is entered, whole lines written to file descriptor 1 are passed to `take` first.

    Lines that it takes go no further. Python's own `print` and displays bypass it, and go where they went before.
    """

    def __init__(self, take: Callable[[str], bool]) -> None:
        self._take = take

    def __enter__(self) -> Self:
        sys.stdout.flush()
        self._python = sys.stdout
        self._real = os.dup(1)
        source, sink = os.pipe()
        os.dup2(sink, 1)
        os.close(sink)
        if sys.stdout is sys.__stdout__:
            sys.stdout = os.fdopen(os.dup(self._real), "w", buffering=1, encoding=self._python.encoding)
        self._thread = threading.Thread(target=self._run, args=(source,), name="zenoh's log", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if sys.stdout is not self._python:
            sys.stdout.close()
            sys.stdout = self._python
        os.dup2(self._real, 1)  # the pipe has no writer now, so the thread comes to its end
        self._thread.join()
        os.close(self._real)

    def _run(self, source: int) -> None:
        with os.fdopen(source, "rb") as lines:
            for line in lines:
                if not self._take(line.decode("utf-8", "replace")):
                    os.write(self._real, line)
