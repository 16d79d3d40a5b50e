"""The learner as a process: opens log, session and display, runs, and leaves a summary."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from common.errors import LogWriteError, ReskpnError, SettingsError
from common.log.writer import LogWriter
from common.memory import keep_large_blocks
from common.physics.assets import model_xml
from common.run_directory import SETTINGS, SUMMARY, prepare_run_dir, write_json
from common.runtime import hardware, prepare_jax, software_versions, source_commit
from common.settings import RunSettings
from common.wire.credentials import Credentials
from common.wire.endpoint import is_loopback
from common.wire.messages import Evaluation
from services.learner.again import Again
from services.learner.checkpoints import Checkpoints
from services.learner.display import Display, make_display
from services.learner.door import make_door, open_to_actors
from services.learner.evaluations import OF_THE_RUN, eval_record
from services.learner.evaluations import scalars as evaluation_scalars
from services.learner.hub import Hub
from services.learner.resume import Resumption, resume_run
from services.learner.run import Run
from services.learner.scalars import Scalars
from services.learner.trainer import Trainer

INTERRUPTED = 130
"""Exit code of a run that was asked to stop, as a shell reports Ctrl-C."""


def run_learner(settings: RunSettings, *, stop: threading.Event, resume: bool = False) -> int:
    """Serve one run to its end, in this process. Returns the exit code: 0, or 130 where `stop` was set.

    `resume`: go on with the unfinished run in `settings.run_dir`, whose settings these are.

    Raises:
        ReskpnError: anything that keeps the run from going on. The log is closed and whole then.
    """
    began_s = time.monotonic()
    refuse_open_doors(settings)
    prepare_jax()
    keep_large_blocks()
    with ExitStack() as stack:
        door = stack.enter_context(make_door(settings.transport))
        session = stack.enter_context(open_to_actors(settings.transport))
        # Only now: an address that is in use leaves no directory behind that looks like a run.
        run_dir, resumption = _begin(settings, resume=resume)
        run = resumption.run
        failures: list[LogWriteError] = []

        def on_log_error(error: LogWriteError) -> None:
            failures.append(error)
            stop.set()

        log = stack.enter_context(_open_log(run, settings, run_dir, on_log_error))
        display = make_display(
            f"ResKPN {run}: {settings.learner} on {settings.task}, {settings.updates} updates of "
            f"{settings.batch_size:,} steps\nlistening on {settings.transport.endpoint}; files in {run_dir}"
        )
        stack.callback(display.close)
        events = Events(log, display)
        scalars = Scalars(run_dir / "tensorboard", lambda text: events.add("warning", "curves_ended", text))
        stack.callback(scalars.close)
        for note in resumption.notes:
            events.add("info", "resumed", note)
        environments = resumption.logged_environments
        hub = Hub(run, settings, session, log, events.add, starts=resumption.starts, logged_environments=environments)
        door.watch(session, hub.turned_off)
        trainer = Trainer(settings)
        if resumption.arrays is not None:
            trainer.restore(resumption.arrays)
        again = Again(hub, resumption, events.add)
        checkpoints = Checkpoints(run, run_dir)
        loop = Run(run, settings, trainer, hub, log, display, scalars, stop, checkpoints, again)
        complete, evaluation = False, None
        try:
            complete = loop.train()
            evaluation = loop.evaluate() if complete else None
            if not failures:
                summary = summarise(settings, run_dir, run, loop, evaluation, time.monotonic() - began_s)
                summary["complete"] = complete
                # Before the actors go home: one that is killed while it concludes needs them again.
                logged = evaluation is None or again.holds("/eval", evaluation.version)
                record = None if evaluation is None else final_record(evaluation, loop.env_steps)
                scalars.add(loop.env_steps, {} if record is None else evaluation_scalars(record))
                conclude(run_dir, log, summary, None if logged else record)
                loop.draw_evaluations()
        except ReskpnError as error:
            events.add("error", "run_failed", str(error))
            raise
        finally:
            loop.dismiss()
        if failures:
            raise failures[0]
        display.close()
        for line in describe(summary, run_dir):
            display.note(line)
    return 0 if complete else INTERRUPTED


def conclude(run_dir: Path, log: LogWriter, summary: dict[str, Any], record: dict[str, Any] | None) -> None:
    """Write what says that the run is over: the summary last. `record`: of the evaluation, unless the log has it.

    Raises:
        LogWriteError: the log or the summary cannot be written.
    """
    if record is not None:
        log.write("/eval", record)
    log.flush(timeout_s=60.0)
    try:
        write_json(run_dir / SUMMARY, summary)
    except OSError as error:
        raise LogWriteError(
            f"cannot write {run_dir / SUMMARY}: {error.strerror}. Make room or fix its permissions and resume the run; "
            "its log is whole"
        ) from None


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


class Events:
    """Things that happened to the run: into the log, and onto the screen."""

    def __init__(self, log: LogWriter, display: Display) -> None:
        self._log = log
        self._display = display

    def add(self, level: str, name: str, text: str) -> None:
        self._display.note(f"{level}: {text}" if level != "info" else text)
        try:
            self._log.write("/event", {"level": level, "name": name, "text": text})
        except LogWriteError:
            return  # the log's own failure is what stops the run, and is reported by it


def refuse_open_doors(settings: RunSettings) -> None:
    """SettingsError where other machines reach a learner that does not ask who they are."""
    transport = settings.transport
    known = Credentials.of(transport).authenticate(transport.endpoint)
    if known or is_loopback(transport.endpoint) or transport.insecure:
        return
    raise SettingsError(
        f"transport.endpoint {transport.endpoint} can be reached from other machines and has no authentication; "
        "listen on tcp/127.0.0.1:<port>, or on tls/<host>:<port> with --transport.certificates (`reskpn certs` makes "
        "them), or give --transport.users, or say --transport.insecure true if the network is trusted"
    )


def _open_log(run: str, settings: RunSettings, run_dir: Path, on_error: Any) -> LogWriter:
    versions = software_versions()
    commit = source_commit()
    log = LogWriter(
        run_dir / "log",
        segment_bytes=settings.log.segment_bytes,
        compression=settings.log.compression,
        metadata={
            "run": {"run": run, "commit": commit},
            "settings": {"json": settings.model_dump_json()},
            "versions": versions,
            "hardware": hardware(),
        },
        attachments={f"{settings.task}.xml": ("application/xml", model_xml(settings.task).encode())},
        on_error=on_error,
    )
    spec = {"run": run, "commit": commit, "settings": settings.model_dump(mode="json"), "versions": versions}
    log.write("/spec", spec)
    return log


def summarise(
    settings: RunSettings, run_dir: Path, run: str, loop: Run, evaluation: Evaluation | None, wall_s: float
) -> dict[str, Any]:
    """The run in one JSON object; evaluation figures are null where none took place."""
    returns = None if evaluation is None else evaluation.episode_return
    return {
        "run": run,
        "task": settings.task,
        "learner": settings.learner,
        "physics": "+".join(sorted(loop.physics)) or settings.physics,
        "seed": settings.seed,
        "actors": settings.actors,
        "total_steps": loop.env_steps,
        "updates": loop.env_steps // settings.batch_size,
        "wall_s": round(wall_s, 3),
        "env_steps_per_s": loop.steps_per_s,
        "train_return_mean": loop.returns.late,
        "train_episodes": loop.returns.episodes,
        "eval_return_mean": None if returns is None else float(returns.mean()),
        "eval_return_std": None if returns is None else float(returns.std()),
        "eval_episodes": 0 if returns is None else len(returns),
        "state_digest": loop.digest,
        "log": str(run_dir / "log"),
    }


def describe(summary: dict[str, Any], run_dir: Path) -> Iterator[str]:
    """The summary for a person."""
    state = "finished" if summary["complete"] else "stopped early; the log is whole up to here"
    speed = summary["env_steps_per_s"]
    yield f"{summary['run']}: {state}"
    yield (
        f"  {summary['total_steps']:,} steps in {summary['updates']} updates, {summary['wall_s']:.0f} s in all"
        + (f", {speed:,.0f} steps/s while training" if speed else "")
    )
    if summary["train_return_mean"] is not None:
        yield f"  training return over the last tenth: {summary['train_return_mean']:,.1f}"
    if summary["eval_episodes"]:
        yield (
            f"  evaluation: {summary['eval_return_mean']:,.1f} ± {summary['eval_return_std']:,.1f} "
            f"over {summary['eval_episodes']} episodes with the deterministic policy"
        )
    yield f"  state digest {summary['state_digest']}"
    yield f"  log {summary['log']}, summary {run_dir / SUMMARY}, curves {run_dir / 'tensorboard'}"


def final_record(evaluation: Evaluation, env_steps: int) -> dict[str, Any]:
    """The run's own evaluation at its end, as `/eval` has it."""
    returns, lengths = evaluation.episode_return, evaluation.episode_length
    return eval_record(evaluation.version, env_steps, returns, lengths, source=OF_THE_RUN, behind=0)
