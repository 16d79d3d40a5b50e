"""Options of commands that meet a learner."""

from __future__ import annotations

import argparse
from pathlib import Path

from common.config.settings import TransportSettings
from reskpn.commands.connection import add_connection, over


def test_what_is_given_wins_over_the_settings() -> None:
    """And what is not given leaves them as they are."""
    parser = argparse.ArgumentParser()
    add_connection(parser)
    base = TransportSettings(endpoint="tcp/10.0.0.5:1", users=Path("users"), lease_s=5.0)
    assert over(base, parser.parse_args([])) == base
    given = over(base, parser.parse_args(["--endpoint", "tls/10.0.0.6:2", "--certificates", "actor"]))
    assert (given.endpoint, given.certificates, given.users) == ("tls/10.0.0.6:2", Path("actor"), Path("users"))
    assert given.lease_s == 5.0
