"""The command line `reskpn`: a table of its commands. Each is a module of `reskpn.commands`, loaded when it is used."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module

from common.device_memory import ON_DEMAND, reserve
from common.errors import ReskpnError
from common.output import forget, say
from reskpn.commands.command import Command, refuse_unknown_options

COMMANDS = {
    "train": "train on this machine: a learner and its actors as processes on loopback",
    "learner": "serve one training run; actors connect to it",
    "actor": "collect experience for a learner, from this machine or another",
    "evaluator": "evaluate the policies of a run while it trains, without exploration",
    "status": "show how a run and each of its actors are doing, from any machine that reaches the learner",
    "dashboard": "show runs in the browser while they train: curves, fleet, where the time goes",
    "play": "play episodes without exploration: of an exported policy, or of any version of a recorded run",
    "evaluate": "the same as play, for recorded runs",
    "export": "write the policy of a run as an ONNX file, or for JAX, verified against its log",
    "view": "show the trajectories of a recorded run in MuJoCo's web viewer, with a scrubber",
    "film": "make a film and a strip of pictures of a recorded run, or a file for Foxglove",
    "tasks": "list the tasks, with their sizes and control time steps",
    "runs": "list the runs of a folder, and delete those that are no longer needed",
    "doctor": "check this machine before a run: versions, devices, memory, disk, port, clock, Zenoh, physics",
    "replay": "verify a recorded run, or use its log: extract, publish, train another learner",
    "log": "repair the log of a run that was killed, without resuming the run",
    "certs": "make the certificates of a run: an authority, and one for each process",
    "router": "relay messages between a learner and actors that cannot reach it, from a host that both can reach",
    "paper": "list, run and draw the experiments of the paper and of the study",
    "compare": "show several runs side by side: curves with intervals, tables, a CSV file",
    "sweep": "run and draw an experiment of your own: settings and seeds",
    "report": "write runs as one HTML page that needs no network",
}
"""What `--help` says of each command. The rest is in the command's module, which takes longer to load."""


BROKEN_PIPE = 141
"""Exit code of a command whose output was closed before its end, as a shell reports SIGPIPE."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code. This package's errors are printed as a sentence, without a traceback."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    name = _chosen(words)
    reserve(ON_DEMAND)
    try:
        given, command = parse(words)
        code: int = command.run(given)
    except ReskpnError as error:
        say(f"reskpn {name}: {error}", sys.stderr)
        return error.exit_code
    except BrokenPipeError:
        # `reskpn runs | head -1`: nobody reads what a command still prints, which is no fault of it.
        forget(sys.stdout)
        return BROKEN_PIPE
    return code


def parse(words: Sequence[str]) -> tuple[argparse.Namespace, Command]:
    """The options of a command line, and its command.

    Raises:
        SettingsError: an option that the command does not have, with the nearest that it has.
        SystemExit: what argparse refuses, printed by it; also after `--help` and `--version`.
    """
    parser = argparse.ArgumentParser(
        prog="reskpn",
        description="Kernel-policy reinforcement learning as a service, after the paper 'Residual Kernel Policy "
        "Network: Enhancing Stability and Robustness in RKHS-Based Reinforcement Learning'.",
        epilog="`reskpn COMMAND --help` explains a command and its options.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version, help="show the version and exit")
    commands = parser.add_subparsers(dest="command", required=True, metavar=f"{{{','.join(COMMANDS)}}}")
    chosen, command = _chosen(words), None
    for name, summary in COMMANDS.items():
        if name == chosen:
            command = load_command(name)
            command.add_options(add_parser(commands, name, summary, command))
        else:
            commands.add_parser(name, help=summary)
    given, unknown = parser.parse_known_args(words)
    assert command is not None  # argparse has refused whatever is no command
    refuse_unknown_options(unknown, given.parser)
    return given, command


def _chosen(words: Sequence[str]) -> str:
    return next((word for word in words if not word.startswith("-")), "")


class _Version(argparse.Action):
    """Prints the version of the package, which is looked up only then."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str | None = None) -> None:
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import PackageNotFoundError, version

        try:
            found = version(parser.prog)
        except PackageNotFoundError:
            found = "of a source tree that is not installed"
        print(f"{parser.prog} {found}")
        parser.exit()


def load_command(name: str) -> Command:
    """The command's module has it as `COMMAND`."""
    command: Command = import_module(f"reskpn.commands.{name}").COMMAND
    return command


def add_parser(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], name: str, summary: str, command: Command
) -> argparse.ArgumentParser:
    """The parser of a command, without its options yet."""
    parser = commands.add_parser(
        name,
        help=summary,
        description=f"{summary[0].upper()}{summary[1:]}.",
        usage=command.usage or f"reskpn {name} [options]",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=command.epilog,
        allow_abbrev=False,
    )
    parser.set_defaults(parser=parser)
    return parser
