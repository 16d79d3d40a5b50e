"""Options of commands that connect to a learner: its address and this process's credentials."""

from __future__ import annotations

import argparse
from pathlib import Path

from common.config.settings import RunSettings, TransportSettings
from common.engine_names import PHYSICS
from common.errors import SettingsError
from common.tasks import is_own, task_fault


def add_connection(parser: argparse.ArgumentParser, of: str = "", what: str = "address of the learner") -> None:
    """`of` begins the help, where the options belong to one use of the command only; `what` describes the address."""
    default = TransportSettings().endpoint
    parser.add_argument(
        "--endpoint",
        metavar="ADDRESS",
        help=f"{of}{what}, tcp/HOST:PORT or tls/HOST:PORT (default: {default})",
    )
    parser.add_argument(
        "--certificates",
        type=Path,
        metavar="DIR",
        help=f"{of}directory with this process's certificate (made by `reskpn certs`); required for tls/ endpoints",
    )
    parser.add_argument(
        "--users",
        type=Path,
        metavar="FILE",
        help=f"{of}file with this process's name and password as a line user:password, with or without certificates",
    )


def over(transport: TransportSettings, given: argparse.Namespace) -> TransportSettings:
    """The settings with what was given by those options put over them."""
    names = ("endpoint", "certificates", "users")
    return transport.model_copy(update={name: value for name in names if (value := getattr(given, name)) is not None})


def allow_task(given: argparse.Namespace, base: RunSettings) -> None:
    """Allow this process to import the task that its user has named. SettingsError for what is not a task's name."""
    name = given.task or base.task
    if (fault := task_fault(name, None)) is not None:
        raise SettingsError(f"--task: {fault}")
    if is_own(name):
        from common.physics.lookup import allow_import

        allow_import(name)


def add_worker_options(parser: argparse.ArgumentParser, verb: str, service: str) -> None:
    """The options of a process that connects to a learner and runs environments of its own."""
    add_connection(parser)
    parser.add_argument(
        "--physics", choices=PHYSICS, help="physics engine, if the run leaves the choice to the actor (physics auto)"
    )
    parser.add_argument("--run", default="", metavar="RUN", help=f"{verb} this run only (default: any that is served)")
    parser.add_argument(
        "--threads", type=int, default=0, metavar="N", help="threads of the native engine (default: one per core)"
    )
    parser.add_argument(
        "--connect-timeout", type=float, metavar="S", help="seconds to wait for a learner to answer (default: no limit)"
    )
    parser.add_argument(
        "--rejoin-timeout",
        type=float,
        metavar="S",
        help="seconds to wait for a learner that was lost to come back (default: no limit)",
    )
    parser.add_argument(
        "--task",
        metavar="MODULE:CLASS",
        help="task of your own that this process may import, where the run is of it; others are not run",
    )
    parser.add_argument(
        "--config",
        metavar="FILE",
        help="YAML file of settings; only its transport section, its task, physics and device_memory.actor are used",
    )
    parser.add_argument(
        "--state-file", type=Path, metavar="FILE", help=f"file that `python -m reskpn.health {service}` reads"
    )
    parser.add_argument("--supervised", action="store_true", help=argparse.SUPPRESS)
