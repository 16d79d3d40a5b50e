"""`reskpn train`: one learner and its actors as processes of this machine, started and stopped together."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from common.config.settings import RunSettings
from common.config.sources import OTHER_VARIABLES, PREFIX
from common.errors import PhysicsError, ProcessError, RefusedError, SettingsError
from common.runs.directory import claim_run_dir, default_run_dir
from common.wire.endpoint import free_port
from reskpn.supervision.stopping import stopping

POLL_S = 0.1
GRACE_S = 20.0
"""How long a process that was asked to stop may take before it is killed."""

QUICK_S = 30.0
QUICK_DEATHS = 3
"""An actor that dies this often within this time of its start will not get better by starting again."""

HOPELESS = {SettingsError.exit_code, RefusedError.exit_code, PhysicsError.exit_code}
"""Exit codes of an actor that would only fail the same way again."""


def train(settings: RunSettings, *, resume: bool = False) -> int:
    """Run to the end and return the learner's exit code.

    `resume`: go on with the unfinished run in `settings.run_dir`, whose settings these are.

    Actors are started beside the learner, not after it: all of them take seconds to load.

    Raises:
        SettingsError: the run directory holds another run, or cannot be written.
        ProcessError: an actor cannot be kept alive.
    """
    _refuse_certificates(settings)
    settings = resolved(settings)
    run_dir = settings.run_dir if resume else claim_run_dir(settings)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="reskpn-")))
        config = folder / "settings.json"
        config.write_text(settings.model_dump_json())
        stop = stack.enter_context(stopping(supervised=False))
        how = ["--resume", str(run_dir)] if resume else []
        learner = _start([*_reskpn("learner"), "--config", str(config), *how])
        stack.callback(_end, [learner])
        crew = ActorSupervisor(settings)
        stack.callback(crew.end)
        while learner.poll() is None:
            if stop.is_set():
                _ask_to_stop(learner)
            else:
                crew.keep_up()
            time.sleep(POLL_S)
        if learner.returncode >= 0:
            return learner.returncode
        print(
            f"the learner was ended by signal {-learner.returncode}; go on with: reskpn train --resume {run_dir}",
            file=sys.stderr,
            flush=True,
        )
        return 128 - learner.returncode


def _refuse_certificates(settings: RunSettings) -> None:
    """A process has one name; a learner's has no right to work as an actor."""
    if settings.transport.certificates is not None:
        raise SettingsError(
            "transport.certificates are those of one process, and train starts several: use `reskpn learner` and "
            "`reskpn actor`, each with its own, or leave them out, since train needs none on this machine"
        )


def resolved(settings: RunSettings) -> RunSettings:
    """The settings with a run directory, and a free port where none was asked for."""
    changes: dict[str, object] = {"run_dir": (settings.run_dir or default_run_dir(settings)).absolute()}
    if "endpoint" not in settings.transport.model_fields_set:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        changes["transport"] = settings.transport.model_copy(update={"endpoint": endpoint})
    return settings.model_copy(update=changes)


@dataclass
class ActorProcess:
    """One actor's place, and the process that is in it."""

    number: int
    process: subprocess.Popen[bytes] | None = None
    started_s: float = 0.0
    quick_deaths: int = 0


@dataclass
class ActorSupervisor:
    """The actors: started, started again when they die."""

    settings: RunSettings
    posts: list[ActorProcess] = field(init=False)

    def __post_init__(self) -> None:
        self.posts = [ActorProcess(number) for number in range(self.settings.actors)]

    def keep_up(self) -> None:
        """Start every actor that is not running, unless it has left because the run is over.

        Raises:
            ProcessError: an actor fails for good; its last words are in the message.
        """
        for post in self.posts:
            if post.process is None:
                self._start(post)
            elif post.process.poll() not in (None, 0):
                self._bury(post, post.process.returncode)
                self._start(post)

    def end(self) -> None:
        _end([post.process for post in self.posts if post.process is not None])

    @property
    def _run_dir(self) -> Path:
        assert self.settings.run_dir is not None
        return self.settings.run_dir

    def _words(self, post: ActorProcess) -> Path:
        return self._run_dir / "processes" / f"actor-{post.number}.txt"

    def _start(self, post: ActorProcess) -> None:
        self._words(post).parent.mkdir(exist_ok=True)
        threads = max(1, len(os.sched_getaffinity(0)) // self.settings.actors)
        transport = self.settings.transport
        command = [*_reskpn("actor"), "--endpoint", transport.endpoint, "--threads", str(threads)]
        if transport.users is not None:
            command += ["--users", str(transport.users)]
        with self._words(post).open("ab") as words:
            post.process = _start(command, output=words.fileno())
        post.started_s = time.monotonic()

    def _bury(self, post: ActorProcess, code: int) -> None:
        quick = time.monotonic() - post.started_s < QUICK_S
        post.quick_deaths = post.quick_deaths + 1 if quick else 0
        if post.process is not None:
            _ask_to_stop(post.process)  # closes what is left of it here
        how = f"exit code {code}" if code >= 0 else f"signal {-code}"
        if code in HOPELESS or post.quick_deaths >= QUICK_DEATHS:
            last = self._words(post).read_text(errors="replace").strip().splitlines()[-5:]
            raise ProcessError(
                f"actor {post.number} ended with {how} and will not recover; its last words ({self._words(post)}):\n"
                + "\n".join(f"  {line}" for line in last)
            )
        print(f"actor {post.number} ended with {how}; starting it again", file=sys.stderr, flush=True)


def _reskpn(command: str) -> list[str]:
    return [sys.executable, "-m", "reskpn", command, "--supervised"]


def _start(command: Sequence[str], output: int | None = None) -> subprocess.Popen[bytes]:
    """Start a process that stops when its standard input ends, out of reach of the terminal's Ctrl-C."""
    return subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=output,
        stderr=subprocess.STDOUT if output is not None else None,
        env=_child_environment(os.environ),
        start_new_session=True,
    )


def _child_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment without settings: they are in the file that the child is given, already merged."""
    return {
        name: value for name, value in environment.items() if not name.startswith(PREFIX) or name in OTHER_VARIABLES
    }


def _ask_to_stop(process: subprocess.Popen[bytes]) -> None:
    if process.stdin is not None and not process.stdin.closed:
        process.stdin.close()


def _end(processes: Sequence[subprocess.Popen[bytes]]) -> None:
    """Ask the processes to stop, wait, and kill those that do not."""
    for process in processes:
        _ask_to_stop(process)
    deadline = time.monotonic() + GRACE_S
    for process in processes:
        try:
            process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
