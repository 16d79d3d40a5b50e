"""`reskpn sweep --service`: a study's runs made by learner and actor processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]

SWEEP = """
title: Small
tasks: [inverted_pendulum]
arms:
  one: {learner: reskpn, settings: {rkhs.capacity: 16}}
settings:
  physics: native
  num_envs: 16
  num_steps: 8
  episode_length: 40
  algorithm.minibatches: 4
  algorithm.epochs: 2
  algorithm.hidden: [16, 16]
  evaluation.episodes: 4
drawing: {kind: scores, reference: one}
scales:
  laptop: {steps: 512, seeds: 1}
"""


def made(folder: Path, *options: str) -> dict[str, Any]:
    """The result of the one run, made in a folder of its own."""
    folder.mkdir()
    (folder / "small.yaml").write_text(SWEEP)
    command = [sys.executable, "-m", "reskpn", "sweep", "small.yaml", *options]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=390)
    assert done.returncode == 0, done.stdout + done.stderr
    (path,) = [path for path in folder.rglob("*.json") if "reskpn-s0" in path.name]
    found: dict[str, Any] = json.loads(path.read_text())
    return found


@pytest.mark.timeout(800)
def test_the_service_ends_as_one_process_does(tmp_path: Path) -> None:
    """Same digest, scores and curve; only times differ."""
    service, process = made(tmp_path / "service", "--service"), made(tmp_path / "process")
    for name in ("digest", "scores", "settings", "engine", "curve"):
        assert service[name] == process[name], name
    assert (service["route"], process["route"]) == ("service", "in-process")
