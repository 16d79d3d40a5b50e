"""`reskpn status`: ask a learner how its run and its actors are, once or again and again."""

from __future__ import annotations

import json
import sys
import threading
import time
from pathlib import Path

from rich.console import Console
from rich.live import Live

from common.errors import SessionError, SettingsError
from common.printable import printable
from common.runs.directory import SETTINGS
from common.wire.credentials import NOBODY, Credentials
from common.wire.keys import STATUS
from common.wire.report import MAX_REPORT_BYTES, RunReport
from common.wire.session import Session, open_session
from reskpn.commands.status_view import view

CONNECT_S = 3.0
"""How long a learner may take to be connected to, and then to answer."""

ASK_S = 1.0

WATCH_S = 1.0
PLAIN_WIDTH = 160
_RETRY = threading.Event()  # never set: between two questions nothing here can end the wait early


def status(
    endpoint: str, *, as_json: bool, watch: bool, stop: threading.Event, credentials: Credentials = NOBODY
) -> int:
    """Print the report of the learner at `endpoint`; with `watch` every second until `stop` is set. Returns 0.

    Raises:
        SessionError: no learner there, or it has gone.
        CodecError: what answers is not a learner of this release.
    """
    # Where nobody looks at it while it is written, its lines are not broken.
    console = Console(highlight=False) if sys.stdout.isatty() else Console(highlight=False, width=PLAIN_WIDTH)
    with connect(endpoint, credentials=credentials) as session:
        report = ask(session, endpoint)
        if not watch:
            _print(console, report, as_json=as_json)
            return 0
        if as_json or not console.is_terminal:
            while not stop.is_set():
                _print(console, report, as_json=as_json)
                if not stop.wait(WATCH_S):
                    report = _ask_again(session, report)
            return 0
        with Live(view(report), console=console, refresh_per_second=4) as live:
            while not stop.wait(WATCH_S):
                report = _ask_again(session, report)
                live.update(view(report))
    return 0


def connect(endpoint: str, timeout_s: float = CONNECT_S, credentials: Credentials = NOBODY) -> Session:
    """A session with whoever listens at `endpoint`; SessionError within the time where nobody does."""
    return open_session(
        connect=[endpoint],
        connect_timeout_s=timeout_s,
        max_message_size=MAX_REPORT_BYTES,
        credentials=credentials,
        # Closing waits for a connection that is being made: 10 s with a program that says nothing.
        options={"transport/unicast/open_timeout": round(1000 * timeout_s)},
    )


def ask(session: Session, endpoint: str, timeout_s: float = CONNECT_S) -> RunReport:
    """The report of the learner that the session is connected to.

    Raises:
        SessionError: nobody there answers as a learner does.
        CodecError: the answer is not a report.
    """
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            return RunReport.decode(session.ask(STATUS, b"", ASK_S))
        except SessionError:
            # What the learner serves is known a moment after the connection; and a starting one serves it later.
            if time.monotonic() >= deadline:
                raise SessionError(
                    f"something listens at {endpoint} but does not answer as a learner: it is still starting, "
                    "stopped or of an older release, another program has the port, or the name in this certificate, "
                    "or this user, may not watch the run (transport.viewer_names there)"
                ) from None
        _RETRY.wait(0.1)


def _ask_again(session: Session, last: RunReport) -> RunReport:
    try:
        return ask(session, last.endpoint, CONNECT_S)
    except SessionError:
        raise SessionError(
            f"the learner of {printable(last.run)} does not answer any more: its run is over, or it was stopped"
        ) from None


def endpoint_of(run_dir: Path) -> str:
    """Where the learner of a run directory listens. SettingsError where there are no settings of a run in it."""
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


def _print(console: Console, report: RunReport, *, as_json: bool) -> None:
    if as_json:
        print(report.model_dump_json(), flush=True)
    else:
        console.print(view(report))
