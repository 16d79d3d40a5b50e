"""`reskpn evaluate`: episodes of any version of a recorded run, without exploration."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from common.engine_names import PHYSICS
from common.errors import SettingsError
from common.printable import printable
from reskpn.commands.command import EXIT_CODES, Command
from reskpn.commands.task_option import add_task, confirm_task

if TYPE_CHECKING:
    from common.config.settings import RunSettings
    from services.replay.policies import RecordedPolicy
    from services.worker.deterministic import Episodes

EPILOG = f"""\
A policy that the log does not hold (it has every log.policy_every-th and the last)
is recomputed from the log, which takes as long as the learner took for it. The
initial states depend on the seed alone, so that versions can be compared on the
same ones.

{EXIT_CODES}"""


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("path", type=Path, metavar="RUN", help="directory of a run, or its log directory")
    add_task(parser)
    add("--version", type=int, metavar="V", help="version of the policy; 0: before training (default: the newest)")
    add("--episodes", type=int, default=16, metavar="N", help="number of episodes (default: %(default)s)")
    add("--seed", type=int, metavar="N", help="seed of the initial states (default: the run's own)")
    add("--physics", choices=PHYSICS, help="physics engine (default: the run's own)")
    add("--threads", type=int, default=0, metavar="N", help="threads of the native engine (default: one per core)")
    add("--json", action="store_true", help="print one JSON object with every episode, for machines")


def run(given: argparse.Namespace) -> int:
    """Play the episodes and print their returns. Returns 0."""
    _check(given)
    from common.physics.engines import require_synchronous_dispatch
    from common.runs.recorded_run import open_run
    from common.runtime import enable_compilation_cache
    from reskpn.commands.progress import recomputing
    from services.learner.training.trainer import Trainer
    from services.replay.policies import recorded_policy
    from services.worker.deterministic import DeterministicEpisodes
    from services.worker.policy_reader import PolicyReader

    recorded = open_run(given.path)
    confirm_task(recorded.settings, given.task)
    enable_compilation_cache()
    require_synchronous_dispatch()
    with recomputing(given.version) as on_update:
        found = recorded_policy(recorded, given.version, lambda: Trainer(recorded.settings), on_update)
    settings = _played_settings(recorded.settings, given)
    reader = PolicyReader(recorded.settings)
    began_s = time.monotonic()
    episodes = DeterministicEpisodes(settings, reader, given.episodes, given.threads)
    played = episodes.play(reader.read(found.arrays))
    took_s = time.monotonic() - began_s
    name = printable(recorded.run)
    lines = _as_json(name, found, settings, played)
    for line in lines if given.json else _lines(name, found, settings, played, took_s):
        print(line)
    return 0


def _as_json(run: str, found: RecordedPolicy, settings: RunSettings, played: Episodes) -> Iterator[str]:
    yield json.dumps(
        {
            "run": run,
            "version": found.version,
            "seed": settings.seed,
            "physics": settings.physics,
            "recomputed": found.recomputed,
            "exact": found.exact,
            "returns": played.returns.tolist(),
            "lengths": played.lengths.tolist(),
        }
    )


def _lines(run: str, found: RecordedPolicy, settings: RunSettings, played: Episodes, took_s: float) -> Iterator[str]:
    origin = "recomputed from the log" if found.recomputed else "from the log"
    yield f"{run}: policy {found.version} ({origin}), seed {settings.seed}, physics {settings.physics}"
    if not found.exact:
        yield "the recomputed state is not the recorded one, bit for bit: `reskpn replay RUN --verify` says why"
    returns = played.returns
    yield (
        f"return {returns.mean():,.1f} ± {returns.std():,.1f} (from {returns.min():,.1f} to {returns.max():,.1f}) over "
        f"{len(returns)} episodes of {played.lengths.mean():,.0f} steps on average, in {took_s:.1f} s"
    )


def _played_settings(recorded: RunSettings, given: argparse.Namespace) -> RunSettings:
    """The run's settings with the seed and the engine of the episodes."""
    from common.physics.engines import resolve_physics

    return recorded.model_copy(
        update={
            "seed": recorded.seed if given.seed is None else given.seed,
            "physics": resolve_physics(given.physics or recorded.physics),
        }
    )


def _check(given: argparse.Namespace) -> None:
    """SettingsError for a number outside its range."""
    from common.wire.assessment import MAX_EPISODES

    for name, value, low, high in (
        ("--episodes", given.episodes, 1, MAX_EPISODES),
        ("--threads", given.threads, 0, None),
        ("--seed", given.seed or 0, 0, 2**32 - 1),
        ("--version", given.version or 0, 0, None),
    ):
        if value < low or (high is not None and value > high):
            allowed = f"{low} or more" if high is None else f"{low} to {high}"
            raise SettingsError(f"{name} is {value}; allowed: {allowed}")


COMMAND = Command(add_options, run, EPILOG, usage="reskpn evaluate RUN [options]")
