"""The learner as a process: opens log, session and display, runs, and leaves a summary."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from common.config.settings import RunSettings
from common.config.trackers import require_trackers
from common.engine_names import MJX
from common.errors import INTERRUPTED, ReskpnError
from common.log.lock import LogLock
from common.log.segments import LOG_DIRECTORY
from common.memory import keep_large_blocks
from common.physics.mjx_differences import differences_of
from common.runs.directory import SUMMARY, claim_run_dir, write_settings
from common.runtime import enable_compilation_cache
from common.tasks import slug
from common.trace_plan import TracePlan
from common.wire.listener import make_listener_monitor, require_authentication
from common.wire.session import Session
from services.learner.endpoints.health_port import Readiness, health_port
from services.learner.endpoints.hub import Hub
from services.learner.endpoints.listening import open_listener
from services.learner.endpoints.resuming import ResumingEndpoints
from services.learner.endpoints.sizes import check_rollout_size
from services.learner.loop import TrainingLoop
from services.learner.reporting.curves import points_of_evaluation, restore_points
from services.learner.reporting.outlets import Beginning, Outlets, open_outlets
from services.learner.reporting.summary import conclude, describe, final_motions, final_record, summarise
from services.learner.reporting.trace import TRACE, UpdateTrace
from services.learner.resume.numerical_origin import adopt_numerical_origin
from services.learner.resume.origin import Origin, begin_from
from services.learner.resume.plan import Resumption, chain_of, plan_resumption, recorded_id
from services.learner.resume.resumed_replay import ResumedReplay
from services.learner.resume.retention import checkpoints_to_keep
from services.learner.training.checkpoints import Checkpoints
from services.learner.training.snapshots import make_snapshot
from services.learner.training.trainer import Trainer


def run_learner(
    settings: RunSettings,
    *,
    stop: threading.Event,
    resume: bool = False,
    skip_batch: bool = False,
    lock: LogLock | None = None,
    origin: Origin | None = None,
    trace: TracePlan | None = None,
) -> int:
    """Serve one run to its end, in this process. Returns the exit code: 0, or 130 where `stop` was set.

    Args:
        resume: go on with the unfinished run in `settings.run_dir`, whose settings these are.
        skip_batch: go on without the logged batch of its next update.
        lock: of the run's log, where the caller holds it.
        origin: the state that a new run begins with.
        trace: the updates to trace.

    Raises:
        ReskpnError: anything that keeps the run from going on. The log is complete and closed then.
    """
    began_s = time.monotonic()
    require_authentication(settings.transport)
    require_trackers(settings.track)
    check_rollout_size(settings)
    keep_large_blocks()
    with ExitStack() as stack:
        listener = stack.enter_context(make_listener_monitor(settings.transport))
        session = stack.enter_context(open_listener(settings.transport))
        notes = adopt_numerical_origin(settings.run_dir if resume else None)
        enable_compilation_cache()
        readiness = stack.enter_context(health_port(settings.transport.health_port))
        resuming = _begin_to_resume(settings, session, readiness) if resume else None
        trainer = Trainer(settings)
        if origin is not None:
            begin_from(origin, trainer)
        # Only now: an address in use or a state that does not fit leaves no directory behind that looks like a run.
        run_dir = settings.run_dir if resume else claim_run_dir(settings)
        assert run_dir is not None
        lock = lock or stack.enter_context(LogLock(run_dir / LOG_DIRECTORY))
        resumption = None if resuming is None else _resume(settings, run_dir, lock, resuming, skip_batch=skip_batch)
        write_settings(run_dir, settings)
        resumption = resumption or _new_run(settings, origin, chain_of(run_dir))
        if resumption.arrays is not None:
            trainer.restore(resumption.arrays)
        beginning = None if origin is None else _beginning(origin, resumption.run, trainer)
        outlets = stack.enter_context(_outlets(settings, run_dir, stop, resumption, lock, beginning))
        _announce(settings, outlets, "resumed" if resume else "began_from", [*notes, *resumption.notes])
        restore_points(outlets.scalars, run_dir)
        hub = _make_hub(settings, session, outlets, resumption, resuming)
        listener.watch(session, hub.connection_refused)
        readiness.serve(resumption.run, hub.is_open)
        replay = ResumedReplay(hub, resumption, outlets.events.add)
        checkpoints = Checkpoints(resumption.run, run_dir, checkpoints_to_keep(settings))
        traced = UpdateTrace(trace, run_dir / TRACE, outlets.events.add)
        loop = TrainingLoop(settings, trainer, hub, outlets, checkpoints, replay, stop, traced)
        summary = _run_to_its_end(settings, loop, outlets, replay, checkpoints, began_s)
        _show_summary(summary, outlets, run_dir)
    return 0 if summary["complete"] else INTERRUPTED


def _announce(settings: RunSettings, outlets: Outlets, name: str, notes: list[str]) -> None:
    """Tell what the run begins with, and what MJX simulates otherwise if the run is to use it."""
    for difference in differences_of(settings.task) if settings.physics == MJX else ():
        outlets.events.add("warning", "mjx_differs", f"physics mjx simulates another model: {difference}")
    for note in notes:
        outlets.events.add("info", name, note)


def _show_summary(summary: dict[str, Any], outlets: Outlets, run_dir: Path) -> None:
    """Show the summary in place of the display. Raises what ended the log, if anything did."""
    if outlets.failures:
        raise outlets.failures[0]
    outlets.display.close()
    for line in describe(summary, run_dir):
        outlets.display.note(line)


def _begin_to_resume(settings: RunSettings, session: Session, readiness: Readiness) -> ResumingEndpoints:
    """Answer status, joins and health checks from now on, though nobody can be taken before the log is read."""
    assert settings.run_dir is not None
    resuming = ResumingEndpoints(recorded_id(settings.run_dir), settings, session)
    readiness.resume(lambda: resuming.text)
    return resuming


def _make_hub(
    settings: RunSettings,
    session: Session,
    outlets: Outlets,
    resumption: Resumption,
    resuming: ResumingEndpoints | None,
) -> Hub:
    return Hub(
        resumption.run,
        settings,
        session,
        outlets.log,
        outlets.events.add,
        starts=resumption.starts,
        logged_environments=resumption.logged_environments,
        serve=None if resuming is None else resuming.hand_over,
        logged_records=resumption.logged_records,
    )


def _run_to_its_end(
    settings: RunSettings,
    loop: TrainingLoop,
    outlets: Outlets,
    replay: ResumedReplay,
    checkpoints: Checkpoints,
    began_s: float,
) -> dict[str, Any]:
    """Train, evaluate, conclude and dismiss the actors; returns the summary, which is written unless the log failed."""
    run, run_dir = checkpoints.run, checkpoints.run_dir
    try:
        evaluation = loop.evaluate() if loop.train() else None
        summary = summarise(settings, run_dir, run, loop.outcome, evaluation, time.monotonic() - began_s)
        if not outlets.failures:
            # Before the actors are dismissed: a learner that is killed while it concludes needs them when resumed.
            logged = evaluation is None or replay.holds("/eval", evaluation.version)
            record = None if evaluation is None else final_record(evaluation, loop.env_steps)
            outlets.scalars.add(loop.env_steps, {} if record is None else points_of_evaluation(record))
            motions = None if evaluation is None else final_motions(evaluation)
            conclude(run_dir, outlets.log, summary, None if logged else record, motions)
            loop.draw_evaluations()
    except ReskpnError as error:
        outlets.events.log("error", "run_failed", str(error))  # the command line prints it
        raise
    finally:
        loop.dismiss()
    return summary


def _resume(
    settings: RunSettings, run_dir: Path, lock: LogLock, resuming: ResumingEndpoints, *, skip_batch: bool
) -> Resumption | None:
    resumption = plan_resumption(settings, run_dir, lock, skip_batch=skip_batch, on_read=resuming.read)
    resuming.restoring()
    (run_dir / SUMMARY).unlink(missing_ok=True)  # of a run that was stopped: it is not over
    return resumption


def _new_run(settings: RunSettings, origin: Origin | None, chain: str) -> Resumption:
    run = f"{slug(settings.task)}-{settings.learner}-s{settings.seed}-{secrets.token_hex(3)}"
    if origin is None:
        return Resumption(run, chain=chain)
    note = f"begins with the state of {origin.run} at version {origin.version}, digest {origin.digest}"
    return Resumption(run, notes=[note], chain=chain)


@contextmanager
def _outlets(
    settings: RunSettings,
    run_dir: Path,
    stop: threading.Event,
    resumption: Resumption,
    lock: LogLock,
    beginning: Beginning | None,
) -> Iterator[Outlets]:
    """The outlets of the run, and in its log the batch that is set aside from now on."""
    run, chain, tally = resumption.run, resumption.chain, resumption.tally
    with open_outlets(
        run, settings, run_dir, stop, chain=chain, tally=tally, lock=lock, beginning=beginning
    ) as outlets:
        if resumption.set_aside is not None:
            outlets.log.write("/set_aside", resumption.set_aside)
        yield outlets


def _beginning(origin: Origin, run: str, trainer: Trainer) -> Beginning:
    return Beginning(origin.record, make_snapshot(run, 0, trainer.state_arrays()))
