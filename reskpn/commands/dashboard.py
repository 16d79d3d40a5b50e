"""`reskpn dashboard`: a page in the browser that shows runs while they train."""

from __future__ import annotations

import argparse
import os
import secrets
import socket
from pathlib import Path

from common.config.faults import PREFIX
from common.config.sources import load
from common.errors import SettingsError
from common.files import read_text
from common.output import say
from common.runs.directory import RUNS
from common.wire.listening_socket import PORT
from reskpn.commands.command import EXIT_CODES, Command

TOKEN = f"{PREFIX}DASHBOARD_TOKEN"

BESIDE_A_RUN = 10
"""Niceness beside the run that `train` makes: on a machine without a core to spare the run comes first."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--run-dir",
        type=Path,
        nargs="+",
        action="extend",
        metavar="DIR",
        help=f"run directories, or folders of runs (default: {RUNS}/ of this folder)",
    )
    parser.add_argument(
        "--endpoint",
        metavar="ADDRESS",
        help="a learner to watch whose run directory is not on this machine, tcp/HOST:PORT or tls/HOST:PORT",
    )
    parser.add_argument(
        "--certificates",
        type=Path,
        metavar="DIR",
        help="directory with this process's certificate (made by `reskpn certs`); required for tls/ endpoints",
    )
    parser.add_argument(
        "--users",
        type=Path,
        metavar="FILE",
        help="file with this process's name and password as a line user:password, with or without certificates",
    )
    parser.add_argument("--host", default="127.0.0.1", metavar="HOST", help="address to serve on (default: 127.0.0.1)")
    parser.add_argument(
        "--port", type=_port, metavar="N", help=f"port to serve on (default: {PORT}, or the next that is free)"
    )
    parser.add_argument(
        "--token-file",
        type=Path,
        metavar="FILE",
        help=f"file with the token that a reader must know (or {TOKEN} in the environment); needed with --host",
    )
    parser.add_argument("--new-token", action="store_true", help="make a token where none is given, and print it")
    parser.add_argument(
        "--allow-host", action="append", default=[], metavar="NAME", help="a further name under which it may be opened"
    )
    parser.add_argument("--listening", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--supervised", action="store_true", help=argparse.SUPPRESS)


def run(given: argparse.Namespace) -> int:
    """Serve the page until it is stopped."""
    from common.wire.credentials import Credentials
    from common.wire.listening_socket import address_of, listen
    from reskpn.supervision.stopping import stopping
    from services.dashboard.service import Served, check_token, serve

    token = _token(given)
    check_token(given.host, token)
    paths = _paths(given)
    credentials = {name: value for name in ("certificates", "users") if (value := vars(given)[name]) is not None}
    # The environment may have them as well; the other settings are those of runs.
    transport = load().transport.model_copy(update=credentials)
    served = Served(
        paths, given.endpoint, Credentials.of(transport), token, frozenset(map(str.lower, given.allow_host))
    )
    if given.supervised:
        os.nice(BESIDE_A_RUN)
    with stopping(supervised=given.supervised) as stop:
        listening = (
            socket.socket(fileno=given.listening) if given.listening is not None else listen(given.host, given.port)
        )
        with listening:
            what = ", ".join([*map(str, paths), *([given.endpoint] if given.endpoint else [])])
            address = address_of(listening, token)
            serve(listening, served, stop, lambda: say(f"live page of {what}: {address} (Ctrl-C ends it)"))
    return 0


def _paths(given: argparse.Namespace) -> list[Path]:
    if given.run_dir or given.endpoint:
        return list(given.run_dir or ())
    if not RUNS.is_dir():
        raise SettingsError(
            f"there is no folder {RUNS}/ here; give --run-dir DIR, or --endpoint tcp/HOST:PORT of a learner"
        )
    return [RUNS]


def _token(given: argparse.Namespace) -> str | None:
    """The token of the file, or else of the environment, or else a new one if that is wanted."""
    if given.token_file is not None:
        try:
            token = read_text(given.token_file).strip()
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it is not text"
            raise SettingsError(f"--token-file {given.token_file}: cannot be read ({reason})") from None
        if not token:
            raise SettingsError(f"--token-file {given.token_file}: is empty; write a token into it")
        return token
    return os.environ.get(TOKEN, "").strip() or (secrets.token_urlsafe(24) if given.new_token else None)


def _port(given: str) -> int:
    if not given.isdecimal() or not 1 <= int(given) <= 65535:
        raise argparse.ArgumentTypeError(f"{given!r} is not a port from 1 to 65535")
    return int(given)


COMMAND = Command(
    add_options,
    run,
    "It only reads: a run is the same with and without it. docs/dashboard.md explains every plot, what the page\n"
    f"costs, and who can read it.\n\n{EXIT_CODES}",
)
