"""The command line `reskpn`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from pydantic_settings import CliSettingsSource

from common.errors import ReskpnError, SettingsError
from common.learners import LEARNERS
from common.settings import PHYSICS, RunSettings, TransportSettings
from common.settings_sources import PREFIX, add_options, load
from common.tasks import TASKS

EXIT_CODES = """\
exit codes: 0 done, 1 a replay diverged from its log, 2 a setting is not possible, 3 no connection, 4 refused,
5 log or checkpoint, 6 physics, 7 an update was not finite, 8 a process of the run died, 130 stopped by Ctrl-C (the
log is whole then)."""


def _epilog() -> str:
    learners = "\n".join(f"  {learner.name:10} {learner.text}" for learner in LEARNERS.values())
    return f"""\
The command line wins over the environment ({PREFIX}TASK, {PREFIX}ALGORITHM__GAMMA), which wins over the file
given by --config, which wins over the defaults shown here.

tasks:    {", ".join(TASKS)}
physics:  {", ".join(PHYSICS)}
learners:
{learners}

{EXIT_CODES}
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code. This package's errors are printed as a sentence, without a traceback."""
    parser = argparse.ArgumentParser(
        prog="reskpn",
        description="Residual Kernel Policy Network: kernel-policy reinforcement learning as a service.",
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="{train,learner,actor,replay}")
    _add_train(commands)
    _add_learner(commands)
    _add_actor(commands)
    _add_replay(commands)
    given = parser.parse_args(arguments)
    try:
        code: int = given.call(given)
    except ReskpnError as error:
        print(f"reskpn {given.command}: {error}", file=sys.stderr)
        return error.exit_code
    return code


def _command(
    commands: Any, name: str, text: str, call: Callable[[argparse.Namespace], int], epilog: str, usage: str = ""
) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=text,
        description=f"{text[0].upper()}{text[1:]}.",
        usage=usage or f"reskpn {name} [options]",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=epilog,
        allow_abbrev=False,
    )
    parser.set_defaults(call=call)
    return parser


def _add_train(commands: Any) -> None:
    def call(given: argparse.Namespace) -> int:
        from reskpn.train import train

        return train(load(options, given, config=given.config))

    text = "train on this machine: a learner and its actors as processes on loopback"
    options: CliSettingsSource[Any] = add_options(_command(commands, "train", text, call, _epilog()))


def _add_learner(commands: Any) -> None:
    def call(given: argparse.Namespace) -> int:
        from reskpn.supervised import stopping
        from services.learner.service import run_learner

        settings = load(options, given, config=given.config)
        with stopping(supervised=given.supervised) as stop:
            return run_learner(settings, stop=stop)

    parser = _command(commands, "learner", "serve one training run; actors connect to it", call, _epilog())
    options: CliSettingsSource[Any] = add_options(parser)
    parser.add_argument("--supervised", action="store_true", help=argparse.SUPPRESS)


def _add_actor(commands: Any) -> None:
    def call(given: argparse.Namespace) -> int:
        from reskpn.supervised import stopping
        from services.actor.service import run_actor

        base = load(config=given.config)
        transport = base.transport.model_dump() | ({"endpoint": given.endpoint} if given.endpoint else {})
        with stopping(supervised=given.supervised) as stop:
            return run_actor(
                TransportSettings.model_validate(transport),
                physics=given.physics or base.physics,
                run=given.run,
                threads=given.threads,
                connect_timeout_s=given.connect_timeout,
                stop=stop,
                say=lambda text: print(text, flush=True),
            )

    text = "collect experience for a learner, from this machine or another"
    epilog = f"The environment's {PREFIX}TRANSPORT__ENDPOINT and {PREFIX}PHYSICS count as well.\n\n{EXIT_CODES}"
    parser = _command(commands, "actor", text, call, epilog)
    parser.add_argument("--endpoint", metavar="ADDRESS", help="where the learner listens, tcp/HOST:PORT")
    parser.add_argument("--physics", choices=PHYSICS, help="engine, where the run leaves it to the actor")
    parser.add_argument("--run", default="", help="work for this run only (default: whichever the learner has)")
    parser.add_argument("--threads", type=int, default=0, help="threads of the native engine (default: one a core)")
    parser.add_argument(
        "--connect-timeout", type=float, metavar="S", help="give up when no learner answers in time (default: never)"
    )
    parser.add_argument("--config", metavar="FILE", help="YAML file of settings; its transport section is used")
    parser.add_argument("--supervised", action="store_true", help=argparse.SUPPRESS)


def _add_replay(commands: Any) -> None:
    def call(given: argparse.Namespace) -> int:
        from reskpn import replay

        _refuse_strays(given)
        if given.into is not None:
            given.learner = given.into
            return replay.train_into(
                given.path, lambda recorded: load(options, given, config=given.config, recorded=recorded)
            )
        if given.extract is not None:
            return replay.extract_run(given.path, given.extract)
        if given.publish:
            return replay.publish_run(given.path, given.endpoint, given.rate, given.delay, insecure=given.insecure)
        return replay.verify_run(given.path, given.until)

    text = "check a recorded run, or make other use of its log"
    epilog = f"Settings count for --into alone; in place of the defaults shown, those of the run hold.\n\n{EXIT_CODES}"
    usage = "reskpn replay RUN (--verify | --extract DIR | --publish | --into LEARNER) [options]"
    parser = _command(commands, "replay", text, call, epilog, usage)
    _add_replay_options(parser)
    options: CliSettingsSource[Any] = add_options(parser)


def _add_replay_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("path", type=Path, metavar="RUN", help="run directory, its log directory, or one .mcap file")
    uses = parser.add_mutually_exclusive_group(required=True)
    uses.add_argument("--verify", action="store_true", help="compute every state anew from the log and compare")
    uses.add_argument("--extract", type=Path, metavar="DIR", help="write transitions, episodes and metrics there")
    uses.add_argument("--publish", action="store_true", help="play the log on the keys that the run had")
    uses.add_argument("--into", metavar="LEARNER", help="train another learner on the same experience")
    add("--until", type=int, metavar="V", help="of --verify: up to this version (default: to the end)")
    add("--format", choices=("parquet",), default="parquet", help="of --extract (default: parquet)")
    add("--rate", type=_rate, default=1.0, metavar="R", help="of --publish: times the run's pace, or max (default: 1)")
    endpoint = TransportSettings().endpoint
    add("--endpoint", metavar="ADDRESS", default=endpoint, help=f"of --publish: where to listen (default: {endpoint})")
    add("--delay", type=float, default=2.0, metavar="S", help="of --publish: time to connect first (default: 2)")
    add("--insecure", action="store_true", help="of --publish: allow an address beyond loopback")


def _refuse_strays(given: argparse.Namespace) -> None:
    """SettingsError for an option that the use of the log does not have."""
    if given.until is not None and not given.verify:
        raise SettingsError("--until goes with --verify; the other uses of a log take all of it")
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
