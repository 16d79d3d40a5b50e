"""Cores within a CPU quota, with a made-up cgroup file system."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from common import cores
from common.cores import cpu_quota, usable_cores


@pytest.fixture
def group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The directory of this process's control group, two levels below the root; eight cores by affinity."""
    folder = tmp_path / "cgroup" / "pods" / "mine"
    folder.mkdir(parents=True)
    own = tmp_path / "own"
    own.write_text("1:name=systemd:/other\n0::/pods/mine\n")
    monkeypatch.setattr(cores, "CGROUP", tmp_path / "cgroup")
    monkeypatch.setattr(cores, "OWN_CGROUP", own)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(8)))
    return folder


@pytest.mark.parametrize(
    ("text", "quota", "usable"),
    [
        ("50000 100000\n", 0.5, 1),  # half a core: still one thread
        ("150000 100000\n", 1.5, 1),
        ("400000 100000\n", 4.0, 4),
        ("1600000 100000\n", 16.0, 8),  # more than there are
        ("max 100000\n", None, 8),
        ("nonsense\n", None, 8),
        (None, None, 8),
    ],
)
def test_the_smaller_of_affinity_and_quota(group: Path, text: str | None, quota: float | None, usable: int) -> None:
    """Whole cores, at least one."""
    if text is not None:
        (group / "cpu.max").write_text(text)
    assert cpu_quota() == quota
    assert usable_cores() == usable


def test_groups_above_count_as_well(group: Path) -> None:
    """The smallest quota on the way to the root."""
    (group / "cpu.max").write_text("400000 100000")
    (group.parent / "cpu.max").write_text("200000 100000")
    assert (cpu_quota(), usable_cores()) == (2.0, 2)


def test_a_path_of_the_host_inside_a_container(group: Path) -> None:
    """The group is not found by its path; the root is the container's own."""
    (group.parents[1] / "cpu.max").write_text("200000 100000")
    cores.OWN_CGROUP.write_text("0::/../../somewhere/on/the/host\n")
    assert usable_cores() == 2


def test_a_system_without_control_groups(group: Path) -> None:
    """All cores of the affinity."""
    cores.OWN_CGROUP.unlink()
    assert (cpu_quota(), usable_cores()) == (None, 8)
