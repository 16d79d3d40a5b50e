"""What this machine and its software are, and where compiled programs are kept."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
import pytest

from common import runtime
from common.runtime import PACKAGES, enable_compilation_cache, hardware, software_versions, source_commit


def test_versions_of_all_that_takes_part(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python and every package by name; what is not installed is said to be absent."""
    monkeypatch.setattr(runtime, "PACKAGES", (*PACKAGES, "no-such-package"))
    found = software_versions()
    assert found.pop("no-such-package") == "absent"
    assert found.keys() == {"python", *PACKAGES}
    assert found["python"] == platform.python_version()
    assert (found["jax"], found["numpy"]) == (jax.__version__, np.__version__)
    assert {"mujoco", "eclipse-zenoh", "mcap", "msgpack"} <= found.keys()


def test_hardware() -> None:
    """Texts, as a message holds them: host, machine, processor, cores that may be used, backend and devices."""
    found = hardware()
    assert found.keys() == {"host", "machine", "cpu", "cores", "backend", "devices"}
    assert all(type(value) is str and value for value in found.values())
    assert int(found["cores"]) == len(os.sched_getaffinity(0))
    assert found["backend"] == jax.default_backend()


# -- the cache ---------------------------------------------------------------------------------------------


@pytest.fixture
def cache_folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A process that has chosen no folder yet."""
    for name in (runtime.CACHE_VARIABLE, "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", "/home/someone")
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in names}
    yield
    for name, value in before.items():
        jax.config.update(name, value)


@pytest.mark.parametrize(
    ("environment", "folder"),
    [
        ({}, "/home/someone/.cache/reskpn/jax"),
        ({"XDG_CACHE_HOME": "/var/cache"}, "/var/cache/reskpn/jax"),
        ({"RESKPN_CACHE_DIR": "/volume", "XDG_CACHE_HOME": "/var/cache"}, "/volume/jax"),
        ({"RESKPN_CACHE_DIR": "", "XDG_CACHE_HOME": ""}, "/home/someone/.cache/reskpn/jax"),
    ],
)
def test_where_compiled_programs_are_kept(
    cache_folder: None, monkeypatch: pytest.MonkeyPatch, environment: dict[str, str], folder: str
) -> None:
    """In the folder that was chosen, else the user's; all of them, however quickly they were compiled."""
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    enable_compilation_cache()
    assert str(Path(jax.config.jax_compilation_cache_dir).parent) == folder
    assert jax.config.jax_persistent_cache_min_compile_time_secs == 0.0


def test_programs_of_other_numerical_environments_are_kept_apart(
    cache_folder: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What decides bits and is no part of JAX's own key chooses the folder; what decides none does not."""

    def folder() -> str:
        enable_compilation_cache()
        return str(jax.config.jax_compilation_cache_dir)

    for name in ("NPROC", "OMP_NUM_THREADS", "JAX_LOG_COMPILES"):
        monkeypatch.delenv(name, raising=False)
    folders = [folder()]
    monkeypatch.setenv("JAX_LOG_COMPILES", "0")
    assert folder() == folders[0]
    monkeypatch.setenv("NPROC", "1")
    folders.append(folder())
    monkeypatch.setenv("NPROC", "2")
    folders.append(folder())
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(77)))
    folders.append(folder())
    monkeypatch.setattr(runtime, "cpu_model", lambda: "Another Processor")
    folders.append(folder())
    assert len(set(folders)) == 5
    monkeypatch.undo()


# -- the commit --------------------------------------------------------------------------------------------


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with one commit that this source tree is taken to be in; its path is that of a tracked file."""
    for name in [name for name in os.environ if name.startswith("GIT_")]:
        monkeypatch.delenv(name)
    for name in ("GIT_CONFIG_GLOBAL", "GIT_CONFIG_SYSTEM"):
        monkeypatch.setenv(name, os.devnull)
    file = tmp_path / "common" / "runtime.py"
    file.parent.mkdir()
    file.write_text("a = 1\n")
    who = ["-c", "user.name=a", "-c", "user.email=a@b.example"]
    for words in (["init", "-q"], ["add", "."], [*who, "commit", "-q", "-m", "one"]):
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    monkeypatch.setattr(runtime, "__file__", str(file))
    return file


def test_the_commit_of_a_checkout(checkout: Path) -> None:
    """Its hash; with a plus once a tracked file differs. Other files do not count."""
    commit = source_commit()
    assert len(commit) == 40
    assert set(commit) <= set("0123456789abcdef")
    (checkout.parent / "stray.txt").write_text("")
    assert source_commit() == commit
    checkout.write_text("a = 2\n")
    assert source_commit() == commit + "+"


def test_outside_a_checkout_the_commit_is_unknown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in an installed package."""
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    monkeypatch.delenv("GIT_DIR", raising=False)
    monkeypatch.setattr(runtime, "__file__", str(tmp_path / "runtime.py"))
    assert source_commit() == "unknown"


def test_without_git_the_commit_is_unknown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a small container."""
    monkeypatch.setenv("PATH", str(tmp_path))
    assert source_commit() == "unknown"
