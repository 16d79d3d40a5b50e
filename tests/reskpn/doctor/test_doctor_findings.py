"""Findings, one line each."""

from __future__ import annotations

import pytest

from common.errors import PhysicsError
from reskpn.doctor.findings import Finding, guarded, size


def test_a_finding_is_one_line() -> None:
    """Its level first, so that a person finds the problems; what to do last."""
    assert Finding("disk", "ok", "1 GB free").line == "ok       disk       1 GB free"
    assert Finding("port", "problem", "taken", "choose another").line == ("problem  port       taken; choose another")


def test_a_check_that_fails_is_a_problem() -> None:
    """The others go on: our own errors in their sentence, a broken library's with its kind."""

    def ours() -> Finding:
        raise PhysicsError("no engine; install mujoco")

    def theirs() -> Finding:
        raise OSError("libGL.so.1: cannot open\nshared object file")

    assert guarded("native", ours) == Finding("native", "problem", "no engine; install mujoco")
    found = guarded("mjx", theirs)
    assert (found.level, found.text) == ("problem", "OSError: libGL.so.1: cannot open?shared object file")


@pytest.mark.parametrize(
    ("count", "text"),
    [(0, "0 bytes"), (999, "999 bytes"), (22e6, "22.0 MB"), (1.5e9, "1.5 GB"), (2e15, "2,000.0 TB")],
)
def test_sizes(count: float, text: str) -> None:
    """In powers of a thousand, as disks are sold."""
    assert size(count) == text
