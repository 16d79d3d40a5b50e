"""How a service is told to stop: by a signal, or by the end of its supervisor."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from reskpn.supervision.stopping import stopping

ROOT = Path(__file__).parents[3]
DEADLINE_S = 20.0

SERVICE = """
import sys
from reskpn.supervision.stopping import stopping
with stopping(supervised={supervised}) as stop:
    print("ready", flush=True)
    assert stop.wait(60)
    print("stopping", flush=True)
    if {hang}:
        import time
        time.sleep(60)
print("stopped", flush=True)
"""


@pytest.fixture
def start() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts a service that does nothing until it is told to stop, and waits until it is ready."""
    with ExitStack() as stack:

        def make(*, supervised: bool, hang: bool = False) -> subprocess.Popen[str]:
            process = stack.enter_context(
                subprocess.Popen(
                    [sys.executable, "-c", SERVICE.format(supervised=supervised, hang=hang)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    text=True,
                    cwd=ROOT,
                )
            )
            stack.callback(process.kill)
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            return process

        yield make


Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture(autouse=True)
def hangups_are_not_ignored() -> Iterator[None]:
    """As in a terminal, also where the tests themselves run under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_sets_the_event(number: signal.Signals) -> None:
    """SIGINT by Ctrl-C, SIGTERM by a container's end, SIGHUP by a closed terminal; then the old handlers are back."""
    before = signal.getsignal(number)
    with stopping(supervised=False) as stop:
        assert not stop.is_set()
        os.kill(os.getpid(), number)
        assert stop.wait(DEADLINE_S)
    assert signal.getsignal(number) is before


def test_a_closed_terminal_may_say_so_twice() -> None:
    """By the kernel, and by the shell: the second SIGHUP does not end the process as a second Ctrl-C would."""
    with stopping(supervised=False) as stop:
        for _ in range(2):
            os.kill(os.getpid(), signal.SIGHUP)
        assert stop.wait(DEADLINE_S)


def test_a_hangup_that_is_ignored_stops_nothing() -> None:
    """As under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with stopping(supervised=False) as stop:
            os.kill(os.getpid(), signal.SIGHUP)
            os.kill(os.getpid(), signal.SIGTERM)
            assert stop.wait(DEADLINE_S)
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_an_error_puts_the_handlers_back() -> None:
    """However the work ends."""
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ValueError, match="broken"), stopping(supervised=False):
        raise ValueError("broken")
    assert signal.getsignal(signal.SIGINT) is before


def test_a_service_that_is_told_to_stop_ends_in_order(start: Start) -> None:
    """By a signal."""
    process = start(supervised=False)
    process.send_signal(signal.SIGTERM)
    output, _ = process.communicate(timeout=DEADLINE_S)
    assert (output, process.returncode) == ("stopping\nstopped\n", 0)


def test_a_second_signal_ends_it_at_once(start: Start) -> None:
    """A service that does not come to its end is left with the signal's exit code."""
    process = start(supervised=False, hang=True)
    assert process.stdout is not None
    process.send_signal(signal.SIGINT)
    assert process.stdout.readline() == "stopping\n"
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=DEADLINE_S)
    assert (output, process.returncode) == ("", 128 + signal.SIGINT)


def test_the_end_of_the_supervisor_stops_a_service(start: Start) -> None:
    """Its standard input ends then, whatever was said on it before."""
    process = start(supervised=True)
    assert process.stdin is not None
    process.stdin.write("words\n")
    process.stdin.flush()
    assert process.poll() is None
    output, _ = process.communicate(timeout=DEADLINE_S)  # closes its standard input
    assert (output, process.returncode) == ("stopping\nstopped\n", 0)


def test_without_a_supervisor_the_input_does_not_matter(start: Start) -> None:
    """A service in the background of a shell has none."""
    process = start(supervised=False)
    assert process.stdin is not None
    process.stdin.close()
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.3)
    process.send_signal(signal.SIGINT)
    assert process.wait(DEADLINE_S) == 0
