"""The comparison: both sides on the same scores, a table, and exit code 1 where one differs by more than it may."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.statistics.data import (
    EXACT,
    OWN_RESAMPLES,
    RESAMPLED,
    RESAMPLES,
    THRESHOLDS,
    Scores,
    as_matrix,
    scores,
)
from common.errors import ProcessError, ReskpnError
from reskpn.study.statistics import bootstrap, improvement, interquartile_mean, performance_profile

ROOT = Path(__file__).parents[2]
PYTHON = ROOT / "build" / "rliable" / ".venv" / "bin" / "python"

Found = Mapping[str, list[float]]
"""By statistic: value and ends of its interval, or the profile's values."""


@dataclass(frozen=True)
class Difference:
    """Both sides of one number. `difference` and `allowed` are of `unit`."""

    what: str
    ours: float
    theirs: float
    difference: float
    allowed: float
    unit: str

    @property
    def agrees(self) -> bool:
        return self.difference <= self.allowed


def ours(x: Scores, y: Scores) -> Found:
    """This project's statistics."""
    mean = bootstrap(x, interquartile_mean, resamples=OWN_RESAMPLES)
    better = improvement(x, y, resamples=OWN_RESAMPLES)
    return {
        "interquartile mean": [mean.value, mean.low, mean.high],
        "probability of improvement": [better.value, better.low, better.high],
        "performance profile": performance_profile(x, THRESHOLDS).tolist(),
    }


def theirs(x: Scores, y: Scores) -> Found:
    """rliable's. ProcessError where it is not installed, or fails."""
    if not PYTHON.exists():
        raise ProcessError(f"rliable is not installed ({PYTHON.relative_to(ROOT)} is missing): `make check-statistics`")
    given = {"x": as_matrix(x), "y": as_matrix(y), "thresholds": THRESHOLDS.tolist(), "resamples": RESAMPLES}
    program = Path(__file__).with_name("in_rliable.py")
    done = subprocess.run(
        [str(PYTHON), "-W", "ignore", str(program)],
        input=json.dumps(given),
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise ProcessError(f"rliable failed: {done.stderr.strip().splitlines()[-1:]}")
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def differences(own: Found, other: Found) -> Iterator[Difference]:
    """Values must agree to rounding, ends of intervals to a share of the interval's width."""
    for name, allowed in RESAMPLED.items():
        (value, *ends), (their_value, *their_ends) = own[name], other[name]
        yield Difference(name, value, their_value, abs(value - their_value), EXACT, "")
        width = their_ends[1] - their_ends[0]
        for end, mine, their in zip(("lower", "upper"), ends, their_ends, strict=True):
            apart = abs(mine - their) / width
            yield Difference(f"{name}, {end} end", mine, their, apart, allowed, "of the interval's width")
    profile, their_profile = np.asarray(own["performance profile"]), np.asarray(other["performance profile"])
    at = int(np.abs(profile - their_profile).argmax())
    apart = float(np.abs(profile - their_profile)[at])
    yield Difference("performance profile, where furthest apart", profile[at], their_profile[at], apart, EXACT, "")


def table(found: list[Difference]) -> Iterator[str]:
    """Readable lines, as Markdown."""
    yield "| statistic | ours | rliable | difference | allowed |"
    yield "|---|---|---|---|---|"
    for each in found:
        unit = f" {each.unit}" if each.unit else ""
        yield f"| {each.what} | {each.ours:.6f} | {each.theirs:.6f} | {each.difference:.2g}{unit} | {each.allowed:g} |"


def main() -> int:
    try:
        x, y = scores()
        found = list(differences(ours(x, y), theirs(x, y)))
    except ReskpnError as error:
        print(f"statistics: {error}", file=sys.stderr)
        return error.exit_code
    for line in table(found):
        print(line)
    wrong = [each.what for each in found if not each.agrees]
    print(f"\ndiffers by more than allowed: {'; '.join(wrong)}" if wrong else "\nall agree")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
