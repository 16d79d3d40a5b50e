"""Standard output that closes, or belongs to the shell, while the run goes on."""

from __future__ import annotations

import io
import os
import pty
import subprocess
import sys

import pytest

from common.output import Output, run_output
from services.learner.reporting.display import make_display


class Terminal(io.StringIO):
    """A terminal that keeps what is written on it."""

    def isatty(self) -> bool:
        return True


CLOSED_BY_ITS_READER = """
import sys
from services.learner.reporting.display import make_display
from common.output import run_output
display = make_display("a title", run_output(lambda: False))
sys.stdin.readline()
for number in range(3):
    display.note("a note")
display.close()
print("the run goes on", file=sys.stderr)
"""


def test_a_closed_pipe_ends_the_output_and_not_the_run() -> None:
    """As of `reskpn train | head -1`: what is written later goes nowhere, and the process ends with its own code."""
    with subprocess.Popen(
        [sys.executable, "-c", CLOSED_BY_ITS_READER],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == "a title\n"
        process.stdout.close()
        process.stdin.write("closed\n")
        process.stdin.close()
        assert process.stderr.read() == "the run goes on\n"
    assert process.returncode == 0


def test_a_closed_terminal_ends_the_output_and_not_the_run() -> None:
    """A live display on a terminal whose other side is gone: every further line fails there, none here."""
    master, slave = pty.openpty()
    with os.fdopen(slave, "w") as terminal:
        display = make_display("a title", Output(terminal))
        assert b"a title" in os.read(master, 4096)
        os.close(master)
        for _ in range(3):
            display.note("a note")
        display.close()


def test_without_a_standard_output() -> None:
    """As after `reskpn train >&-`: nothing is written, and nothing fails."""
    output = Output(None)
    assert output.write("text") == 4
    output.flush()
    assert not output.isatty()
    make_display("a title", output).close()


def test_a_learner_that_was_left_alone_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a second Ctrl-C, which ends `reskpn train` at once: asked to stop, on a terminal, with another parent.

    It only gives the cursor back, which its live display had hidden.
    """
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    stopped: list[bool] = []
    output = run_output(lambda: bool(stopped))
    monkeypatch.setattr(os, "getppid", lambda: 1)
    output.write("still training\n")
    stopped.append(True)
    output.write("stopped early\n")
    output.write("its log\n")
    assert terminal.getvalue() == "still training\n\x1b[?25h"


def test_a_file_gets_every_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a learner whose shell has gone, as with nohup: there is no prompt to write over."""
    file = io.StringIO()
    monkeypatch.setattr(sys, "stdout", file)
    output = run_output(lambda: True)
    monkeypatch.setattr(os, "getppid", lambda: 1)
    output.write("stopped early\n")
    assert file.getvalue() == "stopped early\n"
