"""`reskpn actor` and `reskpn evaluator`: what they tell JAX before it starts."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from common.errors import SessionError
from common.wire.endpoint import free_port


@pytest.mark.parametrize("command", ["actor", "evaluator"])
def test_with_the_native_engine_jax_is_started_on_the_cpu(command: str) -> None:
    """Where JAX would look for another device and end: the command gets as far as looking for its learner."""
    words = ["--endpoint", f"tcp/127.0.0.1:{free_port()}", "--connect-timeout", "0.1", "--physics", "native"]
    environment = {**os.environ, "JAX_PLATFORMS": "no_such_device"}
    done = subprocess.run(
        [sys.executable, "-m", "reskpn", command, *words], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == SessionError.exit_code, done.stderr
    assert "no connection to tcp/127.0.0.1" in done.stderr
