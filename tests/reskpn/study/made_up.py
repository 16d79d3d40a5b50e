"""Results that no run has made, for tests of what is done with results."""

from __future__ import annotations

import numpy as np

from common.config.settings import RunSettings
from reskpn.study.curves import Curve
from reskpn.study.planning import Trial
from reskpn.study.results import Result, Timing, identity, relevant, revision, score
from reskpn.study.store import Store
from reskpn.study.writing import write_result

VERSIONS = {"jax": "0.10.2", "jaxlib": "0.10.2", "mujoco": "4.0.0"}


def made_up(settings: RunSettings, height: float = 100.0, versions: dict[str, str] = VERSIONS) -> Result:
    """A result whose curve climbs from 10 to `height`; spread and noise depend on the seed alone."""
    updates = min(settings.updates, 60)
    random, curve = np.random.default_rng(settings.seed), Curve(settings.batch_size)
    for update in range(updates):
        level = 10 + (height - 10) * (update + 1) / updates + 4 * random.standard_normal()
        metrics = {"train/kl": 0.01, "variance/gradient": 100.0 / (update + 1) + random.random()}
        metrics |= {f"variance/{name}_std": base + random.random() for name, base in (("q", 5), ("v", 4), ("a", 1))}
        metrics |= {f"variance/{name}": base for name, base in (("a_less_h", 1.0), ("mu", 0.3), ("a_less_h_mu", 0.9))}
        curve.add(level + random.standard_normal(8), level / settings.episode_length, metrics)
    quantiles = [[-2.0, -1.0, 0.0, 1.0, 2.0]] * 4
    return Result(
        identity=identity(settings),
        revision=revision(settings),
        settings=relevant(settings),
        route="in-process",
        engine="native",
        curve=curve.table(),
        scores=score(curve, settings.episode_length, {"mean": height, "std": 5.0}),
        spreads={"observations": quantiles, "features": quantiles * 3, "mean_variance": [[1.0, 0.25]]},
        timing=Timing(wall_s=20.0, cpu_s=30.0, env_steps_per_s=1e4, seconds={"learner": 10.0, "physics": 8.0}),
        digest=f"{settings.seed:016x}",
        commit="0" * 40,
        versions=versions,
        machine={"cpu": "none", "cores": "2"},
        finished_at="2026-01-01T00:00:00+00:00",
    )


def fill(store: Store, trials: list[Trial], missing: int = 0) -> None:
    """Results for all trials but the last `missing`, each arm a little better than the one before."""
    arms = list(dict.fromkeys(trial.arm for trial in trials))
    for trial in trials[: len(trials) - missing]:
        result = made_up(trial.settings, 100.0 + 40.0 * arms.index(trial.arm))
        write_result(result, store.path(trial.settings))
        store.reread(trial.settings)
