"""`reskpn certs`: the certificates of a run."""

from __future__ import annotations

import argparse
from pathlib import Path

from common.errors import SettingsError

DAYS = 90
EPILOG = """\
DIR/authority vouches for the others; keep its key to yourself. DIR/learner, DIR/actor and DIR/viewer are each all that
one process needs: --transport.certificates DIR/learner, or --certificates DIR/actor. The name of a folder is the name
in its certificate, and it is by names that the learner knows who may do what: transport.actor_names and
transport.viewer_names. A name that is not in them any more is not let in any more, once the learner was started again.
"""


def add_certs_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="where they are kept")
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--hosts", metavar="NAMES", help="new ones, for a learner that is reached there: learner,10.0.0.5"
    )
    what.add_argument("--add", metavar="NAME", help="one more, for an actor or viewer with a name of its own")
    parser.add_argument("--days", type=int, default=DAYS, help=f"for how long they are valid (default: {DAYS})")


def certs(given: argparse.Namespace) -> int:
    """Make them, and say what is for whom. Returns 0; SettingsError for what is there already or not possible."""
    from reskpn.authority import Authority, make_all

    if not 1 <= given.days <= 3650:
        raise SettingsError(f"--days {given.days}: certificates are made for 1 to 3650 days")
    if given.add is not None:
        folder = Authority.load(given.out).vouch(given.add, given.days)
        print(
            f"{folder}: to be let in, {given.add!r} must be among the learner's transport.actor_names (or viewer_names)"
        )
        return 0
    hosts = [host.strip() for host in given.hosts.split(",") if host.strip()]
    for folder in make_all(given.out, hosts, given.days):
        print(f"{folder}: for the {folder.name}, valid for {given.days} days")
    print(f"{given.out / 'authority'}: makes more of them (--add NAME); keep it to yourself")
    return 0
