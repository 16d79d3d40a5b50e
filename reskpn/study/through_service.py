"""A run of a study through the service: a learner and an actor as processes, and the result from the log."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import yaml

from common.config.settings import RunSettings
from common.wire.endpoint import free_port
from reskpn.study.recorded import read_run, result_of
from reskpn.study.running import Work, check_exit
from reskpn.study.writing import now, write_result


def through_service(settings: RunSettings, path: Path, work: Work) -> None:
    """Make one run with `reskpn train`; the result is written to `path`, the run directory is removed.

    Raises:
        LogWriteError: the result could not be written.
        ProcessError: the run failed.
    """
    with tempfile.TemporaryDirectory(prefix="reskpn-study-") as folder:
        run_dir, config = Path(folder) / "run", Path(folder) / "settings.yaml"
        values = settings.model_dump(mode="json", exclude={"run_dir"})
        values["transport"]["endpoint"] = f"tcp/127.0.0.1:{free_port()}"
        config.write_text(yaml.safe_dump(values))
        command = [sys.executable, "-m", "reskpn", "train", "--config", str(config), "--run-dir", str(run_dir)]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
            work.process = process
            assert process.stderr is not None
            errors = list(process.stderr)
        check_exit(process.returncode, errors)
        result = result_of(read_run(run_dir))
        write_result(result.model_copy(update={"finished_at": now()}), path)
