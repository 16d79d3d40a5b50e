"""Options of commands that meet a learner: where, and who they are."""

from __future__ import annotations

import argparse
from pathlib import Path

from common.config.settings import TransportSettings


def add_connection(parser: argparse.ArgumentParser, of: str = "", what: str = "where the learner listens") -> None:
    """`of` begins the help, where the options go with one use of the command only; `what` is at the address."""
    default = TransportSettings().endpoint
    parser.add_argument("--endpoint", metavar="ADDRESS", help=f"{of}{what}, tcp|tls/HOST:PORT (default: {default})")
    parser.add_argument(
        "--certificates", type=Path, metavar="DIR", help=f"{of}of who this is, as `reskpn certs` makes them, for tls/"
    )
    parser.add_argument(
        "--users", type=Path, metavar="FILE", help=f"{of}instead, or as well: a file with user:password"
    )


def over(transport: TransportSettings, given: argparse.Namespace) -> TransportSettings:
    """The settings with what was given by those options put over them."""
    names = ("endpoint", "certificates", "users")
    return transport.model_copy(update={name: value for name in names if (value := getattr(given, name)) is not None})
