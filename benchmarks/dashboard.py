"""The cost of the live page to a learner, and of the page itself: `python -m benchmarks.dashboard`.

A stand-in for a learner, in this process, writes a log with rollouts and updates, publishes each update and answers
status requests of a run with 16 actors; it does not train, so that what it spends on its readers can be seen. Its CPU
time is taken in turns with and without a dashboard, and an open page, beside it.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from common.log.records import encode_json
from common.log.writer import LogWriter
from common.wire.endpoint import free_port
from common.wire.keys import STATUS, Keys
from common.wire.report import ActorReport, Progress, RunReport, Totals
from common.wire.session import Session, open_session

RUN = "hopper-reskpn-s0-000000"
ACTORS = 16

# A browser's part: opens the stream and reads what comes.
READER = "import sys, urllib.request\nfor line in urllib.request.urlopen(sys.argv[1] + 'stream'): pass"


def report(version: int, endpoint: str) -> RunReport:
    """The report of a run with 16 actors, made anew for each request as a learner does."""
    actors = [
        ActorReport(
            slot=slot, generation=0, incarnation=f"{slot:08x}", host="host-1", state="collecting", state_s=0.1,
            physics="native", version=version, snapshot_age_s=0.1, env_steps=1000 * version, steps_per_s=1000.0,
            heard_s=0.2, accepted=version, refused=0, busy=0, repeated=0,
        )
        for slot in range(ACTORS)
    ]  # fmt: skip
    progress = Progress(
        phase="training", text="", version=version, updates=10**6, env_steps=20480 * version, total_steps=20480 * 10**6,
        steps_per_s=1e5, train_return=100.0, step_reward=1.0, staleness=0.0, centres=100, capacity=100,
    )  # fmt: skip
    return RunReport(
        run=RUN, task="hopper", learner="reskpn", endpoint=endpoint, t_ns=time.time_ns(), up_s=1.0, progress=progress,
        waiting_for="", rollouts_there=0, slots=ACTORS, actors=actors, vacancies=[], totals=Totals(), refusals={},
        refused_joins={}, last_refusal=None,
    )  # fmt: skip


def update(version: int) -> dict[str, Any]:
    """An `/update` record of the usual size."""
    names = (
        "train/policy_loss", "train/value_loss", "train/kl", "train/entropy", "train/explained_variance", "policy/std",
        "rkhs/centres", "rkhs/share", "rkhs/step_kl", "rkhs/norm", "rkhs/alpha", "train/clip_fraction",
    )  # fmt: skip
    phases = ("wait", "learner", "publish", "record", "log", "actor/physics", "actor/collect", "actor/push")
    rollouts = [{"slot": slot, "incarnation": f"{slot:032x}", "seq": version} for slot in range(ACTORS)]
    return {
        "version": version,
        "env_steps": 20480 * version,
        "rollouts": rollouts,
        "metrics": {name: 0.125 for name in names},
        "seconds": {name: 0.01 for name in phases},
        "staleness": {"min": 0, "mean": 0.0, "max": 0},
        "progress": {"return": 100.0, "step_reward": 1.0, "steps_per_s": 1e5},
    }


class StandIn:
    """Writes and publishes so many updates a second until it is stopped."""

    def __init__(self, run_dir: Path, endpoint: str, session: Session, per_s: float, rollout_bytes: int) -> None:
        self._endpoint = endpoint
        self._version = 0
        self._stop = threading.Event()
        self._log = LogWriter(run_dir / "log")
        self._publisher = session.publisher(Keys(RUN).metrics)
        self._period_s, self._rollout = 1.0 / per_s, os.urandom(rollout_bytes)
        settings = {"task": "hopper", "learner": "reskpn", "transport": {"endpoint": endpoint}}
        (run_dir / "settings.json").write_text(json.dumps(settings))
        self._log.write("/spec", {"run": RUN, "settings": settings})
        session.serve(STATUS, lambda request: request.reply(report(self._version, endpoint).encode()))
        self._thread = threading.Thread(target=self._write)
        self._thread.start()

    def _write(self) -> None:
        while not self._stop.wait(self._period_s):
            self._version += 1
            self._log.write("/rollout", self._rollout)
            record = update(self._version)
            self._log.write("/update", record)
            self._publisher.put(encode_json(record))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._log.close()


def cpu_of(process: subprocess.Popen[str]) -> float:
    """Seconds of CPU that a process has used."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def window(seconds: float, dashboard: subprocess.Popen[str] | None = None) -> tuple[float, float]:
    """Shares of a core that this process and the dashboard use over that time."""
    began_s, own_s = time.monotonic(), time.process_time()
    page_s = cpu_of(dashboard) if dashboard is not None else 0.0
    time.sleep(seconds)
    spent_s = time.monotonic() - began_s
    page = (cpu_of(dashboard) - page_s) / spent_s if dashboard is not None else 0.0
    return (time.process_time() - own_s) / spent_s, page


def beside(arguments: list[str], seconds: float) -> tuple[float, float]:
    """The same with a dashboard and an open page, once both have settled."""
    command = [sys.executable, "-m", "reskpn", "dashboard", "--supervised", *arguments]
    dashboard = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert dashboard.stdout is not None
    address = next(word for word in dashboard.stdout.readline().split() if word.startswith("http://"))
    page = subprocess.Popen([sys.executable, "-c", READER, address])
    try:
        time.sleep(5.0)
        return window(seconds, dashboard)
    finally:
        page.kill()
        page.wait()
        dashboard.terminate()
        dashboard.communicate()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=15.0, help="of each measurement")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--updates-per-s", type=float, default=5.0)
    parser.add_argument("--rollout-bytes", type=float, default=2e6, help="of each update in the log")
    given = parser.parse_args()
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with tempfile.TemporaryDirectory() as folder, open_session(listen=[endpoint], max_message_size=1 << 20) as session:
        stand_in = StandIn(Path(folder), endpoint, session, given.updates_per_s, round(given.rollout_bytes))
        try:
            for name, arguments in {"--run-dir": ["--run-dir", folder], "--endpoint": ["--endpoint", endpoint]}.items():
                pairs = [(window(given.seconds)[0], *beside(arguments, given.seconds)) for _ in range(given.repeats)]
                added = [with_page - without for without, with_page, _ in pairs]
                own = [page for _, _, page in pairs]
                print(
                    f"{name}: the learner spends {100 * statistics.median(added):.2f} % of a core on the page "
                    f"({', '.join(f'{100 * one:.2f}' for one in added)}), "
                    f"the dashboard itself {100 * statistics.median(own):.1f} %"
                )
        finally:
            stand_in.close()


if __name__ == "__main__":
    main()
