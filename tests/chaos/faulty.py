"""`reskpn` with faults in it, in a process of its own: `run(["learner", "--run-dir", ...], faults, output)`.

The program has no hooks for tests: here one of its functions, MODULE:NAME, is wrapped before `reskpn` begins. N counts
its calls from 1; with TEXT only those whose arguments hold it, in Python's notation.

    die before|after MODULE:NAME N [TEXT]    SIGKILL to itself, so that nothing is cleaned up
    tear MODULE:NAME N SIZE                  of the Nth SIZE or more bytes to be written, half, then SIGKILL
    sent MODULE:NAME N [TEXT]                SIGKILL within the call, a moment after it has begun
    hang SECONDS MODULE:NAME N [TEXT]        the call begins so much later
    slow SECONDS MODULE:NAME                 every call does
    jump SECONDS MODULE:NAME N [TEXT]        the wall clock jumps then
    drop N MODULE:NAME                       every call whose number N divides does nothing
    leave MODULE:NAME N [TEXT]               SIGTERM to itself before that call: it ends in good order
    rogue FILE                               an actor that also sends wrong messages (`rogue.py`)
    soak SEED FILE                           an actor that sends mutated messages all the time (`soak.py`)
    small BYTES                              no file may grow larger
"""

from __future__ import annotations

import functools
import importlib
import itertools
import multiprocessing
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

Function = Callable[..., Any]
MOMENT_S = 0.0005


class Clock:
    """The wall clock; to be put in place before any module of the program has a reference to the true one."""

    def __init__(self) -> None:
        self._ahead_s = 0
        self._time, self._time_ns = time.time, time.time_ns

    def install(self) -> None:
        time.time = lambda: self._time() + self._ahead_s
        time.time_ns = lambda: self._time_ns() + self._ahead_s * 10**9

    def jump(self, seconds: int) -> None:
        self._ahead_s += seconds


CLOCK = Clock()


def run(words: Sequence[str], faults: Sequence[str], output: str) -> NoReturn:
    """All that this process does: its output goes to the file, its end is that of `reskpn`."""
    threading.Thread(target=end_with_the_tests, daemon=True).start()
    descriptor = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    for name in [name for name in os.environ if name.startswith("RESKPN_")]:
        del os.environ[name]
    for fault in faults:
        kind, *rest = fault.split()
        KINDS[kind](*rest)
    from reskpn.cli import main

    sys.exit(main(words))


def end_with_the_tests() -> None:
    """However they end: nothing that they have started is left running."""
    tests = multiprocessing.parent_process()
    if tests is not None:
        tests.join()
        os._exit(1)


def die(when: str, target: str, number: str, text: str = "") -> None:
    def around(function: Function, *args: Any, **named: Any) -> Any:
        if when == "after":
            function(*args, **named)
        end_here(f"{when} call {number} of {target} {text}")

    at_call(target, int(number), text, around)


def tear(target: str, number: str, size: str) -> None:
    calls = itertools.count(1)

    def around(function: Function, itself: Any, data: bytes) -> Any:
        if len(data) < int(size) or next(calls) != int(number):
            return function(itself, data)
        function(itself, data[: len(data) // 2])
        end_here(f"within call {number} of {target} with {size} bytes or more")

    wrap(target, around)


def sent(target: str, number: str, text: str = "") -> None:
    def around(function: Function, *args: Any, **named: Any) -> Any:
        threading.Timer(MOMENT_S, end_here, [f"within call {number} of {target} {text}"]).start()
        return function(*args, **named)

    at_call(target, int(number), text, around)


def hang(seconds: str, target: str, number: str, text: str = "") -> None:
    def around(function: Function, *args: Any, **named: Any) -> Any:
        say(f"hangs for {seconds} s before call {number} of {target} {text}")
        time.sleep(float(seconds))
        return function(*args, **named)

    at_call(target, int(number), text, around)


def slow(seconds: str, target: str) -> None:
    def around(function: Function, *args: Any, **named: Any) -> Any:
        time.sleep(float(seconds))
        return function(*args, **named)

    wrap(target, around)


def jump(seconds: str, target: str, number: str, text: str = "") -> None:
    def around(function: Function, *args: Any, **named: Any) -> Any:
        say(f"the clock jumps by {seconds} s at call {number} of {target} {text}")
        CLOCK.jump(int(seconds))
        return function(*args, **named)

    at_call(target, int(number), text, around)


def drop(number: str, target: str) -> None:
    calls = itertools.count(1)

    def around(function: Function, *args: Any, **named: Any) -> Any:
        return None if next(calls) % int(number) == 0 else function(*args, **named)

    wrap(target, around)


def leave(target: str, number: str, text: str = "") -> None:
    def around(function: Function, *args: Any, **named: Any) -> Any:
        say(f"leaves before call {number} of {target} {text}")
        os.kill(os.getpid(), signal.SIGTERM)
        return function(*args, **named)

    at_call(target, int(number), text, around)


def rogue(account: str) -> None:
    from tests.chaos.rogue import Rogue

    wrap("services.actor.link:ActorLink.push", Rogue(Path(account)).push)


def soak(seed: str, account: str) -> None:
    from tests.chaos.soak import SoakingActor

    wrap("services.actor.link:ActorLink.push", SoakingActor(int(seed), Path(account)).push)


def small(size: str) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(size), int(size)))


KINDS: dict[str, Callable[..., None]] = {
    "die": die,
    "tear": tear,
    "sent": sent,
    "hang": hang,
    "slow": slow,
    "jump": jump,
    "drop": drop,
    "leave": leave,
    "rogue": rogue,
    "soak": soak,
    "small": small,
}


def at_call(target: str, number: int, text: str, around: Function) -> None:
    """Have `around(function, *arguments)` called in place of that call, and the function itself for all others."""
    calls = itertools.count(1)

    def counted(function: Function, *args: Any, **named: Any) -> Any:
        if text and text not in repr(args):
            return function(*args, **named)
        return around(function, *args, **named) if next(calls) == number else function(*args, **named)

    wrap(target, counted)


def wrap(target: str, around: Function) -> None:
    module, _, path = target.partition(":")
    *owners, name = path.split(".")
    owner = functools.reduce(getattr, owners, importlib.import_module(module))
    function = getattr(owner, name)

    @functools.wraps(function)
    def wrapped(*args: Any, **named: Any) -> Any:
        return around(function, *args, **named)

    setattr(owner, name, wrapped)


def say(text: str) -> None:
    os.write(1, f"fault: {text}\n".encode())


def end_here(where: str) -> None:
    say(f"dies {where}")
    os.kill(os.getpid(), signal.SIGKILL)
