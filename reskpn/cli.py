"""The command line `reskpn`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pydantic_settings import CliSettingsSource

from common.config.settings import PHYSICS, RunSettings, TransportSettings
from common.config.sources import PREFIX, add_options, load, load_over
from common.errors import ReskpnError, SettingsError
from common.learners import LEARNERS
from common.tasks import TASKS
from common.wire.credentials import Credentials
from reskpn.commands.certs import EPILOG, add_certs_options, certs
from reskpn.commands.connection import add_connection, over
from reskpn.commands.resuming import AUTO, close_log, notify_pending_actors, run_to_resume, settings_to_resume

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
    commands = parser.add_subparsers(
        dest="command", required=True, metavar="{train,learner,actor,evaluator,status,doctor,replay,certs,router}"
    )
    _add_train(commands)
    _add_learner(commands)
    _add_actor(commands)
    _add_evaluator(commands)
    _add_status(commands)
    _add_doctor(commands)
    _add_replay(commands)
    _add_certs(commands)
    _add_router(commands)
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
        from reskpn.supervision.supervisor import train

        if given.resume is None:
            return train(load(options, given, config=given.config))
        # Nobody is left who knows the address of the run's first processes.
        over = partial(load_over, options=options, arguments=given, config=given.config, own_endpoint=False)
        settings = settings_to_resume(Path(given.resume), over)
        return close_log(Path(given.resume)) if settings is None else train(settings, resume=True)

    text = "train on this machine: a learner and its actors as processes on loopback"
    parser = _command(commands, "train", text, call, _epilog())
    options: CliSettingsSource[Any] = add_options(parser)
    parser.add_argument("--resume", metavar="RUN_DIR", help="go on with the unfinished run in that directory")


def _add_learner(commands: Any) -> None:
    def call(given: argparse.Namespace) -> int:
        from reskpn.supervision.stopping import stopping
        from services.learner.service import run_learner

        over = partial(load_over, options=options, arguments=given, config=given.config)
        resume = given.resume
        if resume is None or resume == AUTO:
            fresh = load(options, given, config=given.config)
            resume = run_to_resume(fresh) if resume == AUTO else None
        settings = fresh if resume is None else settings_to_resume(Path(resume), over)
        with stopping(supervised=given.supervised) as stop:
            if settings is None:
                return notify_pending_actors(Path(resume), over, stop)
            return run_learner(settings, stop=stop, resume=resume is not None)

    parser = _command(commands, "learner", "serve one training run; actors connect to it", call, _epilog())
    options: CliSettingsSource[Any] = add_options(parser)
    parser.add_argument(
        "--resume",
        metavar=f"RUN_DIR|{AUTO}",
        help=f"go on with the unfinished run in that directory; {AUTO}: with the one in --run-dir, or the newest "
        "one in runs/ if its settings are these; else start one",
    )
    parser.add_argument("--supervised", action="store_true", help=argparse.SUPPRESS)


def _add_actor(commands: Any) -> None:
    def call(given: argparse.Namespace) -> int:
        from reskpn.supervision.stopping import stopping
        from services.actor.service import run_actor

        base = load(config=given.config)
        transport = over(base.transport, given)
        with stopping(supervised=given.supervised) as stop:
            return run_actor(
                transport,
                physics=given.physics or base.physics,
                run=given.run,
                threads=given.threads,
                connect_timeout_s=given.connect_timeout,
                rejoin_timeout_s=given.rejoin_timeout,
                stop=stop,
                say=lambda text: print(text, flush=True),
                state_file=given.state_file,
            )

    text = "collect experience for a learner, from this machine or another"
    epilog = f"The environment's {PREFIX}TRANSPORT__ENDPOINT and {PREFIX}PHYSICS count as well.\n\n{EXIT_CODES}"
    parser = _command(commands, "actor", text, call, epilog)
    _add_following(parser, "work for", "actor")


def _add_following(parser: argparse.ArgumentParser, verb: str, service: str) -> None:
    """The options of whoever connects to a learner and needs its own copy of the environments."""
    add_connection(parser)
    parser.add_argument("--physics", choices=PHYSICS, help="engine, where the run leaves it to the actor")
    parser.add_argument("--run", default="", help=f"{verb} this run only (default: whichever the learner has)")
    parser.add_argument("--threads", type=int, default=0, help="threads of the native engine (default: one a core)")
    parser.add_argument(
        "--connect-timeout", type=float, metavar="S", help="give up when no learner answers in time (default: never)"
    )
    parser.add_argument(
        "--rejoin-timeout",
        type=float,
        metavar="S",
        help="give up when a learner that was lost stays away (default: never)",
    )
    parser.add_argument("--config", metavar="FILE", help="YAML file of settings; its transport section is used")
    parser.add_argument(
        "--state-file", type=Path, metavar="FILE", help=f"keep there what `python -m reskpn.health {service}` reads"
    )
    parser.add_argument("--supervised", action="store_true", help=argparse.SUPPRESS)


def _add_evaluator(commands: Any) -> None:
    def call(given: argparse.Namespace) -> int:
        from reskpn.supervision.stopping import stopping
        from services.evaluator.service import EvaluationOptions, run_evaluator

        base = load(config=given.config)
        physics = given.physics or base.physics
        options = EvaluationOptions(given.every, given.episodes, given.positions, physics, given.threads)
        with stopping(supervised=given.supervised) as stop:
            return run_evaluator(
                over(base.transport, given),
                options,
                run=given.run,
                connect_timeout_s=given.connect_timeout,
                rejoin_timeout_s=given.rejoin_timeout,
                stop=stop,
                say=lambda text: print(text, flush=True),
                state_file=given.state_file,
            )

    text = "play a run's policies without exploration, again and again, beside the training"
    epilog = f"The environment's {PREFIX}TRANSPORT__ENDPOINT and {PREFIX}PHYSICS count as well.\n\n{EXIT_CODES}"
    parser = _command(commands, "evaluator", text, call, epilog)
    add = parser.add_argument
    add("--every", type=int, default=10, metavar="N", help="each version that N divides, or the newest (%(default)s)")
    add("--episodes", type=int, default=16, metavar="N", help="episodes of each policy (default: %(default)s)")
    add("--positions", type=int, default=200, metavar="N", help="steps whose joints are logged (default: %(default)s)")
    _add_following(parser, "follow", "evaluator")


def _add_status(commands: Any) -> None:
    def call(given: argparse.Namespace) -> int:
        from reskpn.commands.status import endpoint_of, status
        from reskpn.supervision.stopping import stopping

        transport = over(load().transport, given)
        if given.run_dir and not given.endpoint:
            transport = transport.model_copy(update={"endpoint": endpoint_of(given.run_dir)})
        with stopping(supervised=False) as stop:
            who = Credentials.of(transport)
            return status(transport.endpoint, as_json=given.json, watch=given.watch, stop=stop, credentials=who)

    text = "ask a learner, from any machine that reaches it, how its run and every actor are"
    epilog = f"The environment's {PREFIX}TRANSPORT__ENDPOINT counts as well.\n\n{EXIT_CODES}"
    parser = _command(commands, "status", text, call, epilog)
    add_connection(parser)
    parser.add_argument("--run-dir", type=Path, metavar="DIR", help="instead: the directory of its run")
    parser.add_argument("--json", action="store_true", help="one JSON object a line, for machines")
    parser.add_argument("--watch", action="store_true", help="again every second, until Ctrl-C")


def _add_doctor(commands: Any) -> None:
    def call(given: argparse.Namespace) -> int:
        from reskpn.doctor.examine import doctor

        settings = load(options, given, config=given.config)
        settings = settings.model_copy(update={"transport": over(settings.transport, given)})
        return doctor(settings, as_json=given.json, full=given.full)

    text = "check this machine before a run: versions, devices, memory, disk, port, clock, Zenoh, physics"
    parser = _command(
        commands, "doctor", text, call, _epilog() + "\nThe doctor's exit code is 1 where it finds a problem."
    )
    options: CliSettingsSource[Any] = add_options(parser)
    add_connection(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object, for machines")
    parser.add_argument("--full", action="store_true", help="compile a step with MJX as well (up to a minute)")


def _add_replay(commands: Any) -> None:
    def call(given: argparse.Namespace) -> int:
        from reskpn.commands import replay

        _refuse_strays(given)
        if given.into is not None:
            given.learner = given.into
            return replay.train_into(
                given.path,
                lambda recorded: load_over(
                    recorded.model_copy(update={"run_dir": None}), options, given, config=given.config
                ),
            )
        if given.extract is not None:
            return replay.extract_run(given.path, given.extract)
        if given.publish:
            transport = over(TransportSettings(insecure=given.insecure), given)
            return replay.publish_run(given.path, transport, given.rate, given.delay)
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
    add_connection(parser, "of --publish: ")
    add("--delay", type=float, default=2.0, metavar="S", help="of --publish: time to connect first (default: 2)")
    add("--insecure", action="store_true", help="of --publish: allow an address beyond loopback that asks nobody")


def _add_certs(commands: Any) -> None:
    text = "make the certificates of a run: an authority, and what it vouches for"
    parser = _command(commands, "certs", text, certs, EPILOG)
    add_certs_options(parser)


def _add_router(commands: Any) -> None:
    def call(given: argparse.Namespace) -> int:
        from reskpn.supervision.stopping import stopping
        from services.router.service import run_router

        transport = over(load(config=given.config).transport, given)
        if given.insecure:
            transport = transport.model_copy(update={"insecure": True})
        with stopping(supervised=False) as stop:
            return run_router(transport, stop=stop, say=lambda text: print(text, flush=True))

    text = "pass messages on between a learner and actors that cannot reach it, from a host that both reach"
    epilog = f"""\
The learner and the others then have transport.router ({PREFIX}TRANSPORT__ROUTER=true), and the router's address as
their endpoint. The certificates it shows are the learner's, made for its address: `reskpn certs --hosts ROUTER`.
Who may come in is transport.actor_names and transport.viewer_names, from --config or the environment.

{EXIT_CODES}"""
    parser = _command(commands, "router", text, call, epilog)
    add_connection(parser, what="where it listens")
    parser.add_argument("--config", metavar="FILE", help="YAML file of settings; its transport section is used")
    parser.add_argument("--insecure", action="store_true", help="allow an address beyond loopback that asks nobody")


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
