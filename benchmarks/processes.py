"""New processes for measurements, without memory, compiled programs or settings of earlier ones."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from common.config.sources import OTHER_VARIABLES, PREFIX
from common.errors import ProcessError

ROOT = Path(__file__).parent.parent


def bare_environment() -> dict[str, str]:
    """This process's environment variables without those that set a run's settings."""
    return {name: value for name, value in os.environ.items() if not name.startswith(PREFIX) or name in OTHER_VARIABLES}


def run_to_end(
    module: str, arguments: Sequence[str], python: str | Path = sys.executable
) -> subprocess.CompletedProcess[str]:
    """`python -m module arguments...`, run in the source tree without settings from the environment."""
    command = [str(python), "-m", module, *arguments]
    return subprocess.run(command, cwd=ROOT, env=bare_environment(), capture_output=True, text=True, check=False)


def last_json(output: str) -> dict[str, Any]:
    """The JSON object on the last line of an output."""
    result: dict[str, Any] = json.loads(output.splitlines()[-1])
    return result


def run_module(module: str, arguments: Sequence[str]) -> str:
    """The output of `python -m module arguments...`, run without settings from the environment.

    Raises:
        ProcessError: it fails; its last words are in the message.
    """
    done = run_to_end(module, arguments)
    if done.returncode != 0:
        last = (done.stdout + done.stderr).strip().splitlines()[-8:]
        raise ProcessError(
            f"{' '.join(done.args[1:])} ended with exit code {done.returncode}; its last words:\n"
            + "\n".join(f"  {line}" for line in last)
        )
    return done.stdout


def run_json(module: str, arguments: Sequence[str]) -> dict[str, Any]:
    """The JSON object on the last line that `python -m module arguments...` prints; ProcessError as above."""
    return last_json(run_module(module, arguments))
