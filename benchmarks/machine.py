"""The machine and software on which a value was measured."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

from common.runtime import cpu_model, software_versions, source_commit


def machine() -> dict[str, str]:
    """Usable cores, CPU model, load average before the measurement, date, commit and versions."""
    return {
        "cores": str(len(os.sched_getaffinity(0))),
        "cpu": cpu_model(),
        "load": f"{os.getloadavg()[0]:.1f}",
        "date": time.strftime("%Y-%m-%d %H:%M"),
        "commit": source_commit(),
        **software_versions(),
    }


def describe(found: dict[str, str]) -> Iterator[str]:
    """Readable lines for `machine()`."""
    yield f"{found['cores']} cores of {found['cpu']}; load {found['load']} at the start; {found['date']}"
    versions = ", ".join(f"{name} {found[name]}" for name in ("python", "jax", "mujoco", "eclipse-zenoh", "mcap"))
    yield f"commit {found['commit'][:12]}; {versions}"
