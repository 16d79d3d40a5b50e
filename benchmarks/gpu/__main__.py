"""Everything that a GPU is asked, by one command, within a budget of time.

    make bench-gpu                  # on a machine with an NVIDIA GPU
    make bench-gpu DEVICE=cpu       # every case small: whether it runs
    python -m benchmarks.gpu --only "service humanoid" --budget 200

Each case is a process of its own. Results are in results.json and results.md of the folder as soon as they are known,
so a command that is killed keeps them; a case that fails is reported with its last words, and the others go on.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from benchmarks.gpu import report
from benchmarks.gpu.cases import FULL, SMALL, cases
from benchmarks.gpu.session import Outcome, run_all
from benchmarks.machine import machine
from benchmarks.processes import ROOT, run_json
from common.device_memory import ON_DEMAND, PLATFORMS, adopt, with_share
from common.errors import INTERRUPTED, ReskpnError, SettingsError
from common.output import say

BUDGET_S = {"gpu": 450.0, "cpu": 1800.0}
"""Seconds for all cases: on a GPU, what a command of eight minutes leaves; on a CPU more than they take."""


def main(arguments: Sequence[str] | None = None) -> int:
    given = _parser().parse_args(arguments)
    try:
        outcomes = measure(given)
    except ReskpnError as error:
        print(f"gpu: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print(f"gpu: stopped; what was measured is in {given.out}", file=sys.stderr)
        return INTERRUPTED
    print((given.out / report.MARKDOWN).read_text())
    # On a GPU a case may be too slow for its limit; on a CPU all of them are so small that none is.
    bad = ("failed",) if given.device == "gpu" else ("failed", "stopped", "not run")
    failed = [outcome.name for outcome in outcomes if outcome.state in bad]
    if failed:
        print(f"gpu: {len(failed)} of {len(outcomes)} cases without all results: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


def measure(given: argparse.Namespace) -> list[Outcome]:
    """Run the chosen cases and keep their results.

    Raises:
        SettingsError: JAX finds no GPU, or no case has such a name.
        ProcessError: JAX does not start.
    """
    cpu = given.device == "cpu"
    scale = SMALL if cpu else FULL
    chosen = [case for case in cases() if not given.only or any(part in case.name for part in given.only)]
    if not chosen:
        raise SettingsError(
            f"--only {' '.join(given.only)}: no case is called so; {', '.join(c.name for c in cases())}"
        )
    budget_s = given.budget or BUDGET_S[given.device]
    facts = report.Facts(device(cpu), machine(), scale.name, scale.sizes, budget_s)
    given.out.mkdir(parents=True, exist_ok=True)
    keep = partial(report.write, given.out, facts)
    return run_all(chosen, scale, cpu=cpu, budget_s=budget_s, keep=keep, say=partial(say, stream=sys.stderr))


def device(cpu: bool) -> dict[str, str]:
    """What JAX computes on. SettingsError where that should be a GPU and is none."""
    adopt(with_share({**os.environ, **({PLATFORMS: "cpu"} if cpu else {})}, ON_DEMAND))
    found = {name: str(value) for name, value in run_json("benchmarks.gpu.probe", []).items()}
    if not cpu and found["backend"] != "gpu":
        raise SettingsError(
            f"JAX finds no GPU here, only {found['backend']} ({found['devices']}). It needs NVIDIA's driver and JAX's "
            "CUDA plugin: python -m pip install --require-hashes -r requirements/cuda.txt, then `reskpn doctor`. "
            "DEVICE=cpu (--device cpu) tries every case, small"
        )
    return found


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.gpu",
        description="Physics, updates and whole runs of hopper and humanoid on a GPU, within a budget of time.",
        epilog="cases, the most important first:\n  " + "\n  ".join(case.name for case in cases()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--device", choices=BUDGET_S, default="gpu", help="cpu: every case small (default: gpu)")
    parser.add_argument(
        "--budget", type=float, metavar="S", help="seconds for all cases (default: 450, with --device cpu 1800)"
    )
    parser.add_argument("--only", action="append", metavar="TEXT", help="cases whose name has this in it; repeatable")
    parser.add_argument(
        "--out", type=Path, default=ROOT / "build" / "bench-gpu", metavar="DIR", help="default: build/bench-gpu"
    )
    return parser


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that the case that runs is ended, too
    sys.exit(main())
