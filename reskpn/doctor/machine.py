"""Checks of Python, the packages, memory and disk."""

from __future__ import annotations

import os
import platform
import shutil
import statistics
import tempfile
import time
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement

from common.config.settings import RunSettings
from common.cores import cpu_quota, usable_cores
from common.log.segments import LOG_DIRECTORY
from common.runs.directory import SETTINGS, SUMMARY
from reskpn.doctor.findings import Finding, size
from reskpn.doctor.needs import Needs

PACKAGE = "reskpn"
SYNC_BYTES = 1 << 20
SYNCS = 8
SLOW_SYNC_S = 0.25
"""The log is synced once a second, and no rollout is acknowledged meanwhile."""

MEMINFO = Path("/proc/meminfo")
CGROUP = Path("/sys/fs/cgroup")


def check_python() -> Finding:
    """Compare Python's version with what the package requires."""
    version = platform.python_version()
    try:
        wanted = metadata.metadata(PACKAGE)["Requires-Python"]
    except metadata.PackageNotFoundError:
        return Finding("python", "warning", f"{version}; {PACKAGE} is not installed here", "run make setup")
    if not Requirement(f"python{wanted}").specifier.contains(version):
        return Finding("python", "problem", f"{version}, but {wanted} is needed", "make setup PYTHON=python3.11")
    return Finding("python", "ok", f"{version} ({wanted} is needed)")


def check_packages() -> Finding:
    """Look for every required package in an allowed version."""
    try:
        wanted = [Requirement(text) for text in metadata.requires(PACKAGE) or []]
    except metadata.PackageNotFoundError:
        return Finding("packages", "warning", f"{PACKAGE} is not installed here: versions unknown", "run make setup")
    wanted = [requirement for requirement in wanted if requirement.marker is None or requirement.marker.evaluate()]
    wrong = [fault for requirement in wanted if (fault := _fault(requirement))]
    if wrong:
        return Finding("packages", "problem", ", ".join(wrong), "run make setup")
    return Finding("packages", "ok", f"all {len(wanted)} have versions that fit")


def _fault(requirement: Requirement) -> str:
    try:
        found = metadata.version(requirement.name)
    except metadata.PackageNotFoundError:
        return f"{requirement.name} is missing"
    if not requirement.specifier.contains(found, prereleases=True):
        return f"{requirement.name} {found}, but {requirement.specifier} is needed"
    return ""


def check_cores(settings: RunSettings) -> Finding:
    """Compare the cores that this process may use with the actors of the run."""
    cores, quota = usable_cores(), cpu_quota()
    affinity = len(os.sched_getaffinity(0))
    text = f"{cores} usable of {os.cpu_count()}"
    if quota is not None:
        text += f" (affinity {affinity}, CPU quota {quota:g})"
    elif affinity != os.cpu_count():
        text += f" (affinity {affinity})"
    figures = {"usable": float(cores), "affinity": float(affinity)} | ({} if quota is None else {"quota": quota})
    if settings.actors > cores:
        advice = f"{settings.actors} actors share them here; run fewer, or raise the limit"
        return Finding("cores", "warning", text, advice, figures)
    return Finding("cores", "ok", text, figures=figures)


def check_memory(needs: Needs) -> Finding:
    """Compare the free memory with what all processes of the run take."""
    free = available_memory()
    if free is None:
        return Finding("memory", "warning", f"cannot be read here; the run takes about {size(needs.memory)}")
    text = f"{size(free)} free; all processes of this run take about {size(needs.memory)}"
    figures = {"free_bytes": free, "needed_bytes": needs.memory}
    if free < needs.memory:
        advice = "run fewer actors or environments here, or stop other programs"
        return Finding("memory", "warning", text, advice, figures)
    return Finding("memory", "ok", text, figures=figures)


def available_memory() -> float | None:
    """Bytes that processes may still take, of the machine or within the container's limit; None if not known."""
    try:
        lines = dict(line.split(":", 1) for line in MEMINFO.read_text().splitlines() if ":" in line)
        free = float(lines["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):
        return None
    try:
        limit = (CGROUP / "memory.max").read_text().strip()
        used = float((CGROUP / "memory.current").read_text())
        return free if limit == "max" else min(free, max(0.0, float(limit) - used))
    except (OSError, ValueError):
        return free


def check_disk(settings: RunSettings, needs: Needs) -> Finding:
    """Compare the free disk space at the run directory with what the run will write."""
    folder = home(settings)
    if settings.run_dir and any((settings.run_dir / name).exists() for name in (SUMMARY, SETTINGS, LOG_DIRECTORY)):
        return Finding("disk", "warning", f"{settings.run_dir} holds a run", "a new run needs another --run-dir")
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        return Finding("disk", "problem", f"{folder} cannot be written", "choose another directory with --run-dir")
    free = float(shutil.disk_usage(folder).free)
    text = f"{size(free)} free at {folder}; this run writes about {size(needs.log)}"
    figures = {"free_bytes": free, "needed_bytes": needs.log}
    if free < needs.log:
        return Finding("disk", "problem", text, "free some space, or choose another disk with --run-dir", figures)
    if free < 1.5 * needs.log:
        return Finding("disk", "warning", text, "little will be left", figures)
    return Finding("disk", "ok", text, figures=figures)


def check_writing(settings: RunSettings) -> Finding:
    """Measure how long the disk of the run directory takes to sync a megabyte, eight times."""
    folder = home(settings)
    block = os.urandom(SYNC_BYTES)
    seconds = []
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            for _ in range(SYNCS):
                began_s = time.perf_counter()
                file.write(block)
                file.flush()
                os.fsync(file.fileno())
                seconds.append(time.perf_counter() - began_s)
    except OSError as error:
        advice = "choose another directory with --run-dir"
        return Finding("writing", "problem", f"{folder}: {error.strerror}", advice)
    middle, worst = statistics.median(seconds), max(seconds)
    text = f"syncing 1 MB takes {1e3 * middle:.1f} ms, at worst {1e3 * worst:.1f} ms"
    figures = {"median_s": middle, "worst_s": worst}
    if worst > SLOW_SYNC_S:
        return Finding("writing", "warning", text, "actors wait for a slow disk; use a local one", figures)
    return Finding("writing", "ok", text, figures=figures)


def home(settings: RunSettings) -> Path:
    """The nearest existing folder above the run's files."""
    folder = (settings.run_dir or Path("runs")).absolute()
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder
