"""A learner without updates: the real hub, fleet and log, and policies of the real size.

`python -m benchmarks.ingest_learner SETTINGS FOLDER SECONDS` prints one JSON object. SETTINGS is a run's as JSON.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from common.config.settings import RunSettings
from common.errors import ProcessError
from common.log.writer import LogWriter
from common.maths.trees import to_arrays
from common.wire.rollout import Rollout
from common.wire.session import open_session
from services.learner.endpoints.hub import Hub
from services.learner.training.snapshots import make_snapshot
from services.worker.policy_reader import PolicyReader

RUN = "ingest"
JOIN_S = 120.0
TICK_S = 0.5
WARM_UP = 3


@dataclass(frozen=True)
class Ingest:
    """Measured values; CPU seconds are those of the whole process, including its log and network threads.

    Attributes:
        idle_cpu: CPU seconds a second while the actors are there and have nothing to do.
        seconds, cpu_s, rollouts: of the busy time.
        rollout_bytes, snapshot_bytes: of one message.
    """

    actors: int
    idle_cpu: float
    seconds: float
    cpu_s: float
    rollouts: int
    rollout_bytes: int
    snapshot_bytes: int
    steps_per_rollout: int


class Server:
    """Publish one version after the other, each as soon as all rollouts of the last are in the log."""

    def __init__(self, settings: RunSettings, hub: Hub, log: LogWriter) -> None:
        self._settings = settings
        self._hub = hub
        self._log = log
        self._arrays = to_arrays(PolicyReader(settings).initial())
        self.version = 0
        self.snapshot_bytes = len(hub.publish(make_snapshot(RUN, 0, self._arrays), collect=False))

    def measure(self, seconds: float) -> Ingest:
        """Measure an idle and then a busy period. Raises ProcessError if the actors do not join."""
        actors = self._settings.actors
        self._tick_until(lambda: self._hub.actors() == actors)
        began_s, began_cpu_s = time.perf_counter(), time.process_time()
        self._tick_until(lambda: time.perf_counter() - began_s >= seconds)
        idle = (time.process_time() - began_cpu_s) / (time.perf_counter() - began_s)
        for _ in range(WARM_UP):
            rollouts = self._next()
        began_s, began_cpu_s, first = time.perf_counter(), time.process_time(), self.version
        while time.perf_counter() - began_s < seconds:
            self._next()
        return Ingest(
            actors=actors,
            idle_cpu=idle,
            seconds=time.perf_counter() - began_s,
            cpu_s=time.process_time() - began_cpu_s,
            rollouts=(self.version - first) * actors,
            rollout_bytes=len(rollouts[0].encode()),
            snapshot_bytes=self.snapshot_bytes,
            steps_per_rollout=self._settings.envs_per_actor * self._settings.num_steps,
        )

    def _next(self) -> list[Rollout]:
        """Publish the next version and receive its rollouts as the learner's loop does."""
        self.version += 1
        self._hub.publish(make_snapshot(RUN, self.version, self._arrays))
        deadline_s = time.monotonic() + JOIN_S
        while (rollouts := self._hub.rollouts(TICK_S)) is None:
            self._hub.announce()
            if time.monotonic() > deadline_s:
                raise ProcessError(f"no rollouts of version {self.version}: {self._hub.waiting_for()}")
        places = [{"slot": one.slot, "generation": one.generation, "seq": one.seq} for one in rollouts]
        self._log.write("/update", {"version": self.version, "rollouts": places})
        return rollouts

    def _tick_until(self, condition: Callable[[], bool]) -> None:
        deadline_s = time.monotonic() + JOIN_S
        while not condition():
            self._hub.announce()
            if time.monotonic() > deadline_s:
                raise ProcessError(f"only {self._hub.actors()} actors joined; their messages are on standard error")
            time.sleep(TICK_S)


def serve(settings: RunSettings, folder: Path, seconds: float) -> Ingest:
    """Listen at the settings' endpoint until the measurement is complete."""
    transport = settings.transport
    with (
        open_session(listen=[transport.endpoint], max_message_size=transport.max_message_bytes) as session,
        LogWriter(folder, segment_bytes=settings.log.segment_bytes) as log,
    ):
        hub = Hub(RUN, settings, session, log, lambda level, name, text: None)
        server = Server(settings, hub, log)
        hub.open()
        try:
            return server.measure(seconds)
        finally:
            deadline_s = time.monotonic() + TICK_S * 10
            while hub.actors() and time.monotonic() < deadline_s:
                hub.finish()
                time.sleep(TICK_S / 10)


if __name__ == "__main__":
    found = serve(RunSettings.model_validate_json(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]))
    print(json.dumps(asdict(found)))
