"""`reskpn certs`: the certificates of a run."""

from __future__ import annotations

import argparse
from pathlib import Path

from common.errors import SettingsError
from reskpn.commands.command import Command

DAYS = 90
LONGEST_DAYS = 3650
EPILOG = """\
Four directories are made. DIR/authority signs the others; keep its key to
yourself. DIR/learner, DIR/actor and DIR/viewer each hold all that one process
needs: --transport.certificates DIR/learner, or --certificates DIR/actor. The
name of a directory is the name in its certificate, and the learner decides by
name who may do what: transport.actor_names and transport.viewer_names. A name
that is taken off these lists is refused as soon as the learner is restarted.
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="directory for all certificates")
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--hosts",
        metavar="NAMES",
        help="make a new set, for a learner that is reached at these names or addresses: learner,10.0.0.5",
    )
    what.add_argument("--add", metavar="NAME", help="add a certificate for one more actor or viewer, with this name")
    parser.add_argument(
        "--days", type=int, default=DAYS, metavar="N", help="days for which they are valid (default: %(default)s)"
    )


def run(given: argparse.Namespace) -> int:
    """Make the certificates and say which is for what. Returns 0; SettingsError for what exists or is not possible."""
    from reskpn.authority import AUTHORITY, Authority, make_all

    if not 1 <= given.days <= LONGEST_DAYS:
        raise SettingsError(f"--days {given.days}: certificates are made for 1 to {LONGEST_DAYS} days")
    if given.add is not None:
        folder = Authority.load(given.out).issue(given.add, given.days)
        print(
            f"{folder}: to be let in, {given.add!r} must be among the learner's transport.actor_names (or viewer_names)"
        )
        return 0
    hosts = [host.strip() for host in given.hosts.split(",") if host.strip()]
    for folder in make_all(given.out, hosts, given.days):
        print(f"{folder}: for the {folder.name}, valid for {given.days} days")
    print(f"{given.out / AUTHORITY}: makes more of them (--add NAME); keep it to yourself")
    return 0


COMMAND = Command(add_options, run, EPILOG)
