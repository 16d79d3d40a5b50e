"""`reskpn.train` for real: from a script without a main guard, in a thread that is not the main one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

SCRIPT = """
import threading
import reskpn

told = []
found = []

def work():
    found.append(reskpn.train(
        "inverted_pendulum", run_dir="run", num_envs=32, num_steps=8, total_steps=5120, actors=2, physics="native",
        episode_length=40, algorithm={"minibatches": 4, "epochs": 2, "hidden": [16, 16]},
        evaluation={"episodes": 8}, on_progress=told.append,
    ))

thread = threading.Thread(target=work)
thread.start()
thread.join()
(run,) = found
assert run.state == "finished", run
assert run.version == 20 == told[-1].version, told
assert told[-1].phase == "finished"
curves = run.curves()
assert len(curves["return"]) == 20
assert run.frame()["train/kl"].notna().all()
assert run.summary["complete"]
assert len(run.evaluations()) == 1
assert run.trajectories()[0].motion.qpos.shape[1] == 2
assert abs(run.policy().act([0.0, 0.1, 0.0, 0.0])[0]) <= 1.0
print("done")
"""


@pytest.mark.timeout(400)
def test_a_script(tmp_path: Path) -> None:
    """It trains to the end, is told of it, and reads the run."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, script], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=390
    )
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr
