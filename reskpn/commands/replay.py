"""`reskpn replay`: a recorded run verified, extracted, published or learned from, from its log alone."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from common.config.settings import RunSettings, TransportSettings
from common.errors import INTERRUPTED, SettingsError
from common.log.chain import ChainCheck
from common.log.signatures import Verifier
from common.numerical_environment import adopt, factorise_on_one_thread, numerical_environment
from common.runs.directory import SUMMARY, claim_run_dir
from common.runs.origins import bits_can_differ, differences, origin
from common.runs.read_ahead import read_ahead
from common.runs.recorded_run import RecordedRun, open_run
from common.runs.recorded_updates import RecordedUpdate
from reskpn.commands.command import EXIT_CODES, Command
from reskpn.commands.connection import add_connection, over
from reskpn.commands.progress import progress_bar
from reskpn.commands.settings_options import add_settings, settings_given_over

LINES = 10
"""Lines of metrics that are printed while a second learner trains."""

DIVERGED = 1
"""Exit code of a verification that did not come by the recorded states."""


def verify_run(path: Path, until: int | None, public_key: Path | None = None) -> int:
    """Re-execute the learner of a recorded run, and print whether every record came out as recorded.

    `public_key`: a file; the chain of the log must be signed with its other half.

    Returns 0 where all agree, else 1. Raises ReskpnError where the log cannot be verified.
    """
    from common.runtime import enable_compilation_cache, hardware, software_versions, source_commit
    from common.wire.messages import digest_arrays
    from reskpn.commands.verdicts import describe_audit, describe_retention, describe_verdict
    from services.learner.training.trainer import Trainer
    from services.replay.audit import Audit
    from services.replay.beginning import read_beginning
    from services.replay.verify import verify

    chain = ChainCheck(None if public_key is None else Verifier(public_key))
    run = open_run(path)
    updates_to_read(run, until)
    origins = run.origins()
    for note in adopt(run.metadata().get("environment", {}), origins[0].get("cores", "")):
        print(note)
    enable_compilation_cache()
    found = differences(origins, origin(source_commit(), software_versions(), hardware(), numerical_environment()))
    trainer = Trainer(run.settings)
    begins = read_beginning(run)
    if begins.arrays is not None:
        trainer.restore(begins.arrays)
    total = count_between(run, begins.version, until)
    print(f"{run.run}: verifying {total} updates of {run.settings.learner} on {run.settings.task}", flush=True)
    trainer.compile()
    audit = Audit(run, chain, lambda: digest_arrays(trainer.policy_arrays()), begins)
    with progress_bar() as bar, read_ahead(audit.updates(until)) as updates:
        task = bar.add_task("verifying", total=total)

        def on_update(update: RecordedUpdate) -> None:
            bar.advance(task)
            audit.check(update, exact=trainer.digest() == update.state_digest)

        verdict = verify(
            updates,
            trainer,
            allow_other_bits=bits_can_differ(found),
            allow_other_metrics=any(difference.name in ("commit", "reskpn") for difference in found),
            on_update=on_update,
        )
    if verdict.agrees and until is None:
        audit.conclude()
    findings = [*chain.findings, *audit.findings]
    for line in (*describe_torn(run), *describe_verdict(verdict, found), *describe_retention(run, begins)):
        print(line)
    for line in describe_audit(findings, chain, whole=verdict.agrees and until is None):
        print(line)
    return 0 if verdict.agrees and not findings else DIVERGED


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
    settings = settings.model_copy(update={"run_dir": claim_run_dir(settings)})
    factorise_on_one_thread()
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
    """The number of updates up to version `until`.

    Raises:
        SettingsError: there is no update, or none with that version.
    """
    total, newest = run.count_updates(), run.newest
    if not total:
        raise SettingsError(f"{run.path}: the log holds no update yet; there is nothing to replay")
    if until is not None and not run.first <= until <= newest:
        raise SettingsError(
            f"--until {until}: the log of {run.run} has updates {run.first} to {newest}; give one of them"
        )
    return total if until is None else until - run.first + 1


def count_between(run: RecordedRun, after: int, until: int | None) -> int:
    """The number of updates after a version and up to `until`. SettingsError where there is none."""
    last = run.newest if until is None else until
    if last <= after:
        raise SettingsError(
            f"{run.run}: the oldest checkpoint that its log goes on from is of version {after}, and no update after it "
            "is to be verified"
        )
    return last - after


def describe_torn(run: RecordedRun) -> list[str]:
    """A line for each segment without an end."""
    return [
        f"{torn.path} has no end: its run was killed or goes on; {torn.dropped_bytes:,} bytes of an incomplete record "
        "were left out"
        for torn in run.torn
    ]


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("path", type=Path, metavar="RUN", help="directory of a run, its log directory, or a single .mcap file")
    uses = parser.add_mutually_exclusive_group(required=True)
    uses.add_argument("--verify", action="store_true", help="recompute every state from the log and compare")
    uses.add_argument("--extract", type=Path, metavar="DIR", help="write the run as Parquet files to DIR")
    uses.add_argument("--publish", action="store_true", help="publish the log on the keys that the run used")
    uses.add_argument("--into", metavar="LEARNER", help="train another learner on the same experience")
    add("--until", type=int, metavar="V", help="with --verify: stop after this version (default: the last)")
    add("--public-key", type=Path, metavar="FILE", help="with --verify: the log must be signed with its private half")
    add("--format", choices=("parquet",), default="parquet", help="with --extract (default: parquet)")
    add("--rate", type=_rate, default=1.0, metavar="R", help="with --publish: multiple of the run's pace, or max (1)")
    add_connection(parser, "with --publish: ", "address to listen on")
    add("--delay", type=float, default=2.0, metavar="S", help="with --publish: seconds to connect before it starts (2)")
    add(
        "--insecure",
        action="store_true",
        help="with --publish: allow an address beyond loopback without authentication",
    )
    add_settings(parser)


def run(given: argparse.Namespace) -> int:
    """Use the log as the options say."""
    _refuse_misplaced_options(given)
    if given.into is not None:
        given.learner = given.into
        over_recorded = settings_given_over(given)
        return train_into(given.path, lambda recorded: over_recorded(recorded.model_copy(update={"run_dir": None})))
    if given.extract is not None:
        return extract_run(given.path, given.extract)
    if given.publish:
        transport = over(TransportSettings(insecure=given.insecure), given)
        return publish_run(given.path, transport, given.rate, given.delay)
    return verify_run(given.path, given.until, given.public_key)


def _refuse_misplaced_options(given: argparse.Namespace) -> None:
    """SettingsError for an option that this use of the log does not have."""
    if given.until is not None and not given.verify:
        raise SettingsError("--until goes with --verify; the other uses of a log take all of it")
    if given.public_key is not None and not given.verify:
        raise SettingsError("--public-key goes with --verify")
    settings = [name for name in vars(given) if name.split(".")[0] in RunSettings.model_fields]
    if settings and given.into is None:
        raise SettingsError(f"{settings[0]} is a setting of a learner; settings go with --into, the log has its own")
    if given.into is not None and "learner" in settings:
        raise SettingsError("--learner goes without --into, which names the learner")


def _rate(text: str) -> float | None:
    """A pace above 0; None for "max"."""
    if text == "max":
        return None
    rate = float(text)
    if not 0.0 < rate < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a pace: give a number above 0, or max")
    return rate


COMMAND = Command(
    add_options,
    run,
    "Settings are for --into alone, where the recorded run's settings replace the\ndefaults that are shown here.\n\n"
    f"{EXIT_CODES}",
    usage="reskpn replay RUN (--verify | --extract DIR | --publish | --into LEARNER) [options]",
)
