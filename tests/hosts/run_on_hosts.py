"""A run whose learner, actors and viewer are each on a host of their own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from network import Network

from common.log.reader import LogReader
from common.wire.rollout import Rollout
from reskpn.authority import make_all

PORT = 7447
DEADLINE_S = 300.0  # everything is compiled first, by three processes at once
SETTINGS = [
    "--task", "inverted_pendulum",
    "--learner", "ppo",
    "--actors", "2",
    "--num-envs", "64",
    "--num-steps", "8",
    "--algorithm.minibatches", "4",
    "--algorithm.epochs", "1",
    "--algorithm.hidden", "[16, 16]",
    "--physics", "native",
    "--total-steps", "1e9",
    "--evaluation.episodes", "0",
]  # fmt: skip


class RunOnHosts:
    """Started when it is entered; it goes on until `finish`. `network` has learner, actor-0, actor-1 and viewer."""

    def __init__(self, network: Network, folder: Path) -> None:
        self.network = network
        self.run_dir = folder / "run"
        self.certificates = folder / "certificates"
        self.endpoint = f"tls/{network.address('learner')}:{PORT}"
        self.processes: dict[str, subprocess.Popen[str]] = {}
        self._folder = folder
        self._changed = threading.Condition()
        self._report: dict[str, Any] = {}
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        make_all(self.certificates, [self.network.address("learner")], days=1)
        learner = [f"--transport.endpoint={self.endpoint}", f"--transport.certificates={self.certificates / 'learner'}"]
        self.start("learner", "learner", ["learner", *learner, "--run-dir", str(self.run_dir), *SETTINGS])
        for host in ("actor-0", "actor-1"):
            self.start(host, host, ["actor", *self.connection("actor"), "--threads", "1"])
        self._watch()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def connection(self, role: str) -> list[str]:
        return ["--endpoint", self.endpoint, "--certificates", str(self.certificates / role)]

    def start(self, name: str, host: str, words: Sequence[str]) -> subprocess.Popen[str]:
        """`reskpn` with those words on a host; what it prints is in a file of that name."""
        command = self.network.on(host, [sys.executable, "-m", "reskpn", *words])
        environment = {key: value for key, value in os.environ.items() if not key.startswith("RESKPN_")}
        with self.words(name).open("w") as words_file:
            process = subprocess.Popen(
                command, stdout=words_file, stderr=subprocess.STDOUT, text=True, env=environment, cwd=Path.cwd()
            )
        self._stack.callback(_end, process)
        self.processes[name] = process
        return process

    def words(self, name: str) -> Path:
        return self._folder / f"{name}.txt"

    def report(self, condition: Callable[[dict[str, Any]], object], what: str) -> dict[str, Any]:
        """The first report from now on of which the condition holds; the learner must be alive meanwhile."""
        end = time.monotonic() + DEADLINE_S
        with self._changed:
            while not (self._report and condition(self._report)):
                assert self.processes["learner"].poll() is None, self.words("learner").read_text()
                left_s = end - time.monotonic()
                assert left_s > 0, f"not in time: {what}; {json.dumps(self._report)}"
                self._changed.wait(min(1.0, left_s))
            return self._report

    def finish(self) -> dict[str, int]:
        """Ask the learner to stop; the exit codes of all."""
        self.processes["learner"].send_signal(signal.SIGINT)
        return {name: process.wait(DEADLINE_S) for name, process in self.processes.items() if name != "viewer"}

    def logged(self) -> tuple[list[tuple[int, str, int]], list[tuple[int, str, int]]]:
        """(slot, incarnation, seq) of the rollouts in the log, and of those that updates used, in their order."""
        reader = LogReader(self.run_dir)
        written = [Rollout.decode(message.data).key for message in reader.messages(["/rollout"])]
        used = [
            (place["slot"], place["incarnation"], place["seq"])
            for message in reader.messages(["/update"])
            for place in message.json()["rollouts"]
        ]
        return written, used

    def _watch(self) -> None:
        """The viewer asks every second. It may do so before there is a learner, and then asks anew."""
        thread = threading.Thread(target=self._follow, daemon=True)
        thread.start()
        self._stack.callback(thread.join)

    def _follow(self) -> None:
        command = [sys.executable, "-m", "reskpn", "status", *self.connection("viewer"), "--watch", "--json"]
        while self.processes["learner"].poll() is None:
            with subprocess.Popen(
                self.network.on("viewer", command), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
            ) as viewer:
                assert viewer.stdout is not None
                for line in viewer.stdout:
                    with self._changed:
                        self._report = json.loads(line)
                        self._changed.notify_all()


def _end(process: subprocess.Popen[str]) -> None:
    if process.poll() is None:
        process.kill()
    process.wait()
