"""The variables and cores that decide the last bits of an update."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from common.numerical_environment import (
    THREAD_VARIABLES,
    adopt,
    decides_bits,
    factorise_on_one_thread,
    numerical_environment,
)


@pytest.fixture
def cores() -> set[int]:
    """Of this process; tests/conftest.py puts them back."""
    return os.sched_getaffinity(0)


def test_what_belongs_to_it() -> None:
    """Threads, and how programs are compiled; not caches, messages and memory."""
    given = {
        "NPROC": "2",
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "2",
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
        "OPENBLAS_NUM_THREADS": "2",
        "XLA_FLAGS": "--xla_cpu_enable_fast_math=true",
    }
    assert not decides_bits("cpu")


def test_threads_are_those_of_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """One variable is set, one is changed and one that the run did not have is left out; each is said."""
    monkeypatch.setenv("NPROC", "1")
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
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
    for name in THREAD_VARIABLES:
        os.environ.pop(name, None)
    assert adopt({}, str(len(cores) + 1)) == []
    assert adopt({}, "not recorded") == []
    if len(cores) == 1:
        pytest.skip("there is one core")
    assert adopt({}, "1") == [f"1 of {len(cores)} cores are used, as in the run: the bits depend on it"]
    assert os.sched_getaffinity(0) == {min(cores)}


def test_factorisations_have_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Unless the user has said how many; either is recorded."""
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    factorise_on_one_thread()
    assert numerical_environment()["OPENBLAS_NUM_THREADS"] == "1"
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    factorise_on_one_thread()
    assert numerical_environment()["OPENBLAS_NUM_THREADS"] == "2"


FACTORISE = """
import os
from common.numerical_environment import adopt, factorise_on_one_thread
import jax, jax.numpy as jnp, scipy.linalg
factorise_on_one_thread()
adopt({"OPENBLAS_NUM_THREADS": os.environ["WANTED"]}, "")
rows = jnp.sin(jnp.arange(300 * 64, dtype=jnp.float32)).reshape(300, 64)
print(jax.jit(jnp.linalg.eigh)(rows.T @ rows)[1].tobytes().hex())
"""


def test_a_change_is_in_time(cores: set[int]) -> None:
    """The run's threads hold although OpenBLAS is loaded before they are adopted, and they decide the bits."""
    found = {}
    for wanted, given in (("1", "2"), ("2", "1"), ("1", "1")):
        environment = os.environ | {"WANTED": wanted, "OPENBLAS_NUM_THREADS": given}
        process = subprocess.run(
            [sys.executable, "-c", FACTORISE], env=environment, capture_output=True, text=True, check=True
        )
        found[wanted, given] = process.stdout
    assert found["1", "2"] == found["1", "1"]
    if len(cores) > 1:
        assert found["2", "1"] != found["1", "1"]
