"""Checks of the task that `--task` names: its first states, a hundred steps, and what MJX makes of it."""

from __future__ import annotations

from collections.abc import Iterator

from common.config.settings import RunSettings
from reskpn.doctor.findings import Finding, Level, guarded

STEPS = 100
ONE_STEP = 0.01
"""Largest harmless difference of the engines after one step, of a velocity or a reward."""


def examine_task(settings: RunSettings) -> Iterator[Finding]:
    """The findings for the task; the engines are compared unless the run's is the native one."""
    yield guarded("task", lambda: check_task(settings))
    yield guarded("model", lambda: check_model(settings))
    if settings.physics != "native":
        yield guarded("engines", lambda: check_engines(settings))


def check_task(settings: RunSettings) -> Finding:
    """Reset a few environments and step them under random actions with the native engine."""
    import jax
    import numpy as np

    from common.physics.comparison import ENVIRONMENTS, play
    from common.physics.engines import require_synchronous_dispatch
    from common.physics.environments import make_environment

    require_synchronous_dispatch()
    environment = make_environment(
        settings.task, "native", num_envs=ENVIRONMENTS, episode_length=settings.episode_length
    )
    first = environment.reset(jax.random.key(settings.seed))
    wrong = sorted({int(column) for column in np.argwhere(~np.isfinite(np.asarray(first.obs)))[:, 1]})
    if wrong:
        text = f"the first observation of {settings.task} is not finite at {', '.join(map(str, wrong[:8]))}"
        return Finding("task", "problem", text, "look for divisions by 0, roots and logarithms in observation()")
    actions = np.random.default_rng(settings.seed).uniform(-1, 1, (STEPS, ENVIRONMENTS, environment.action_size))
    track = play(environment, first, actions.astype(np.float32))
    count = int((track.steps < STEPS).sum())
    ended = f", {count} of {ENVIRONMENTS} episodes ended" if count else ""
    text = (
        f"{settings.task}: observation {environment.observation_size}, action {environment.action_size}, step "
        f"{environment.step_s:g} s, episodes of {settings.episode_length}; {STEPS} random steps, mean reward "
        f"{track.reward.mean():.3g}{ended}"
    )
    return Finding("task", "ok", text, figures={"mean_reward": float(track.reward.mean())})


def check_model(settings: RunSettings) -> Finding:
    """List what MJX would simulate otherwise than MuJoCo."""
    from common.physics.mjx_differences import differences_of

    found = differences_of(settings.task)
    if not found:
        return Finding("model", "ok", "nothing is known in it that MJX simulates otherwise than MuJoCo")
    level: Level = "ok" if settings.physics == "native" else "warning"
    return Finding("model", level, "MJX would simulate another model: " + "; ".join(found), "or choose physics native")


def check_engines(settings: RunSettings) -> Finding:
    """Compare the two engines from the same states under the same actions."""
    from common.physics.comparison import compare_engines

    found = compare_engines(settings.task, STEPS, settings.seed)
    parts = [f"after {a.after}: qpos {a.qpos:.0e}, qvel {a.qvel:.0e}, reward {a.reward:.0e}" for a in found]
    figures = {f"{name}_after_{a.after}": getattr(a, name) for a in found for name in ("qpos", "qvel", "reward")}
    text = f"native and mjx apart {'; '.join(parts)}" if parts else "all episodes ended in the first step"
    if found and max(found[0].qvel, found[0].reward) > ONE_STEP:
        return Finding("engines", "warning", text, "they simulate different models; see docs/physics.md", figures)
    return Finding("engines", "ok", text, figures=figures)
