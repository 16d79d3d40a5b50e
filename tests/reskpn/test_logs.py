"""Recorded runs in Python."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from recorded_runs import UPDATES, made_up, write_log

ROOT = Path(__file__).parents[2]


def test_the_documented_example_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The one in docs/replay.md, word for word, with a run in runs/x."""
    write_log(tmp_path / "runs" / "x", made_up().messages)
    monkeypatch.chdir(tmp_path)
    (example,) = [part.split("```")[0] for part in (ROOT / "docs" / "replay.md").read_text().split("```python\n")[1:]]
    exec(compile(example, "docs/replay.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "run-1 inverted_pendulum"
    assert len(lines) == 1 + UPDATES
    assert [line.split()[:2] for line in lines[1:]] == [["1", "0.1"], ["2", "0.2"], ["3", "0.3"], ["4", "0.4"]]


def test_logs_are_read_without_jax() -> None:
    """So that a notebook opens them at once."""
    program = "import sys, reskpn.logs; raise SystemExit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], cwd=ROOT).returncode == 0
