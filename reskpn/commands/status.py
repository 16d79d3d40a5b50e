"""`reskpn status`: the state of a run and its actors, asked of its learner once or repeatedly."""

from __future__ import annotations

import argparse
import json
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.live import Live

from common.config.faults import PREFIX
from common.config.settings import TransportSettings
from common.config.sources import load
from common.errors import ReskpnError, SessionError, SettingsError
from common.printable import printable
from common.runs.directory import RUNS, SETTINGS
from common.runs.listing import describe_run, newest_run
from common.wire.credentials import NO_CREDENTIALS, Credentials
from common.wire.report import RunReport
from common.wire.session import Session
from common.wire.status_request import CONNECT_S, ask, connect
from reskpn.commands.command import EXIT_CODES, Command
from reskpn.commands.connection import add_connection, over
from reskpn.commands.status_view import view
from reskpn.commands.summary_view import finished_summary, print_summary

WATCH_S = 1.0
PLAIN_WIDTH = 160


def status(
    endpoint: str, *, as_json: bool, watch: bool, stop: threading.Event, credentials: Credentials = NO_CREDENTIALS
) -> int:
    """Print the report of the learner at `endpoint`; with `watch` every second until `stop` is set. Returns 0.

    Raises:
        SessionError: no learner there, or it has gone.
        CodecError: what answers is not a learner of this release.
    """
    # In a file or a pipe, lines are not wrapped.
    console = Console(highlight=False) if sys.stdout.isatty() else Console(highlight=False, width=PLAIN_WIDTH)
    with connect(endpoint, CONNECT_S, credentials) as session:
        report = ask(session, endpoint, CONNECT_S)
        if not watch:
            _print(console, report, as_json=as_json)
            return 0
        if as_json or not console.is_terminal:
            while not stop.is_set():
                _print(console, report, as_json=as_json)
                if not stop.wait(WATCH_S):
                    report = _ask_next(session, report)
            return 0
        with Live(view(report), console=console, refresh_per_second=4) as live:
            while not stop.wait(WATCH_S):
                report = _ask_next(session, report)
                live.update(view(report))
    return 0


def _ask_next(session: Session, last: RunReport) -> RunReport:
    try:
        return ask(session, last.endpoint, CONNECT_S)
    except SessionError:
        raise SessionError(
            f"the learner of {printable(last.run)} does not answer any more: the run is over, or the learner stopped"
        ) from None


def endpoint_of(run_dir: Path) -> str:
    """The address of the learner of a run directory. SettingsError if the directory has no settings of a run."""
    path = run_dir / SETTINGS
    try:
        endpoint = json.loads(path.read_text())["transport"]["endpoint"]
    except OSError as error:
        raise SettingsError(
            f"--run-dir {run_dir}: {SETTINGS} cannot be read ({error.strerror}); give the directory of a run"
        ) from None
    except (ValueError, KeyError, TypeError):
        raise SettingsError(f"--run-dir {run_dir}: {SETTINGS} does not hold the settings of a run") from None
    return str(endpoint)


def status_of_run(
    run_dir: Path | None,
    *,
    as_json: bool,
    watch: bool,
    stop: threading.Event,
    credentials: Credentials = NO_CREDENTIALS,
    say: Callable[[str], None] = print,
) -> int:
    """Print the state of the run in a directory, or of the newest run of this folder; returns 0.

    Of a finished run that is its summary; of another one what its learner answers. With `watch` a learner that does
    not answer, since it has not started or not yet been resumed, is waited for; its address is looked up every time.

    Raises:
        SessionError: no learner answers, and it is not to be waited for.
        SettingsError: there is no run.
    """
    told = False
    while not stop.is_set():
        directory = run_dir or newest_run(RUNS)
        if directory is not None and (summary := finished_summary(directory)) is not None:
            print_summary(directory, summary, as_json=as_json)
            return 0
        try:
            return status(_endpoint_in(directory), as_json=as_json, watch=watch, stop=stop, credentials=credentials)
        except (SessionError, SettingsError) as error:
            # Its run may have ended just now, and a resumed one listens elsewhere: looked up anew in the next round.
            if directory is not None and finished_summary(directory) is not None:
                continue
            if not watch:
                raise type(error)(_unanswered(directory, error)) from None
        if not told:
            say(f"waiting for the learner of {directory or 'a run'}; Ctrl-C ends this")
            told = True
        stop.wait(WATCH_S)
    return 0


def _endpoint_in(run_dir: Path | None) -> str:
    return TransportSettings().endpoint if run_dir is None else endpoint_of(run_dir)


def _unanswered(run_dir: Path | None, error: ReskpnError) -> str:
    """The reason why no learner answers for a run, as its directory shows it."""
    listed = None if run_dir is None else describe_run(run_dir)
    if listed is None:
        where = "" if run_dir else f" There is no run in {RUNS}/ here; give --endpoint or --run-dir."
        return f"{error}{where}"
    if listed.state == "starting":
        return f"{run_dir} is a run that is just starting, or never did; --watch waits for its learner"
    if listed.state == "stopped":
        return f"{run_dir} is not finished and not running; continue it with: reskpn train --resume {run_dir}"
    return f"{run_dir}: {error}"


def _print(console: Console, report: RunReport, *, as_json: bool) -> None:
    if as_json:
        print(report.model_dump_json(), flush=True)
    else:
        console.print(view(report))


def add_options(parser: argparse.ArgumentParser) -> None:
    add_connection(parser)
    parser.add_argument(
        "--run-dir",
        type=Path,
        metavar="DIR",
        help="directory of the run, whose settings have the address",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object per line, for machines")
    parser.add_argument(
        "--watch",
        action="store_true",
        help="repeat every second until Ctrl-C, and wait for a learner that does not answer yet",
    )


def run(given: argparse.Namespace) -> int:
    """Print the state of the run that the options name."""
    from reskpn.supervision.stopping import stopping

    transport = over(load().transport, given)
    credentials = Credentials.of(transport)
    with stopping(supervised=False) as stop:
        if given.endpoint is None and (given.run_dir or "endpoint" not in transport.model_fields_set):
            return status_of_run(
                given.run_dir, as_json=given.json, watch=given.watch, stop=stop, credentials=credentials, say=_say
            )
        return status(transport.endpoint, as_json=given.json, watch=given.watch, stop=stop, credentials=credentials)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


COMMAND = Command(
    add_options,
    run,
    "Without --endpoint and --run-dir: the newest run in runs/ of this folder, unless\n"
    f"{PREFIX}TRANSPORT__ENDPOINT is set. Of a finished run, its summary is shown.\n\n{EXIT_CODES}",
)
