"""What JAX finds on this machine, as one JSON object: in a process of its own, which holds a GPU's memory no longer."""

from __future__ import annotations

import json
import shutil
import subprocess

import jax

from common.runtime import hardware


def found() -> dict[str, str]:
    """`hardware`, the memory of the first device, and the version of NVIDIA's driver; "" for what is not known."""
    stats = jax.devices()[0].memory_stats() or {}
    limit = stats.get("bytes_limit")
    return {**hardware(), "memory": "" if limit is None else f"{limit / 2**30:.0f} GiB", "driver": _driver()}


def _driver() -> str:
    tool = shutil.which("nvidia-smi")
    if tool is None:
        return ""
    asked = [tool, "--query-gpu=driver_version", "--format=csv,noheader"]
    try:
        done = subprocess.run(asked, capture_output=True, text=True, timeout=20, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip().splitlines()[0] if done.returncode == 0 and done.stdout.strip() else ""


if __name__ == "__main__":
    print(json.dumps(found()))
