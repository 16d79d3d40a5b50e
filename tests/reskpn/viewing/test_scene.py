"""The model of a log: with its files, in view, and refused where it does not fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from logs import MJCF, motions, usual_log, write_log

from common.errors import LogReadError, PhysicsError, SettingsError
from reskpn.viewing.footage import Footage, choose, read_footage
from reskpn.viewing.scene import Scene

TETRAHEDRON = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
WITH_MESH = MJCF.replace(
    "<worldbody>",
    '<compiler meshdir="shapes"/><asset><mesh name="tip" file="tip.obj"/></asset><worldbody>',
).replace('type="sphere" pos="0 0 0.6" size="0.08"', 'type="mesh" mesh="tip"')


@pytest.fixture(scope="module")
def footage(tmp_path_factory: pytest.TempPathFactory) -> Footage:
    return read_footage(usual_log(tmp_path_factory.mktemp("run")))


def test_the_view_follows_over_the_floor(footage: Footage) -> None:
    """The cart slides 0.59 m in 60 steps, and the view as far; its height stays."""
    take = choose(footage, version=20, episode=0, diverged=False)
    scene = Scene(footage, [take])
    camera = scene.camera()
    scene.follow(camera)
    before = np.array(camera.lookat)
    scene.show(take, 59)
    scene.follow(camera)
    moved = np.array(camera.lookat) - before
    # the pole has turned by 0.02 * 59 rad, and takes a part of its 0.2 kg of 1.2 kg with it
    assert 0.5 < moved[0] < 0.8
    assert moved[2] == 0.0
    assert scene.shot.distance > 1.0


def test_cameras_are_those_of_the_model(footage: Footage) -> None:
    """By name; another name is refused with those there are."""
    scene = Scene(footage, list(footage.evaluated))
    assert scene.camera("side").fixedcamid == 0
    with pytest.raises(SettingsError) as caught:
        scene.camera("top")
    assert str(caught.value) == "--camera is 'top'; the model has auto, side"


def test_a_model_with_a_mesh_has_its_files_in_the_log(tmp_path: Path) -> None:
    """In the folder that the MJCF names."""
    path = write_log(tmp_path, ("/motion", motions(0, [3])), mjcf=WITH_MESH, files={"tip.obj": TETRAHEDRON})
    footage = read_footage(path)
    assert Scene(footage, list(footage.evaluated)).model.nmesh == 1


def test_warnings_of_a_model_leave_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """MuJoCo would print that this attribute is deprecated, and write it to a file in the user's folder."""
    monkeypatch.chdir(tmp_path)
    old = MJCF.replace("<worldbody>", '<compiler settotalmass="14"/><worldbody>', 1)
    footage = read_footage(write_log(tmp_path / "run", ("/motion", motions(0, [3])), mjcf=old))
    Scene(footage, list(footage.evaluated))
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    assert capfd.readouterr().err == ""


def test_models_that_do_not_fit(tmp_path: Path) -> None:
    """One that MuJoCo refuses, and one of another robot."""
    broken = read_footage(write_log(tmp_path / "a", ("/motion", motions(0, [3])), mjcf="<mujoco><joint/></mujoco>"))
    with pytest.raises(PhysicsError, match="MuJoCo does not load the model of cart in the log: XML Error"):
        Scene(broken, list(broken.evaluated))
    other = MJCF.replace('<joint name="hinge" type="hinge" axis="0 1 0"/>', "")
    another = read_footage(write_log(tmp_path / "b", ("/motion", motions(0, [3])), mjcf=other))
    with pytest.raises(LogReadError, match="has 2 positions and 2 velocities, but the model in the log has 1 and 1"):
        Scene(another, list(another.evaluated))
