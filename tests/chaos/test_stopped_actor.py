"""A real run, watched from outside while one of its actors is stopped and goes on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from common.wire.report import RunReport
from common.wire.status_request import ask, connect
from reskpn.commands.status import endpoint_of
from tests.integration.small_runs import ACTORS, TICK, small_run

LEASE_S = 2.0
LATE_S = 4.0
"""What a machine with other work may add to it."""

pytestmark = pytest.mark.timeout(400)


def test_a_stopped_actor_is_noticed_and_comes_back(tmp_path: Path) -> None:
    """Stopped, not dead: silence for the lease frees its slot, the run goes on, and it joins again when it goes on."""
    with small_run(tmp_path / "run", updates=100_000) as training:
        training.wait_for(lambda: len(training.updates()) >= 3)
        endpoint = endpoint_of(training.run_dir)
        stopped = training.children()["actor"][0]
        with connect(endpoint) as session:

            def report_once(condition: Callable[[RunReport], bool], deadline_s: float = 120.0) -> RunReport:
                end = time.monotonic() + deadline_s
                while not condition(found := ask(session, endpoint)):
                    assert time.monotonic() < end, found.model_dump_json(indent=1)
                    TICK.wait(0.02)
                return found

            before = report_once(lambda report: len(report.actors) == ACTORS)
            known = {actor.incarnation for actor in before.actors}
            os.kill(stopped, signal.SIGSTOP)
            try:
                alone = report_once(lambda report: len(report.actors) < ACTORS, LEASE_S + LATE_S)
                assert [vacancy.lost for vacancy in alone.vacancies] == [True]
                # The other actor does its work.
                assert alone.progress is not None
                version = alone.progress.version
                report_once(lambda report: report.progress is not None and report.progress.version >= version + 3)
            finally:
                os.kill(stopped, signal.SIGCONT)
            whole = report_once(
                lambda report: len(report.actors) == ACTORS and all(actor.accepted > 0 for actor in report.actors)
            )
        (new,) = [actor for actor in whole.actors if actor.incarnation not in known]
        assert (new.slot, new.generation) == (alone.vacancies[0].slot, 1)
        assert whole.totals.lost == 1
        # And as a person or a script asks, in a process of its own.
        command = [sys.executable, "-m", "reskpn", "status", "--run-dir", str(training.run_dir), "--json"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["run"] == whole.run
