"""Refused connections, read from what Zenoh writes to standard output."""

from __future__ import annotations

import os
from queue import Queue

import pytest

from common.wire.refusals import REASONS, StandardOutputTap, is_zenoh_line, refusal

HEAD = (
    "\x1b[2m2026-01-01T00:00:00Z\x1b[0m \x1b[33m WARN\x1b[0m acc-0 ThreadId(06) \x1b[2mzenoh_link_tls::unicast\x1b[0m: "
)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("peer sent no certificates. Hint: increase the system open file limit.", "no_certificate"),
        ("invalid peer certificate: UnknownIssuer. Hint: ...", "bad_certificate"),
        ("received fatal alert: UnknownCA. Hint: ...", "untrusted"),
        ("received corrupt message of type InvalidContentType. Hint: ...", "no_tls"),
        ("tls handshake eof. Hint: ...", "handshake"),
        ("something else", None),
    ],
)
def test_reasons(text: str, reason: str | None) -> None:
    """A word of this program for each, with a sentence; what is not understood is not guessed."""
    assert is_zenoh_line(HEAD + text)
    assert refusal(HEAD + text) == reason
    assert reason is None or REASONS[reason]


@pytest.mark.parametrize("line", ["update 3/10 of zenoh_link_tls", "WARNING: received fatal alert", ""])
def test_lines_of_others(line: str) -> None:
    """Are not taken for Zenoh's."""
    assert not is_zenoh_line(line)


def test_the_tap(capfd: pytest.CaptureFixture[str]) -> None:
    """What is taken goes no further; all else arrives, in order and whole, also when written in parts."""
    taken = Queue[str]()

    def take(line: str) -> bool:
        if line.startswith("mine"):
            taken.put(line)
            return True
        return False

    with StandardOutputTap(take):
        os.write(1, b"one\nmine 1\ntw")
        os.write(1, b"o\nmine 2\nthree")
    os.write(1, b", after\n")
    assert [taken.get(timeout=15), taken.get(timeout=15)] == ["mine 1\n", "mine 2\n"]
    assert capfd.readouterr().out == "one\ntwo\nthree, after\n"
