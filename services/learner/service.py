"""The learner as a process: opens log, session and display, runs, and leaves a summary."""

from __future__ import annotations

import secrets
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from common.config.settings import RunSettings
from common.errors import ReskpnError
from common.memory import keep_large_blocks
from common.runs.directory import SETTINGS, SUMMARY, prepare_run_dir, write_json
from common.runtime import prepare_jax
from common.wire.listener import make_listener_monitor, require_authentication
from common.wire.session import Session
from services.learner.endpoints.hub import Hub
from services.learner.endpoints.listening import open_listener
from services.learner.loop import Run
from services.learner.reporting.evaluations import scalars as evaluation_scalars
from services.learner.reporting.outlets import Outlets, open_outlets
from services.learner.reporting.summary import conclude, describe, final_record, summarise
from services.learner.resume.plan import Resumption, resume_run
from services.learner.resume.resumed_replay import ResumedReplay
from services.learner.training.checkpoints import Checkpoints
from services.learner.training.trainer import Trainer

INTERRUPTED = 130
"""Exit code of a run that was asked to stop, as a shell reports Ctrl-C."""


def run_learner(settings: RunSettings, *, stop: threading.Event, resume: bool = False) -> int:
    """Serve one run to its end, in this process. Returns the exit code: 0, or 130 where `stop` was set.

    `resume`: go on with the unfinished run in `settings.run_dir`, whose settings these are.

    Raises:
        ReskpnError: anything that keeps the run from going on. The log is closed and whole then.
    """
    began_s = time.monotonic()
    require_authentication(settings.transport)
    prepare_jax()
    keep_large_blocks()
    with ExitStack() as stack:
        door = stack.enter_context(make_listener_monitor(settings.transport))
        session = stack.enter_context(open_listener(settings.transport))
        # Only now: an address that is in use leaves no directory behind that looks like a run.
        run_dir, resumption = _begin(settings, resume=resume)
        outlets = stack.enter_context(open_outlets(resumption.run, settings, run_dir, stop))
        for note in resumption.notes:
            outlets.events.add("info", "resumed", note)
        hub = _make_hub(settings, session, outlets, resumption)
        door.watch(session, hub.turned_off)
        again = ResumedReplay(hub, resumption, outlets.events.add)
        loop = _make_loop(settings, run_dir, hub, outlets, again, resumption, stop)
        summary = _run_to_its_end(settings, run_dir, loop, outlets, again, resumption.run, began_s)
        if outlets.failures:
            raise outlets.failures[0]
        outlets.display.close()
        for line in describe(summary, run_dir):
            outlets.display.note(line)
    return 0 if summary["complete"] else INTERRUPTED


def _make_hub(settings: RunSettings, session: Session, outlets: Outlets, resumption: Resumption) -> Hub:
    return Hub(
        resumption.run,
        settings,
        session,
        outlets.log,
        outlets.events.add,
        starts=resumption.starts,
        logged_environments=resumption.logged_environments,
    )


def _make_loop(
    settings: RunSettings,
    run_dir: Path,
    hub: Hub,
    outlets: Outlets,
    again: ResumedReplay,
    resumption: Resumption,
    stop: threading.Event,
) -> Run:
    trainer = Trainer(settings)
    if resumption.arrays is not None:
        trainer.restore(resumption.arrays)
    checkpoints = Checkpoints(resumption.run, run_dir)
    return Run(
        resumption.run, settings, trainer, hub, outlets.log, outlets.display, outlets.scalars, stop, checkpoints, again
    )


def _run_to_its_end(
    settings: RunSettings, run_dir: Path, loop: Run, outlets: Outlets, again: ResumedReplay, run: str, began_s: float
) -> dict[str, Any]:
    """Train, evaluate, conclude and send the actors home; the summary, which is kept unless the log has failed."""
    try:
        complete = loop.train()
        evaluation = loop.evaluate() if complete else None
        summary = summarise(settings, run_dir, run, loop, evaluation, time.monotonic() - began_s)
        summary["complete"] = complete
        if not outlets.failures:
            # Before the actors go home: one that is killed while it concludes needs them again.
            logged = evaluation is None or again.holds("/eval", evaluation.version)
            record = None if evaluation is None else final_record(evaluation, loop.env_steps)
            outlets.scalars.add(loop.env_steps, {} if record is None else evaluation_scalars(record))
            conclude(run_dir, outlets.log, summary, None if logged else record)
            loop.draw_evaluations()
    except ReskpnError as error:
        outlets.events.add("error", "run_failed", str(error))
        raise
    finally:
        loop.dismiss()
    return summary


def _begin(settings: RunSettings, *, resume: bool) -> tuple[Path, Resumption]:
    """The run's directory, and what the run goes on from."""
    fresh = Resumption(f"{settings.task}-{settings.learner}-s{settings.seed}-{secrets.token_hex(3)}")
    if not resume:
        return prepare_run_dir(settings), fresh
    assert settings.run_dir is not None
    resumption = resume_run(settings, settings.run_dir)
    write_json(settings.run_dir / SETTINGS, settings.model_dump(mode="json"))
    (settings.run_dir / SUMMARY).unlink(missing_ok=True)  # of a run that was stopped: it is not over
    return settings.run_dir, resumption or fresh
