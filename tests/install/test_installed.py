"""The wheel, installed into an empty environment and used from a folder that has modules of the same names.

Run by `make test-install`. The environment sees the pinned dependencies of this one; only this project is installed.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

from reskpn.cli import COMMANDS

ROOT = Path(__file__).parents[2]

TINY = [
    "--num-envs", "32", "--num-steps", "8", "--actors", "1", "--total-steps", "2560", "--algorithm.minibatches", "4",
    "--algorithm.epochs", "1", "--algorithm.hidden", "[8, 8]", "--episode-length", "40", "--physics", "native",
    "--evaluation.episodes", "4",
]  # fmt: skip

OWN_TASK = """
import jax.numpy as jnp
from reskpn.tasks import Data, Task

class Slider(Task):
    mjcf = '''<mujoco><worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0"/><geom size=".1"/></body>
    </worldbody><actuator><motor joint="x" ctrlrange="-1 1" ctrllimited="true"/></actuator></mujoco>'''

    def observation(self, data: Data):
        return jnp.concatenate([data.qpos, data.qvel])

    def reward(self, before, action, after):
        return -jnp.abs(after.qpos[0])
"""


def run(*command: object, cwd: Path, code: int = 0) -> str:
    """What a command prints; it must end with that exit code."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, env=environment, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == code, f"{command}:\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built of what git knows, outside the tree: building leaves files behind."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    names = run("git", "ls-files", "-co", "--exclude-standard", cwd=ROOT).splitlines()
    for name in names:
        if (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((ROOT / name).read_bytes())
    run(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", out, ".", cwd=source)
    (found,) = out.glob("reskpn-*.whl")
    return found


@pytest.fixture(scope="module")
def binaries(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of commands of an environment in which the wheel is installed."""
    folder = tmp_path_factory.mktemp("venv")
    venv.create(folder, with_pip=False)
    packages = folder / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}" / "site-packages"
    # Modules of this folder are seen, its .pth files are not: this project is in it as a link to the tree.
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    pip = [sys.executable, "-m", "pip", "--python", folder / "bin" / "python"]
    run(*pip, "install", "-q", "--no-deps", "--no-index", "--ignore-installed", wheel, cwd=folder)
    return folder / "bin"


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with modules `common` and `services` of its user, which must not be found in the place of ours."""
    folder = tmp_path_factory.mktemp("elsewhere")
    (folder / "common.py").write_text("MINE = True\n")
    (folder / "services").mkdir()
    (folder / "services" / "__init__.py").write_text("MINE = True\n")
    (folder / "slider.py").write_text(OWN_TASK)
    return folder


@pytest.fixture(scope="module")
def trained(binaries: Path, elsewhere: Path) -> Path:
    """A run of ten updates, and its exported policy."""
    run(binaries / "reskpn", "train", "--task", "inverted_pendulum", "--run-dir", "run", *TINY, cwd=elsewhere)
    run(binaries / "reskpn", "export", "run", "--out", "policy.onnx", cwd=elsewhere)
    return elsewhere / "run"


def test_one_package(wheel: Path) -> None:
    """Nothing else is installed at the top, and the metadata says so."""
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (listed,) = (name for name in names if name.endswith("top_level.txt"))
        assert archive.read(listed).decode().split() == ["reskpn"]
    assert {name.split("/")[0].split("-")[0] for name in names} == {"reskpn"}
    assert "reskpn/common/errors.py" in names
    assert "reskpn/presets/paper.yaml" in names


def test_a_user_keeps_modules_of_those_names(binaries: Path, elsewhere: Path, trained: Path) -> None:
    """`import common` is the user's, in the very process that has imported ours."""
    program = (
        "import reskpn.common.errors, common, services; run = reskpn.open_run('run'); "
        "assert common.MINE and services.MINE; print(run.settings.task)"
    )
    assert run(binaries / "python", "-c", program, cwd=elsewhere) == "inverted_pendulum\n"


def test_commands_work_from_any_folder(binaries: Path, elsewhere: Path, trained: Path) -> None:
    """Train and export have: see the fixture. The log verifies bit for bit."""
    reskpn = binaries / "reskpn"
    played = json.loads(run(reskpn, "play", "policy.onnx", "--episodes", "2", "--json", cwd=elsewhere))
    assert len(played["returns"]) == 2
    assert "inverted_pendulum" in run(reskpn, "runs", "--folder", ".", cwd=elsewhere)
    run(reskpn, "replay", "run", "--verify", cwd=elsewhere)
    assert "frames in run/film.mp4" in run(reskpn, "film", "run", "--size", "320x240", cwd=elsewhere)
    assert run(reskpn, "--version", cwd=elsewhere).startswith("reskpn 0.")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_loads(binaries: Path, elsewhere: Path, command: str) -> None:
    """Its help is printed, so that all it imports is in the wheel."""
    assert f"reskpn {command}" in run(binaries / "reskpn", command, "--help", cwd=elsewhere)


def test_a_task_of_ones_own(binaries: Path, elsewhere: Path) -> None:
    """A class of the current folder trains, is exported and played."""
    own = ["--task", "slider:Slider"]
    run(binaries / "reskpn", "train", *own, "--run-dir", "own", *TINY, cwd=elsewhere)
    run(binaries / "reskpn", "export", "own", *own, "--out", "own.onnx", cwd=elsewhere)
    played = json.loads(run(binaries / "reskpn", "play", "own.onnx", "--episodes", "2", "--json", cwd=elsewhere))
    assert played["lengths"] == [40, 40]
