"""Two commits in turns: the time of an update, and the speed of short runs of the service.

    python -m benchmarks.compare_commits 662b3ce --case ppo --case "exact n=1 M=2441" --rounds 10 --train 5

The old commit is unpacked into a temporary directory; the new one is this source tree as it stands, or `--new COMMIT`.
Both run with this Python and its packages. A round measures one after the other, the first of a round in turn, so that
other load affects both; a ratio is new over old in the same round, and the median over the rounds is reported. A train
round runs `make train` with fewer steps from each tree.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import statistics
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from benchmarks.machine import describe, machine
from benchmarks.processes import bare_environment
from common.errors import ProcessError

ROOT = Path(__file__).parent.parent

SUBJECT = """
import sys
from benchmarks.update import CASES, Subject
case = next((case for case in CASES if case.name == sys.argv[2]), None)
if case is None:
    sys.exit(f"benchmarks.update of this commit has no case named {sys.argv[2]!r}")
subject = Subject(case, sys.argv[1])
subject.seconds()
print("ready", flush=True)
for _ in sys.stdin:
    print(*subject.seconds(), flush=True)
"""
"""What both trees run; it must work with every commit that is compared."""

TRAIN = (
    "--config paper --task inverted_pendulum --learner reskpn --actors 2 --num-envs 1024 --num-steps 20 "
    "--evaluation.episodes 0"
)

Measure = Callable[[], tuple[float, ...]]


@contextmanager
def unpacked(commit: str) -> Iterator[Path]:
    """The files of a commit in a temporary directory.

    Raises:
        ProcessError: git does not know the commit.
    """
    packed = subprocess.run(["git", "archive", commit], cwd=ROOT, capture_output=True, check=False)
    if packed.returncode:
        raise ProcessError(f"git archive {commit} failed: {packed.stderr.decode().strip()}")
    with tempfile.TemporaryDirectory(prefix="reskpn-commit-") as folder:
        with tarfile.open(fileobj=io.BytesIO(packed.stdout)) as archive:
            archive.extractall(folder, filter="data")
        yield Path(folder)


def _environment(tree: Path) -> dict[str, str]:
    return bare_environment() | {"PYTHONPATH": str(tree)}


@contextmanager
def updater(tree: Path, task: str, case: str) -> Iterator[Measure]:
    """Measures one more update of a tree: its wall time and processor time.

    Raises:
        ProcessError: the tree's benchmark cannot make this update.
    """
    command = [sys.executable, "-c", SUBJECT, task, case]
    with subprocess.Popen(
        command, cwd=tree, env=_environment(tree), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        ask, answers = process.stdin, process.stdout
        assert ask is not None
        assert answers is not None
        if answers.readline().strip() != "ready":
            raise ProcessError(f"the update {case!r} on {task} of {tree} cannot be measured; see above")

        def measure() -> tuple[float, ...]:
            ask.write("update\n")
            ask.flush()
            return tuple(map(float, answers.readline().split()))

        yield measure
        ask.close()


def train_seconds(tree: Path, steps: float) -> tuple[float, ...]:
    """Seconds that the service of a tree takes for 1,000 environment steps of a short run."""
    with tempfile.TemporaryDirectory(prefix="reskpn-run-") as folder:
        run = Path(folder) / "run"
        options = [*TRAIN.split(), "--total-steps", str(steps), "--run-dir", str(run)]
        command = [sys.executable, "-m", "reskpn", "train", *options]
        done = subprocess.run(command, cwd=tree, env=_environment(tree), capture_output=True, text=True, check=False)
        if done.returncode:
            raise ProcessError(f"train of {tree} ended with {done.returncode}:\n{(done.stdout + done.stderr)[-800:]}")
        return (1e3 / json.loads((run / "summary.json").read_text())["env_steps_per_s"],)


def in_turns(old: Measure, new: Measure, rounds: int) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """(old, new) of each round; odd rounds begin with the new one."""
    measured = []
    for number in range(rounds):
        if number % 2:
            after = new()
            measured.append((old(), after))
        else:
            before = old()
            measured.append((before, new()))
    return measured


def describe_ratio(name: str, unit: str, pairs: Sequence[tuple[float, float]]) -> str:
    """A line with both medians and the median ratio of new over old with its range."""
    ratios = sorted(new / old for old, new in pairs)
    old, new = (statistics.median(values) for values in zip(*pairs, strict=True))
    spread = f"{ratios[0]:.2f}-{ratios[-1]:.2f}"
    return f"{name:44} {old:9.3f} {new:9.3f} {unit:8} {statistics.median(ratios):6.2f} {spread:>13}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.compare_commits", description=__doc__.split("\n")[0])
    parser.add_argument("old", help="the commit to compare with")
    parser.add_argument("--new", help="default: this source tree as it stands")
    parser.add_argument("--task", action="append", help="default: hopper")
    parser.add_argument("--case", action="append", help='of benchmarks.update; default: ppo and "exact n=1 M=2441"')
    parser.add_argument("--rounds", type=int, default=10, help="updates of each case and commit (default 10)")
    parser.add_argument("--train", type=int, default=0, metavar="N", help="also N runs of each commit (default none)")
    parser.add_argument("--train-steps", type=float, default=6e5, help="environment steps of such a run (default 6e5)")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    given = _parser().parse_args(arguments)
    print(*describe(machine()), sep="\n")
    with ExitStack() as stack:
        old = stack.enter_context(unpacked(given.old))
        new = ROOT if given.new is None else stack.enter_context(unpacked(given.new))
        print(f"old: {given.old}; new: {given.new or 'this source tree'}; {os.cpu_count()} cores in turns")
        print(f"{'':44} {'old':>9} {'new':>9} {'':8} {'ratio':>6} {'range':>13}")
        for task in given.task or ["hopper"]:
            for case in given.case or ["ppo", "exact n=1 M=2441"]:
                with updater(old, task, case) as before, updater(new, task, case) as after:
                    measured = in_turns(before, after, given.rounds)
                for column, unit in enumerate(("s", "cpu s")):
                    pairs = [(a[column], b[column]) for a, b in measured]
                    print(describe_ratio(f"update, {task}, {case}", unit, pairs), flush=True)
        if given.train:
            steps = given.train_steps
            runs = in_turns(lambda: train_seconds(old, steps), lambda: train_seconds(new, steps), given.train)
            print(describe_ratio("train, 1,000 steps", "s", [(a[0], b[0]) for a, b in runs]))
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except ProcessError as error:
        sys.exit(str(error))
