"""`reskpn replay`: what can be made of a recorded run, from its log alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from common.config.settings import RunSettings, TransportSettings
from common.errors import INTERRUPTED, SettingsError
from common.runs.directory import SUMMARY, claim_run_dir, default_run_dir
from common.runs.origins import bits_can_differ, differences, origin
from common.runs.read_ahead import read_ahead
from common.runs.recorded_run import RecordedRun, open_run

LINES = 10
"""Lines of metrics that are printed while a second learner trains."""

DIVERGED = 1
"""Exit code of a verification that did not come by the recorded states."""


def verify_run(path: Path, until: int | None) -> int:
    """Re-execute the learner of a recorded run, and print whether every state came out as recorded.

    Returns 0 where all agree, else 1. Raises ReskpnError where the log cannot be verified.
    """
    from common.runtime import enable_compilation_cache, hardware, software_versions, source_commit
    from reskpn.commands.verdicts import describe_verdict
    from services.learner.training.trainer import Trainer
    from services.replay.verify import verify

    run = open_run(path)
    total = updates_to_read(run, until)
    enable_compilation_cache()
    found = differences(run.origins(), origin(source_commit(), software_versions(), hardware()))
    trainer = Trainer(run.settings)
    print(f"{run.run}: verifying {total} updates of {run.settings.learner} on {run.settings.task}", flush=True)
    trainer.compile()
    with progress_bar() as bar, read_ahead(run.updates(until=until)) as updates:
        task = bar.add_task("verifying", total=total)
        verdict = verify(
            updates, trainer, allow_other_bits=bits_can_differ(found), on_update=lambda _: bar.advance(task)
        )
    for line in (*describe_torn(run), *describe_verdict(verdict, found)):
        print(line)
    return 0 if verdict.agrees else DIVERGED


def extract_run(path: Path, folder: Path) -> int:
    """Write a recorded run as Parquet files into `folder`, and print what they hold. Returns 0."""
    from common.runs.tables import extract

    run = open_run(path)
    total = updates_to_read(run, None)
    with progress_bar() as bar:
        task = bar.add_task("extracting", total=total)
        rows = extract(run, folder, lambda _: bar.advance(task))
    for line in describe_torn(run):
        print(line)
    for name, count in rows.items():
        print(f"{folder / name}: {count:,} rows")
    return 0


def train_into(path: Path, choose: Callable[[RunSettings], RunSettings]) -> int:
    """Train another learner on the experience of a recorded run, and print its metrics. Returns 0.

    Args:
        choose: makes its settings out of those of the run.
    """
    from common.runtime import enable_compilation_cache
    from services.learner.training.trainer import Trainer
    from services.replay.offline import require_same_rollouts, train_offline

    run = open_run(path)
    total = updates_to_read(run, None)
    settings = choose(run.settings)
    require_same_rollouts(run.settings, settings)
    settings = settings.model_copy(update={"run_dir": settings.run_dir or default_run_dir(settings)})
    claim_run_dir(settings)
    enable_compilation_cache()
    trainer = Trainer(settings)
    print(f"{run.run}: training {settings.learner} on its {total} updates of experience", flush=True)
    trainer.compile()
    with progress_bar() as bar, read_ahead(run.updates()) as updates:
        task = bar.add_task("training", total=total)

        def on_update(version: int, metrics: dict[str, float]) -> None:
            bar.advance(task)
            if version % max(1, total // LINES) == 0 or version == total:
                numbers = " | ".join(f"{name} {value:.4g}" for name, value in sorted(metrics.items()))
                print(f"update {version}/{total} | {numbers}", flush=True)

        run_dir = train_offline(run.run, settings, trainer, updates, on_update)
    print(f"state digest {trainer.digest()}; summary {run_dir / SUMMARY}, curves {run_dir / 'tensorboard'}")
    return 0


def publish_run(path: Path, transport: TransportSettings, rate: float | None, delay_s: float) -> int:
    """Play a recorded run on the keys it had. Returns 0, or 130 where it was stopped by a signal.

    Raises:
        SettingsError: other machines reach the endpoint, it asks nobody who he is, and `insecure` was not said.
    """
    from common.wire.credentials import Credentials
    from common.wire.listener import require_authentication
    from reskpn.supervision.stopping import stopping
    from services.replay.service import run_player

    run = open_run(path)
    total = updates_to_read(run, None)
    endpoint, credentials = transport.endpoint, Credentials.of(transport)
    require_authentication(transport, as_options=True)
    pace = "as fast as possible" if rate is None else f"at {rate:g} times its pace"
    print(f"{run.run}: playing {total} updates {pace}; listening on {endpoint}", flush=True)
    with stopping(supervised=False) as stop, progress_bar() as bar:
        task = bar.add_task("playing", total=total)
        ended = run_player(
            run,
            endpoint,
            credentials=credentials,
            rate=rate,
            delay_s=delay_s,
            stop=stop,
            on_update=lambda _: bar.advance(task),
        )
    print(f"{run.run}: {'played to the end' if ended else 'stopped'}")
    return 0 if ended else INTERRUPTED


def updates_to_read(run: RecordedRun, until: int | None) -> int:
    """How many updates there are up to version `until`.

    Raises:
        SettingsError: there is no update, or none with that version.
    """
    total = run.count_updates()
    if not total:
        raise SettingsError(f"{run.path}: the log holds no update yet; there is nothing to replay")
    if until is not None and not 1 <= until <= total:
        raise SettingsError(f"--until {until}: the log of {run.run} has updates 1 to {total}; give one of them")
    return total if until is None else until


def describe_torn(run: RecordedRun) -> list[str]:
    """A line for each segment without an end."""
    return [
        f"{torn.path} has no end: its run was killed or goes on; {torn.dropped_bytes:,} bytes of an incomplete record "
        "were left out"
        for torn in run.torn
    ]


def progress_bar() -> Progress:
    """A bar on the screen, beside what is printed; nothing of it where there is no screen."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True, highlight=False),
        transient=True,
    )
