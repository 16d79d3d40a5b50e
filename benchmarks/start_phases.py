"""What the learner or an actor does before its first update or rollout, phase by phase; for `benchmarks.start`.

    python -m benchmarks.start_phases --role actor --task hopper --num-envs 2048

Prints one JSON object on one line: seconds and CPU seconds by phase, the programs that were asked of JAX's compilation
cache and those found there, and the digest of what was computed in the end.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from typing import Any

from common.config.settings import RunSettings
from common.config.sources import add_options, load
from common.errors import ReskpnError

ROLES = ("learner", "actor")

ASKED, FOUND = "/jax/compilation_cache/compile_requests_use_cache", "/jax/compilation_cache/cache_hits"
"""Names of JAX's events: a program was asked of the cache; it was found there."""


class Phases:
    """Seconds by phase, and JAX's events, since this object was made."""

    def __init__(self) -> None:
        self.seconds: dict[str, tuple[float, float]] = {}
        self._events: dict[str, int] = {}
        self._clocks = time.perf_counter(), time.process_time()

    def end(self, name: str) -> None:
        """The phase that ended just now."""
        wall, cpu = time.perf_counter(), time.process_time()
        self.seconds[name] = wall - self._clocks[0], cpu - self._clocks[1]
        self._clocks = wall, cpu

    def listen(self) -> None:
        """Count JAX's events from now on."""
        from jax import monitoring

        monitoring.register_event_listener(self._count)

    def report(self, digest: str) -> dict[str, Any]:
        programs, cached = (self._events.get(name, 0) for name in (ASKED, FOUND))
        return {"seconds": self.seconds, "programs": programs, "cached": cached, "digest": digest}

    def _count(self, event: str, **_: str | int) -> None:
        self._events[event] = self._events.get(event, 0) + 1


def start_learner(settings: RunSettings) -> dict[str, Any]:
    """The initial state, and the update compiled; the digest is that of the state."""
    phases = Phases()
    from common.runtime import enable_compilation_cache
    from services.learner.training.trainer import Trainer

    phases.listen()
    enable_compilation_cache()
    phases.end("imports")
    trainer = Trainer(settings)
    phases.end("initial state")
    trainer.compile()
    phases.end("update")
    return phases.report(trainer.digest())


def start_actor(settings: RunSettings) -> dict[str, Any]:
    """The environments, the rollout and the evaluation at the end of a run, compiled.

    The digest is that of a rollout of the initial policy.
    """
    phases = Phases()
    from common.physics.engines import require_synchronous_dispatch
    from common.runtime import enable_compilation_cache
    from common.wire.messages import digest_arrays
    from services.actor.collector import Collector, SlotGeneration
    from services.worker.deterministic import DeterministicEpisodes
    from services.worker.policy_reader import PolicyReader

    phases.listen()
    enable_compilation_cache()
    require_synchronous_dispatch()
    phases.end("imports")
    reader = PolicyReader(settings)
    collector = Collector(settings, SlotGeneration(0, 0), reader)
    phases.end("environments")
    collector.compile()
    phases.end("rollout")
    steps = collector.collect(reader.initial())[0].trajectory
    phases.end("one rollout")
    DeterministicEpisodes(settings, reader, settings.evaluation.episodes or 1).compile()
    phases.end("evaluation")
    return phases.report(digest_arrays({"obs": steps.obs, "action": steps.action, "reward": steps.reward}))


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.start_phases",
        description="One start of a learner or an actor, phase by phase. Every setting of a run is an option.",
        usage="%(prog)s --role learner|actor [options]",
        allow_abbrev=False,
    )
    parser.add_argument("--role", choices=ROLES, required=True, help="whose start")
    options = add_options(parser)
    given = parser.parse_args(arguments)
    try:
        settings = load(options, given, config=given.config)
        report = start_learner(settings) if given.role == "learner" else start_actor(settings)
    except ReskpnError as error:
        print(f"start_phases: {error}", file=sys.stderr)
        return error.exit_code
    print(json.dumps(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())
