"""`reskpn train`: one learner and its actors as processes of this machine, started and stopped together."""

from __future__ import annotations

import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

from common.config.settings import RunSettings
from common.config.trackers import require_trackers
from common.device_memory import require_room
from common.errors import SettingsError
from common.log.lock import LogLock
from common.output import say
from common.runs.directory import claim_run_dir, default_run_dir
from common.trace_plan import TracePlan
from common.wire.endpoint import free_port
from reskpn.supervision import processes
from reskpn.supervision.actors import ActorSupervisor
from reskpn.supervision.live_page import live_page
from reskpn.supervision.stopping import stopping

POLL_S = 0.1


def train(
    settings: RunSettings,
    *,
    resume: LogLock | None = None,
    skip_batch: bool = False,
    origin: str | None = None,
    page: bool = False,
    trace: TracePlan | None = None,
) -> int:
    """Run to the end and return the learner's exit code.

    `resume`: the lock of the unfinished run in `settings.run_dir` to continue, whose settings these are;
    `skip_batch`: without the logged batch of its next update. `origin`: the run, and version, whose state a new run
    begins with. `page`: show the run in the browser. `trace`: the learner's updates to trace.

    Actors are started beside the learner, not after it: all of them take seconds to load.

    Raises:
        SettingsError: the run directory holds another run, or cannot be written.
        ProcessError: an actor cannot be kept alive.
    """
    refuse_certificates(settings)
    require_room(settings)
    require_trackers(settings.track)
    run_dir = settings.run_dir if resume else claim_run_dir(settings)
    how = [] if resume is None else ["--resume", str(run_dir), "--lock-fd", str(resume.fd)]
    how += ["--skip-batch"] if skip_batch else []
    how += [] if origin is None else ["--from", origin]
    how += [] if trace is None else ["--trace", trace.written()]
    settings = resolved(settings.model_copy(update={"run_dir": run_dir}))
    with ExitStack() as stack:
        stop = stack.enter_context(stopping(supervised=False))
        if page:
            stack.enter_context(live_page(settings))
        return supervise(settings, stop=stop, how=how, keep=() if resume is None else (resume.fd,))


def supervise(
    settings: RunSettings,
    *,
    stop: threading.Event | None = None,
    on_poll: Callable[[], None] = lambda: None,
    how: Sequence[str] = (),
    keep: Sequence[int] = (),
    output: int | None = None,
) -> int:
    """Run the learner and the actors of a run whose directory is claimed; returns the learner's exit code.

    An exception from `on_poll`, or KeyboardInterrupt, stops them in good order.

    Args:
        settings: as `resolved` makes them.
        stop: when it is set, the run is stopped and the learner closes its log.
        on_poll: called about ten times a second.
        how: further words of the learner's command line; `keep`: descriptors that it inherits.
        output: descriptor for what the learner prints; None for this process's standard output.

    Raises:
        ProcessError: an actor cannot be kept alive.
    """
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="reskpn-")))
        config = folder / "settings.json"
        config.write_text(settings.model_dump_json())
        command = [*processes.reskpn_command("learner"), "--config", str(config), *how]
        learner = processes.start(command, output=output, keep=keep)
        stack.callback(processes.stop_all, [learner])
        actors = ActorSupervisor(settings)
        stack.callback(actors.stop)
        while learner.poll() is None:
            if stop is not None and stop.is_set():
                processes.ask_to_stop(learner)
            else:
                actors.keep_alive()
            on_poll()
            time.sleep(POLL_S)
        if learner.returncode >= 0:
            return learner.returncode
        say(
            f"the learner was ended by signal {-learner.returncode}; continue with: "
            f"reskpn train --resume {settings.run_dir}",
            sys.stderr,
        )
        return 128 - learner.returncode


def resolved(settings: RunSettings) -> RunSettings:
    """The settings with a run directory, and with a free port where no endpoint was given."""
    changes: dict[str, object] = {"run_dir": (settings.run_dir or default_run_dir(settings)).absolute()}
    if "endpoint" not in settings.transport.model_fields_set:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        changes["transport"] = settings.transport.model_copy(update={"endpoint": endpoint})
    return settings.model_copy(update=changes)


def refuse_certificates(settings: RunSettings) -> None:
    """SettingsError for certificates: they are one process's, and a learner's do not allow it to work as an actor."""
    if settings.transport.certificates is not None:
        raise SettingsError(
            "transport.certificates belong to one process, and train starts several: use `reskpn learner` and "
            "`reskpn actor`, each with its own, or leave them out, since train needs none on this machine"
        )
