"""Processor cores that this process may use: those of its affinity, within the CPU quota of its container."""

from __future__ import annotations

import os
from pathlib import Path

CGROUP = Path("/sys/fs/cgroup")
OWN_CGROUP = Path("/proc/self/cgroup")


def usable_cores() -> int:
    """Threads that can run at the same time: the smaller of affinity and CPU quota, at least 1.

    A fraction of a core is not counted: with a thread more than the quota allows, all of them are stopped for the rest
    of every period, and the others wait for the one that has not finished.
    """
    cores = len(os.sched_getaffinity(0))
    quota = cpu_quota()
    return cores if quota is None else max(1, min(cores, int(quota)))


def cpu_quota() -> float | None:
    """Cores that the process's control group allows (cgroup v2 `cpu.max`); None where there is no limit.

    A group is limited by those above it, too.
    """
    try:
        lines = OWN_CGROUP.read_text().splitlines()
    except OSError:
        return None
    own = next((line.removeprefix("0::") for line in lines if line.startswith("0::")), "/")
    # Inside a container the path may be that of the host; its own group is then mounted as the root.
    folder = CGROUP / own.lstrip("/")
    quotas = [quota for path in (folder, *folder.parents) if path.is_relative_to(CGROUP) and (quota := _quota(path))]
    return min(quotas, default=None)


def _quota(group: Path) -> float | None:
    """The quota of one control group in cores, from "50000 100000"; None for "max" and where there is none."""
    try:
        quota, period = (group / "cpu.max").read_text().split()
        return float(quota) / float(period)
    except (OSError, ValueError, ZeroDivisionError):
        return None
