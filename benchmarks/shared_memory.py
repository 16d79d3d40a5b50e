"""What Zenoh's shared memory would save on one machine: the processor time of a rollout's way, with and without it.

    python -m benchmarks.shared_memory
    python -m benchmarks.shared_memory --task hopper --messages 100 --rounds 5

Two processes, connected over loopback as actor and learner are: one asks with a payload as large as a rollout of the
task, the other takes the bytes and answers. Once the payload goes through the socket, as in the product, once through
shared memory, in turns. Processor time of both together, which other load changes less than the clock. It
also says whether Zenoh's limit on the size of a message holds for shared memory, and what a killed sender leaves behind
in /dev/shm.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import zenoh
from zenoh import shm

from common.wire.endpoint import free_port

KEY = "benchmark/rollout"
TIMEOUT_S = 60.0
SEGMENTS = Path("/dev/shm")


def open_session(shared: bool, listen: Sequence[str] = (), connect: Sequence[str] = (), limit: int = 2**30) -> Any:
    """A session of Zenoh as in the product, but with or without shared memory. `limit`: bytes of a message."""
    settings = {
        "mode": "peer",
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": shared,
        "transport/link/rx/max_message_size": limit,
    }
    config = zenoh.Config()
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


def receive(endpoint: str, shared: bool, limit: int) -> None:
    """Take payloads until the standard input ends; prints processor milliseconds of each, and how it came."""
    taken, ways = 0, set()

    def on_query(query: Any) -> None:
        nonlocal taken
        with query:
            ways.add("shared memory" if query.payload.as_shm() is not None else "socket")
            query.payload.to_bytes()
            taken += 1
            query.reply(KEY, b"accepted")

    with open_session(shared, listen=[endpoint], limit=limit) as session:
        session.declare_queryable(KEY, on_query)
        print("listening", flush=True)
        sys.stdin.readline()  # the first message is answered
        before, began_s = taken, time.process_time()
        sys.stdin.readline()
        used_s = time.process_time() - began_s
        print(json.dumps({"ms": 1e3 * used_s / max(1, taken - before), "ways": sorted(ways)}), flush=True)


class Sender:
    """A connection to a receiver in a process of its own."""

    def __init__(self, shared: bool, size: int, limit: int = 2**30) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        words = ["--receive", self.endpoint, "--limit", str(limit), *(["--shared"] if shared else [])]
        self._receiver = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.shared_memory", *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._receiver.stdin is not None
        assert self._receiver.stdout is not None
        self._in, self._out = self._receiver.stdin, self._receiver.stdout
        assert self._out.readline() == "listening\n"
        self._session = open_session(shared, connect=[self.endpoint])
        self._provider = shm.ShmProvider.default_backend(3 * size) if shared else None
        self._payload = os.urandom(size)

    def send(self, timeout_s: float = TIMEOUT_S) -> bool:
        """Send the payload once; True if it was answered."""
        payload: Any = self._payload
        if self._provider is not None:
            payload = self._provider.alloc(len(self._payload), shm.BlockOn(shm.GarbageCollect()))
            payload[:] = self._payload
        return any(reply.ok for reply in self._session.get(KEY, payload=zenoh.ZBytes(payload), timeout=timeout_s))

    def connect(self) -> None:
        """Send until the first answer. Raises TimeoutError."""
        deadline = time.monotonic() + TIMEOUT_S
        while not self.send():
            if time.monotonic() > deadline:
                raise TimeoutError("the receiver does not answer")

    def measure(self, messages: int) -> dict[str, Any]:
        """Processor milliseconds of a message: "sender", "receiver"; and "ways", how payloads arrived."""
        self._next()
        began_s = time.process_time()
        answered = all([self.send() for _ in range(messages)])
        used_s = time.process_time() - began_s
        assert answered
        self._next()
        found = json.loads(self._out.readline())
        return {"sender": 1e3 * used_s / messages, "receiver": found["ms"], "ways": found["ways"]}

    def close(self) -> None:
        self._session.close()
        self._receiver.kill()
        self._receiver.wait()
        self._in.close()
        self._out.close()

    def _next(self) -> None:
        self._in.write("\n")
        self._in.flush()


def measure(shared: bool, size: int, messages: int) -> dict[str, Any]:
    """As `Sender.measure`, on a connection of its own."""
    sender = Sender(shared, size)
    try:
        sender.connect()
        return sender.measure(messages)
    finally:
        sender.close()


def passes_the_limit(size: int) -> bool:
    """True if a payload in shared memory reaches a receiver whose limit is a tenth of it."""
    sender = Sender(True, size, limit=size // 10)
    try:
        return any(sender.send(5.0) for _ in range(3))
    finally:
        sender.close()


def left_by_a_killed_sender(size: int) -> int:
    """Bytes in /dev/shm after the sender of a message was killed."""
    words = [sys.executable, "-m", "benchmarks.shared_memory", "--die", str(size)]
    before = {path.name for path in SEGMENTS.iterdir()}
    ended = subprocess.run(words, check=False).returncode
    assert ended == -signal.SIGKILL
    return sum(path.stat().st_size for path in SEGMENTS.iterdir() if path.name not in before)


def die(size: int) -> None:
    """Allocate as a sender does, and be killed."""
    open_session(True)
    held = shm.ShmProvider.default_backend(3 * size).alloc(size)
    held[:] = bytes(size)
    os.kill(os.getpid(), signal.SIGKILL)


def main(arguments: Sequence[str] | None = None) -> int:
    given = _parser().parse_args(arguments)
    if given.receive:
        receive(given.receive, given.shared, given.limit)
        return 0
    if given.die:
        die(given.die)
    # Only here: the processes that are measured need neither JAX nor settings.
    from benchmarks.machine import describe, machine
    from common.config.settings import RunSettings
    from common.runs.rollout_shape import rollout_shape

    settings = RunSettings.model_validate(
        {"task": given.task, "actors": 1, "num_envs": given.num_envs, "num_steps": 10}
    )
    size = given.size or rollout_shape(settings).max_bytes
    rounds = [{way: measure(way, size, given.messages) for way in (False, True)} for _ in range(given.rounds)]
    for line in (*describe(machine()), ""):
        print(line)
    print(f"{given.task}: payloads of {size:,} bytes, {given.messages} in each round\n")
    print("| CPU ms a message, median of rounds | sender | receiver | together |\n|---|---|---|---|")
    for way, name in ((False, "socket"), (True, "shared memory")):
        assert all(name in each[way]["ways"] for each in rounds)
        sender, receiver = (statistics.median(each[way][side] for each in rounds) for side in ("sender", "receiver"))
        print(f"| {name} | {sender:.1f} | {receiver:.1f} | {sender + receiver:.1f} |")
    holds = "does NOT hold" if passes_the_limit(size) else "holds"
    print(f"\nZenoh's limit on the size of a message {holds} for shared memory")
    print(f"a killed sender leaves {left_by_a_killed_sender(size):,} bytes in {SEGMENTS}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.shared_memory",
        description="The processor time of a rollout's way through a socket and through Zenoh's shared memory.",
        allow_abbrev=False,
    )
    parser.add_argument("--task", default="humanoid", help="the task whose rollouts are as large (default: humanoid)")
    parser.add_argument("--num-envs", type=int, default=2048, metavar="N", help="environments (default: 2048)")
    parser.add_argument("--size", type=int, metavar="BYTES", help="of a payload, in place of the task's")
    parser.add_argument("--messages", type=int, default=20, metavar="N", help="messages of a round (default: 20)")
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="rounds, in turns (default: 3)")
    parser.add_argument("--receive", help=argparse.SUPPRESS)
    parser.add_argument("--die", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--limit", type=int, default=2**30, help=argparse.SUPPRESS)
    parser.add_argument("--shared", action="store_true", help=argparse.SUPPRESS)
    return parser


if __name__ == "__main__":
    sys.exit(main())
