"""The page beside a run of `train`: there at once, and gone with the run."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from common.config.settings import RunSettings
from reskpn.supervision.live_page import live_page


def test_the_page_of_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its address is printed before anything else, and answers although the learner has written nothing yet."""
    run_dir = tmp_path / "run"
    run_dir.mkdir()
    with live_page(RunSettings(run_dir=run_dir)):
        (line,) = capsys.readouterr().out.splitlines()
        address = line.split()[2]
        assert line == (f"live page: {address} (until the run ends; afterwards: reskpn dashboard --run-dir {run_dir})")
        # The socket takes the connection at once; the answer comes when the process has loaded.
        with urllib.request.urlopen(f"{address}stream", timeout=60.0) as stream:
            lines = [stream.readline() for _ in range(2)]
        told = json.loads(lines[1].removeprefix(b"data: "))
        assert told["shown"] == ["run"]
        assert told["runs"][0]["state"] == "starting"
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(f"{address}health", timeout=5.0)
