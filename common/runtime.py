"""The machine, the software versions, and JAX's compilation cache."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path

import jax

from common.numerical_environment import numerical_environment

PACKAGES = (
    "reskpn",
    "jax",
    "jaxlib",
    "flax",
    "optax",
    "numpy",
    "brax",
    "mujoco",
    "mujoco-mjx",
    "eclipse-zenoh",
    "msgpack",
    "mcap",
)

CACHE_VARIABLE = "RESKPN_CACHE_DIR"


def software_versions() -> dict[str, str]:
    """Versions of Python and of the packages that affect a run; "absent" for one that is not installed."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "absent"
    return found


def hardware() -> dict[str, str]:
    """Host name, CPU model, number of cores this process may use, and JAX's devices."""
    devices = jax.devices()
    return {
        "host": platform.node(),
        "machine": platform.machine(),
        "cpu": cpu_model(),
        "cores": str(len(os.sched_getaffinity(0))),
        "backend": jax.default_backend(),
        "devices": ", ".join(sorted({device.device_kind for device in devices})),
    }


def cpu_model() -> str:
    """The processor's model name as the operating system reports it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()


def enable_compilation_cache() -> None:
    """Keep JAX's compiled programs in $RESKPN_CACHE_DIR or the user's cache directory.

    To be called once everything that decides bits is set: the programs of each numerical environment, number of cores
    and processor have a folder of their own, since JAX does not tell them all apart.
    """
    chosen = os.environ.get(CACHE_VARIABLE) or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "reskpn"
    )
    decides = [numerical_environment(), len(os.sched_getaffinity(0)), cpu_model()]
    known = hashlib.sha256(json.dumps(decides, sort_keys=True).encode()).hexdigest()
    jax.config.update("jax_compilation_cache_dir", str(Path(chosen) / "jax" / known[:16]))
    # The many small programs of a start take longer to compile than all that is read.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def source_commit() -> str:
    """The git commit of this source tree, with "+" if files differ from it; "unknown" outside a checkout."""
    folder = Path(__file__).parent

    def git(*words: str) -> str | None:
        try:
            done = subprocess.run(["git", *words], cwd=folder, capture_output=True, text=True, timeout=5, check=False)
        except (OSError, subprocess.TimeoutExpired):
            return None
        return done.stdout.strip() if done.returncode == 0 else None

    commit = git("rev-parse", "HEAD")
    if commit is None:
        return "unknown"
    return commit + ("+" if git("status", "--porcelain", "--untracked-files=no") else "")
