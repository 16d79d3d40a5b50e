"""The actor processes of `reskpn train`: started, restarted when they die, stopped together."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from common.config.settings import RunSettings
from common.cores import usable_cores
from common.device_memory import worker_environment
from common.errors import PhysicsError, ProcessError, RefusedError, SettingsError
from common.output import say
from common.tasks import is_own
from reskpn.supervision import processes

QUICK_S = 30.0
QUICK_EXITS = 3
"""An actor that exits this often, each time within `QUICK_S` of its start, is not restarted."""

LAST_LINES = 5
"""Lines of an actor's log file that are quoted when it fails for good."""

PERMANENT = {SettingsError.exit_code, RefusedError.exit_code, PhysicsError.exit_code}
"""Exit codes of an actor that would fail in the same way if it were restarted."""


@dataclass
class ActorProcess:
    """One actor's place in the run, and the process that runs there."""

    number: int
    process: subprocess.Popen[bytes] | None = None
    started_s: float = 0.0
    quick_exits: int = 0


@dataclass
class ActorSupervisor:
    """Keeps the actors of a run on this machine alive."""

    settings: RunSettings
    actors: list[ActorProcess] = field(init=False)

    def __post_init__(self) -> None:
        self.actors = [ActorProcess(number) for number in range(self.settings.actors)]

    def keep_alive(self) -> None:
        """Start every actor that is not running, unless it has left because the run is over.

        Raises:
            ProcessError: an actor fails for good; the end of its log file is in the message.
        """
        for actor in self.actors:
            if actor.process is None:
                self._start(actor)
            elif actor.process.poll() not in (None, 0):
                self._on_exit(actor, actor.process)
                self._start(actor)

    def stop(self) -> None:
        """Stop all actors and wait for them."""
        processes.stop_all([actor.process for actor in self.actors if actor.process is not None])

    def log_file(self, actor: ActorProcess) -> Path:
        """The file with all that an actor has printed."""
        assert self.settings.run_dir is not None
        return self.settings.run_dir / "processes" / f"actor-{actor.number}.txt"

    def _start(self, actor: ActorProcess) -> None:
        log_file = self.log_file(actor)
        log_file.parent.mkdir(exist_ok=True)
        threads = max(1, usable_cores() // self.settings.actors)
        transport = self.settings.transport
        command = [
            *processes.reskpn_command("actor"), "--endpoint", transport.endpoint, "--threads", str(threads),
        ]  # fmt: skip
        if is_own(self.settings.task):
            command += ["--task", self.settings.task]
        if transport.users is not None:
            command += ["--users", str(transport.users)]
        with log_file.open("ab") as output:
            actor.process = processes.start(command, output=output.fileno(), environment=self._environment())
        actor.started_s = time.monotonic()

    def _environment(self) -> dict[str, str]:
        return worker_environment(os.environ, self.settings.physics, self.settings.device_memory.actor)

    def _on_exit(self, actor: ActorProcess, process: subprocess.Popen[bytes]) -> None:
        """Count the exit of an actor and tell the user. ProcessError where restarting it would be useless."""
        quick = time.monotonic() - actor.started_s < QUICK_S
        actor.quick_exits = actor.quick_exits + 1 if quick else 0
        processes.ask_to_stop(process)  # closes this side of its standard input
        code = process.returncode
        how = f"exit code {code}" if code >= 0 else f"signal {-code}"
        if code in PERMANENT or actor.quick_exits >= QUICK_EXITS:
            log_file = self.log_file(actor)
            last = log_file.read_text(errors="replace").strip().splitlines()[-LAST_LINES:]
            raise ProcessError(
                f"actor {actor.number} ended with {how} and is not restarted; the end of its log file ({log_file}):\n"
                + "\n".join(f"  {line}" for line in last)
            )
        say(f"actor {actor.number} ended with {how}; restarting it", sys.stderr)
