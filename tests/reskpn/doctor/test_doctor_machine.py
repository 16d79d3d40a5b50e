"""Checks of the machine, on machines that are made up."""

from __future__ import annotations

import os
from collections import namedtuple
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from common.config.settings import RunSettings
from reskpn.doctor import machine
from reskpn.doctor.machine import (
    available_memory,
    check_disk,
    check_memory,
    check_packages,
    check_python,
    check_writing,
    home,
)
from reskpn.doctor.needs import Needs

NEEDS = Needs(log=10e9, memory=2e9)
Usage = namedtuple("Usage", "total used free")


def settings(**changes: Any) -> RunSettings:
    return RunSettings.model_validate(changes)


# -- Python and packages -----------------------------------------------------------------------------------


def test_this_python_and_these_packages_will_do() -> None:
    """The tests could not run otherwise."""
    assert check_python().level == "ok"
    assert check_packages().level == "ok"


def test_an_old_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """Named with what is needed."""
    monkeypatch.setattr(machine.platform, "python_version", lambda: "3.9.2")
    found = check_python()
    assert (found.level, found.text) == ("problem", "3.9.2, but >=3.11 is needed")


def test_packages_that_do_not_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is named; optional ones are not looked at."""
    wanted = ["jax>=0.10,<0.13", "there-is-no-such-package>=1", "numpy>=1", 'also-none; extra == "dev"']
    monkeypatch.setattr(machine.metadata, "requires", lambda name: wanted)
    versions = {"jax": "0.4.30", "numpy": "2.2"}

    def version(name: str) -> str:
        if name not in versions:
            raise metadata.PackageNotFoundError(name)
        return versions[name]

    monkeypatch.setattr(machine.metadata, "version", version)
    found = check_packages()
    assert (found.level, found.text, found.advice) == (
        "problem",
        "jax 0.4.30, but <0.13,>=0.10 is needed, there-is-no-such-package is missing",
        "run make setup",
    )


def test_a_source_tree_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Works, but nobody knows whether the versions fit."""
    monkeypatch.setattr(machine, "PACKAGE", "there-is-no-such-package")
    assert [check().level for check in (check_python, check_packages)] == ["warning", "warning"]


# -- memory ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("limit", "used", "free"),
    [
        (None, None, 4096.0 * 1024),
        ("max", "5", 4096.0 * 1024),
        ("3000000", "1000000", 2e6),
        ("9000000000", "0", 4096.0 * 1024),
        ("1000", "2000", 0.0),
    ],
)
def test_free_memory_is_the_lesser_of_machine_and_container(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str | None, used: str | None, free: float
) -> None:
    """4096 kB on the machine; a container may leave less."""
    (tmp_path / "meminfo").write_text("MemTotal: 8192 kB\nMemAvailable:    4096 kB\n")
    monkeypatch.setattr(machine, "MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(machine, "CGROUP", tmp_path)
    if limit is not None and used is not None:
        (tmp_path / "memory.max").write_text(limit + "\n")
        (tmp_path / "memory.current").write_text(used + "\n")
    assert available_memory() == free


@pytest.mark.parametrize(("free", "level"), [(None, "warning"), (1.9e9, "warning"), (2.1e9, "ok")])
def test_memory_against_the_run(monkeypatch: pytest.MonkeyPatch, free: float | None, level: str) -> None:
    """2 GB are needed."""
    monkeypatch.setattr(machine, "available_memory", lambda: free)
    found = check_memory(NEEDS)
    assert found.level == level
    assert "2.0 GB" in found.text


# -- disk --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("free", "level"), [(9e9, "problem"), (11e9, "warning"), (16e9, "ok")])
def test_disk_against_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free: float, level: str) -> None:
    """10 GB will be written."""
    monkeypatch.setattr(machine.shutil, "disk_usage", lambda folder: Usage(1e12, 0, free))
    found = check_disk(settings(run_dir=tmp_path / "not" / "yet"), NEEDS)
    assert found.level == level
    assert found.text.endswith(f"free at {tmp_path}; this run writes about 10.0 GB")
    assert list(tmp_path.iterdir()) == []


def test_a_directory_with_a_run(tmp_path: Path) -> None:
    """A new run would be refused there."""
    (tmp_path / "settings.json").write_text("{}")
    assert check_disk(settings(run_dir=tmp_path), NEEDS).text == f"{tmp_path} holds a run"


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    """Below a regular file there is no directory to make."""
    (tmp_path / "file").write_text("")
    given = settings(run_dir=tmp_path / "file" / "run")
    assert home(given) == tmp_path / "file"
    assert check_disk(given, NEEDS).level == "problem"
    assert check_writing(given).level == "problem"


def test_writing_leaves_nothing_behind(tmp_path: Path) -> None:
    """And tells the median and the worst of eight."""
    found = check_writing(settings(run_dir=tmp_path / "run"))
    assert 0.0 < found.figures["median_s"] <= found.figures["worst_s"]
    assert list(tmp_path.iterdir()) == []


def test_a_slow_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One slow sync of eight is enough to be told: the log would wait for it."""
    times = iter([0.0, 0.01] * 7 + [0.0, 0.5])
    monkeypatch.setattr(machine.time, "perf_counter", lambda: next(times))
    found = check_writing(settings(run_dir=tmp_path))
    assert (found.level, found.text) == ("warning", "syncing 1 MB takes 10.0 ms, at worst 500.0 ms")


@pytest.mark.parametrize(
    ("usable", "quota", "level", "text"),
    [
        (8, None, "ok", "8 usable of 8"),
        (2, 2.0, "ok", "2 usable of 8 (affinity 8, CPU quota 2)"),
        (1, 0.5, "warning", "1 usable of 8 (affinity 8, CPU quota 0.5)"),
    ],
)
def test_cores_within_the_quota(
    monkeypatch: pytest.MonkeyPatch, usable: int, quota: float | None, level: str, text: str
) -> None:
    """For two actors; a container with less than a core for each is told so."""
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(8)))
    monkeypatch.setattr(machine, "usable_cores", lambda: usable)
    monkeypatch.setattr(machine, "cpu_quota", lambda: quota)
    found = machine.check_cores(RunSettings(actors=2))
    assert (found.level, found.text) == (level, text)
