"""The end of a run: its figures in one file, its last evaluation in the log, and a few lines on the screen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from common.config.settings import RunSettings
from common.errors import LogWriteError
from common.log.segments import LOG_DIRECTORY
from common.log.writer import LogWriter
from common.remedies import remedy
from common.runs.directory import SUMMARY, TENSORBOARD, write_json
from common.wire.messages import Evaluation
from common.wire.motion import Motions, unpack
from services.learner.reporting.evaluations import OF_THE_RUN, eval_record
from services.learner.reporting.statistics import TrainingReturn


@dataclass(frozen=True)
class Outcome:
    """The figures of a run at its end.

    Attributes:
        steps_per_s: environment steps a second while training; None where no update was made of new rollouts.
        physics: engines of the actors.
        digest: of the final state.
    """

    complete: bool
    env_steps: int
    steps_per_s: float | None
    returns: TrainingReturn
    physics: frozenset[str]
    digest: str


def conclude(
    run_dir: Path,
    log: LogWriter,
    summary: dict[str, Any],
    record: dict[str, Any] | None,
    motions: Motions | None = None,
) -> None:
    """Write the records that mark the run as over, the summary last.

    Args:
        record: of the evaluation, unless it is logged.
        motions: of the same evaluation.

    Raises:
        LogWriteError: the log or the summary cannot be written.
    """
    if record is not None:
        # First: where the record is in the log, the motions are, too.
        if motions is not None:
            log.write("/motion", motions.encode())
        log.write("/eval", record)
    log.flush(timeout_s=60.0)
    try:
        write_json(run_dir / SUMMARY, summary)
    except OSError as error:
        raise LogWriteError(
            f"cannot write {run_dir / SUMMARY}: {error.strerror or error}; {remedy(error)}, then resume the run: "
            "its log is complete"
        ) from None


def summarise(
    settings: RunSettings, run_dir: Path, run: str, outcome: Outcome, evaluation: Evaluation | None, wall_s: float
) -> dict[str, Any]:
    """The run in one JSON object; evaluation figures are null where none took place."""
    returns = None if evaluation is None else evaluation.episode_return
    return_mean, return_over = train_return(outcome.returns)
    return {
        "run": run,
        "task": settings.task,
        "learner": settings.learner,
        "physics": "+".join(sorted(outcome.physics)) or settings.physics,
        "seed": settings.seed,
        "actors": settings.actors,
        "total_steps": outcome.env_steps,
        "updates": outcome.env_steps // settings.batch_size,
        "wall_s": round(wall_s, 3),
        "env_steps_per_s": outcome.steps_per_s,
        "train_return_mean": return_mean,
        "train_return_over": return_over,
        "train_episodes": outcome.returns.episodes,
        "eval_return_mean": None if returns is None else float(returns.mean()),
        "eval_return_std": None if returns is None else float(returns.std()),
        "eval_episodes": 0 if returns is None else len(returns),
        "state_digest": outcome.digest,
        "log": str(run_dir / LOG_DIRECTORY),
        "complete": outcome.complete,
    }


def train_return(returns: TrainingReturn) -> tuple[float | None, str | None]:
    """The mean training return and what it is over; where no episode ended at the run's end, as shown during it."""
    if returns.late is not None:
        return returns.late, "last tenth"
    return returns.newest, None if returns.newest is None else "newest episodes"


def describe(summary: dict[str, Any], run_dir: Path) -> Iterator[str]:
    """The summary as lines for the screen."""
    stopped = f"stopped early; the log is complete up to here. Continue with: reskpn train --resume {run_dir}"
    state = "finished" if summary["complete"] else stopped
    speed = summary["env_steps_per_s"]
    yield f"{summary['run']}: {state}"
    yield (
        f"  {summary['total_steps']:,} steps in {summary['updates']} updates, {summary['wall_s']:.0f} s in all"
        + (f", {speed:,.0f} steps/s while training" if speed else "")
    )
    if summary["train_return_mean"] is not None:
        yield f"  training return over the {summary['train_return_over']}: {summary['train_return_mean']:,.1f}"
    if summary["eval_episodes"]:
        yield (
            f"  evaluation: {summary['eval_return_mean']:,.1f} ± {summary['eval_return_std']:,.1f} "
            f"over {summary['eval_episodes']} episodes with the deterministic policy"
        )
    yield f"  state digest {summary['state_digest']}"
    yield f"  log {summary['log']}, summary {run_dir / SUMMARY}, curves {run_dir / TENSORBOARD}"


def final_record(evaluation: Evaluation, env_steps: int) -> dict[str, Any]:
    """The run's own evaluation at its end, as `/eval` has it."""
    returns, lengths = evaluation.episode_return, evaluation.episode_length
    return eval_record(evaluation.version, env_steps, returns, lengths, source=OF_THE_RUN, behind=0)


def final_motions(evaluation: Evaluation) -> Motions | None:
    """The trajectories of the run's own evaluation, as `/motion` has them; None where there are none."""
    motions = unpack(evaluation.motions)
    return None if motions is None else replace(motions, source=OF_THE_RUN)
