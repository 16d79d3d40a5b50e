"""A command of `reskpn`: its options and what it does."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from common.errors import SettingsError

EXIT_CODES = """\
exit codes:
  0    done
  1    a replay diverged from its log
  2    a setting is not possible
  3    no connection
  4    refused by the other side
  5    the log or a checkpoint cannot be used
  6    physics
  7    an update was not finite
  8    a process of the run died
  130  stopped by Ctrl-C (the log is complete up to there)"""


@dataclass(frozen=True)
class Command:
    """One command.

    Args:
        add_options: gives its options to a parser.
        run: does what the parsed options ask for and returns the exit code; raises `ReskpnError`.
        epilog: what `--help` says below the options.
        usage: replaces the usage line that every command has.
    """

    add_options: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]
    epilog: str = EXIT_CODES
    usage: str = ""


def refuse_unknown_options(unknown: Sequence[str], parser: argparse.ArgumentParser) -> None:
    """SettingsError for the first word that the parser of a command did not know, with the nearest that it does."""
    if not unknown:
        return
    from common.config.faults import unknown_option

    given = next((word for word in unknown if word.startswith("-")), unknown[0]).partition("=")[0]
    # argparse has no public list of a parser's options.
    options = [name for name, action in parser._option_string_actions.items() if action.help is not argparse.SUPPRESS]
    raise SettingsError(unknown_option(given, parser.prog, options))
