"""The variables and cores that decide the last bits of an update."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from common.numerical_environment import adopt, decides_bits, numerical_environment


@pytest.fixture(autouse=True)
def cores() -> Iterator[set[int]]:
    """Of this process; restored afterwards."""
    before = os.sched_getaffinity(0)
    yield before
    os.sched_setaffinity(0, before)


def test_what_belongs_to_it() -> None:
    """Threads, and how programs are compiled; not caches, messages and memory."""
    given = {
        "NPROC": "2",
        "OMP_NUM_THREADS": "1",
        "XLA_FLAGS": "--xla_cpu_enable_fast_math=true",
        "JAX_ENABLE_X64": "1",
        "JAX_COMPILATION_CACHE_DIR": "/tmp/x",
        "XLA_PYTHON_CLIENT_PREALLOCATE": "false",
        "JAX_TRACEBACK_FILTERING": "off",
        "PATH": "/bin",
    }
    assert numerical_environment(given) == {
        "JAX_ENABLE_X64": "1",
        "NPROC": "2",
        "OMP_NUM_THREADS": "1",
        "XLA_FLAGS": "--xla_cpu_enable_fast_math=true",
    }
    assert not decides_bits("cpu")


def test_threads_are_those_of_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """One variable is set, one is changed and one that the run did not have is left out; each is said."""
    monkeypatch.setenv("NPROC", "1")
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert adopt({"OMP_NUM_THREADS": "2"}, "") == [
        "NPROC=1 is left out: the run was made without it, and the bits depend on it",
        "OMP_NUM_THREADS is 2, as in the run, in place of none: the bits depend on it",
    ]
    assert numerical_environment().get("NPROC") is None
    assert os.environ["OMP_NUM_THREADS"] == "2"
    assert adopt({"OMP_NUM_THREADS": "2"}, "") == []


def test_flags_of_a_log_are_not_taken_over(monkeypatch: pytest.MonkeyPatch) -> None:
    """They could make XLA write files; they are compared instead."""
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    adopt({"XLA_FLAGS": "--xla_dump_to=/tmp/x"}, "")
    assert "XLA_FLAGS" not in os.environ


def test_cores_are_as_many_as_in_the_run(cores: set[int]) -> None:
    """Where there are more; fewer cannot be helped."""
    for name in ("NPROC", "OMP_NUM_THREADS"):
        os.environ.pop(name, None)
    assert adopt({}, str(len(cores) + 1)) == []
    assert adopt({}, "not recorded") == []
    if len(cores) == 1:
        pytest.skip("there is one core")
    assert adopt({}, "1") == [f"1 of {len(cores)} cores are used, as in the run: the bits depend on it"]
    assert os.sched_getaffinity(0) == {min(cores)}
