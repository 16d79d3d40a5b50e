"""`reskpn train`: one learner and its actors as processes of this machine, started and stopped together."""

from __future__ import annotations

import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from common.config.settings import RunSettings
from common.config.trackers import require_trackers
from common.errors import SettingsError
from common.log.lock import LogLock
from common.output import say
from common.runs.directory import claim_run_dir, default_run_dir
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
) -> int:
    """Run to the end and return the learner's exit code.

    `resume`: the lock of the unfinished run in `settings.run_dir` to continue, whose settings these are;
    `skip_batch`: without the logged batch of its next update. `origin`: the run, and version, whose state a new run
    begins with. `page`: show the run in the browser.

    Actors are started beside the learner, not after it: all of them take seconds to load.

    Raises:
        SettingsError: the run directory holds another run, or cannot be written.
        ProcessError: an actor cannot be kept alive.
    """
    _refuse_certificates(settings)
    require_trackers(settings.track)
    run_dir = settings.run_dir if resume else claim_run_dir(settings)
    settings = resolved(settings.model_copy(update={"run_dir": run_dir}))
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="reskpn-")))
        config = folder / "settings.json"
        config.write_text(settings.model_dump_json())
        stop = stack.enter_context(stopping(supervised=False))
        if page:
            stack.enter_context(live_page(settings))
        how = [] if resume is None else ["--resume", str(run_dir), "--lock-fd", str(resume.fd)]
        how += ["--skip-batch"] if skip_batch else []
        how += [] if origin is None else ["--from", origin]
        learner = processes.start(
            [*processes.reskpn_command("learner"), "--config", str(config), *how],
            keep=() if resume is None else (resume.fd,),
        )
        stack.callback(processes.stop_all, [learner])
        actors = ActorSupervisor(settings)
        stack.callback(actors.stop)
        while learner.poll() is None:
            if stop.is_set():
                processes.ask_to_stop(learner)
            else:
                actors.keep_alive()
            time.sleep(POLL_S)
        if learner.returncode >= 0:
            return learner.returncode
        say(
            f"the learner was ended by signal {-learner.returncode}; continue with: reskpn train --resume {run_dir}",
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


def _refuse_certificates(settings: RunSettings) -> None:
    """SettingsError for certificates: they are one process's, and a learner's do not allow it to work as an actor."""
    if settings.transport.certificates is not None:
        raise SettingsError(
            "transport.certificates belong to one process, and train starts several: use `reskpn learner` and "
            "`reskpn actor`, each with its own, or leave them out, since train needs none on this machine"
        )
