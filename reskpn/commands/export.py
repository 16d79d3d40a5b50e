"""`reskpn export`: the policy of a run as a file that runs without this package."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from common.errors import SettingsError
from common.printable import printable
from reskpn.commands.command import EXIT_CODES, Command
from reskpn.commands.task_option import add_task, confirm_task

if TYPE_CHECKING:
    from reskpn.export.policy import TrainedPolicy
    from reskpn.export.write import Written

FORMATS = ("onnx", "jax")

EPILOG = f"""\
The file holds everything between a raw observation and an action in [-1, 1]: the
normaliser, the networks, the kernel expansion and the clipping that the environment
does. It gets its name only when its actions are those of the trained policy, to 1e-5,
on observations of the run's log. The run may be finished, running or killed.

  onnx   for ONNX Runtime; reskpn.policy_file.load and `reskpn play` open it
  jax    StableHLO and arrays in a NumPy archive; needs numpy and jax

{EXIT_CODES}"""


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("path", type=Path, metavar="RUN", help="directory of a run, or its log directory")
    add_task(parser)
    add(
        "--version",
        type=int,
        metavar="V",
        help="version of the policy (default: the newest in the log); one that the log does not hold is recomputed",
    )
    add("--format", choices=FORMATS, default="onnx", help="format of the file (default: %(default)s)")
    add("--out", type=Path, metavar="FILE", help="the file (default: TASK-LEARNER-vVERSION.onnx or .npz, here)")


def run(given: argparse.Namespace) -> int:
    """Write the file and print what it is. Returns 0."""
    _check(given)
    from common.runs.recorded_run import open_run
    from common.runtime import enable_compilation_cache
    from reskpn.commands.progress import recomputing
    from reskpn.export.policy import trained_policy
    from reskpn.export.verify import logged_observations
    from reskpn.export.write import write_policy

    recorded = open_run(given.path)
    confirm_task(recorded.settings, given.task)
    enable_compilation_cache()
    with recomputing(given.version) as on_update:
        policy = trained_policy(recorded, given.version, on_update)
    written = write_policy(policy, logged_observations(recorded), given.format, given.out or _default(policy, given))
    for line in _lines(policy, written):
        print(line)
    return 0


def _default(policy: TrainedPolicy, given: argparse.Namespace) -> Path:
    from common.tasks import slug
    from reskpn.export.write import SUFFIXES

    return Path(f"{slug(policy.settings.task)}-{policy.settings.learner}-v{policy.version}{SUFFIXES[given.format]}")


def _lines(policy: TrainedPolicy, written: Written) -> list[str]:
    run = printable(policy.run)
    lines = [f"{run}: policy {policy.version} of {policy.newest}, digest {policy.digest}"]
    if not policy.exact:
        lines.append("the recomputed state is not the recorded one, bit for bit: `reskpn replay RUN --verify` says why")
    verified = written.verified
    lines.append(
        f"{written.path}: {written.size_bytes / 1024:,.0f} KiB; differs from the trained policy by at most "
        f"{verified.difference:.1e} on {verified.observations:,} logged observations"
    )
    lines.append(f"an action takes {1e6 * verified.latency_s:,.0f} us on this machine (median of one observation)")
    if written.not_playable is not None:
        lines.append(f"`reskpn play` cannot play this file: {written.not_playable}")
    return lines


def _check(given: argparse.Namespace) -> None:
    """SettingsError for a number or a file name that is not possible."""
    if given.version is not None and given.version < 0:
        raise SettingsError(f"--version is {given.version}; allowed: 0 or more")
    suffix = {"onnx": ".onnx", "jax": ".npz"}[given.format]
    if given.out is not None and given.out.suffix != suffix:
        raise SettingsError(f"--out {given.out}: a file of format {given.format} ends in {suffix}")
    if given.out is not None and not given.out.absolute().parent.is_dir():
        raise SettingsError(f"--out {given.out}: there is no folder {given.out.absolute().parent}; create it first")


COMMAND = Command(add_options, run, EPILOG, usage="reskpn export RUN [options]")
