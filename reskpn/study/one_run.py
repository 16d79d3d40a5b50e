"""Runs of a study in a process, one after another: what to make on standard input, progress on standard output.

    python -m reskpn.study.one_run

Each line of input is a JSON object, `{"path": "out.json", "settings": "{...}"}`; the result is written to `path`. Each
line of output is one, too: `{"update": 3, "updates": 97, "return": 18.4}` on the way, `{"finished": true}` after each
run. The process ends where the input does, or with the first run that fails.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from common.config.settings import RunSettings
from common.config.sources import parse_json
from common.errors import ReskpnError
from common.learners import LEARNERS
from common.maths import running
from reskpn.study.curves import Curve
from reskpn.study.in_process import InProcess, Step, prepare
from reskpn.study.results import Result, Timing, identity, relevant, revision, score
from reskpn.study.writing import origin, write_result

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
COLUMNS = 16
"""Observations and features whose spread is kept: all 256 would be most of the file."""

TELL_S = 2.0


def main() -> int:
    """Make the runs, and exit with the code of the error's class if one fails."""
    try:
        for line in sys.stdin:
            order = json.loads(line)
            write_result(run(parse_json(order["settings"]), _tell), Path(order["path"]))
            print(json.dumps({"finished": True}), flush=True)
    except ReskpnError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    return 0


def run(settings: RunSettings, tell: Callable[[Curve, int], None] = lambda curve, updates: None) -> Result:
    """Train by these settings in this process, and evaluate the final policy.

    Args:
        tell: called every few seconds with the curve so far and the number of updates.
    """
    prepare()
    work, curve = InProcess(settings), Curve(settings.batch_size)
    seconds: dict[str, float] = {}
    began_s, cpu_began_s, told_s = time.perf_counter(), time.process_time(), 0.0
    for _ in range(settings.updates):
        step = work.step()
        _add(curve, step)
        for phase, spent_s in step.seconds.items():
            seconds[phase] = seconds.get(phase, 0.0) + spent_s
        if time.monotonic() - told_s > TELL_S:
            told_s = time.monotonic()
            tell(curve, settings.updates)
    wall_s, cpu_s = time.perf_counter() - began_s, time.process_time() - cpu_began_s
    timing = Timing(
        wall_s=round(wall_s, 3),
        cpu_s=round(cpu_s, 3),
        env_steps_per_s=round(settings.updates * settings.batch_size / wall_s, 1),
        seconds={name: round(spent_s, 3) for name, spent_s in sorted(seconds.items())},
    )
    episodes = settings.evaluation.episodes
    returns = work.evaluate(episodes).astype(np.float64) if episodes else None
    evaluation = None if returns is None else {"mean": float(returns.mean()), "std": float(returns.std())}
    return Result(
        identity=identity(settings),
        revision=revision(settings),
        settings=relevant(settings),
        route="in-process",
        engine=work.physics,
        curve=curve.table(),
        scores=score(curve, settings.episode_length, evaluation),
        spreads=_spreads(settings, work, step),
        timing=timing,
        digest=work.digest(),
        **origin(),
    )


def _add(curve: Curve, step: Step) -> None:
    curve.add(step.rollout.episode_return, float(step.rollout.reward.mean(dtype=np.float64)), step.metrics)


def _tell(curve: Curve, updates: int) -> None:
    print(json.dumps({"update": curve.updates, "updates": updates, "return": curve.newest_return()}), flush=True)


def _spreads(settings: RunSettings, work: InProcess, step: Step) -> dict[str, list[list[float]]]:
    """Quantiles of whitened observations and of features psi(o) over the last batch, and the means of their variances.

    Nothing for a learner without features.
    """
    if not LEARNERS[settings.learner].features:
        return {}
    raw, policy = jnp.asarray(step.rollout.obs.reshape(-1, step.rollout.obs.shape[-1])), work.policy()
    seen = running.standardise(policy.observations, raw) if settings.algorithm.normalise_observations else raw
    observations, features = np.asarray(seen), np.asarray(work.reader.features(policy, raw))
    return {
        "observations": _quantiles(observations[:, :COLUMNS]),
        "features": _quantiles(features[:, :COLUMNS]),
        "mean_variance": [[float(f"{np.var(x, axis=0).mean():.6g}") for x in (observations, features)]],
    }


def _quantiles(values: np.ndarray) -> list[list[float]]:
    """[columns][quantiles], to 5 digits."""
    found = np.quantile(values.astype(np.float64), QUANTILES, axis=0).T
    return [[float(f"{value:.5g}") for value in column] for column in found]


if __name__ == "__main__":
    sys.exit(main())
