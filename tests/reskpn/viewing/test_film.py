"""The film: its frames, its files, and the sentence where nothing can render."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import imageio.v3 as iio
import imageio_ffmpeg
import numpy as np
import pytest
from logs import STEP_S, motion, usual_log, write_log

from common.errors import PhysicsError, SettingsError
from reskpn.cli import main
from reskpn.viewing import renderer
from reskpn.viewing.film import FilmOptions, film_steps, strip_steps
from reskpn.viewing.footage import Take

ROOT = Path(__file__).parents[3]
TAKE = Take(0, 0, "run", STEP_S, motion(51))
"""51 states 0.04 s apart: two seconds."""


def test_frames_are_at_their_times() -> None:
    """At 10 frames a second each is 2.5 steps after the last; at half the speed 1.25."""
    assert film_steps(TAKE, fps=10, speed=1.0)[:5] == [0, 2, 5, 8, 10]
    assert len(film_steps(TAKE, fps=10, speed=1.0)) == 21
    assert film_steps(TAKE, fps=10, speed=0.5)[:5] == [0, 1, 2, 4, 5]
    assert film_steps(TAKE, fps=10, speed=1.0)[-1] == 50
    assert film_steps(Take(0, 0, "run", STEP_S, motion(1)), fps=30, speed=1.0) == [0]


def test_a_strip_is_spread_over_its_span() -> None:
    """From 0.4 to 1.2 s in five: every 0.2 s, or 5 steps. A take has no more pictures than steps."""
    assert strip_steps(TAKE, 5, (0.4, 1.2)) == [10, 15, 20, 25, 30]
    assert strip_steps(TAKE, 2, (0.0, 99.0)) == [0, 50]
    assert len(strip_steps(Take(0, 0, "run", STEP_S, motion(3)), 8, (0.0, 9.0))) == 3


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"width": 0}, "--size: the width is 0; allowed: 64 to 4096"),
        ({"fps": 0}, "--fps is 0; allowed: 1 to 240"),
        ({"speed": -1.0}, "--speed is -1; allowed: 0.01 to 100"),
        ({"speed": float("nan")}, "--speed is nan; allowed: 0.01 to 100"),
        ({"frames": 65}, "--frames is 65; allowed: 1 to 64"),
        ({"height": 99}, "--size is 640x99; a film needs even numbers"),
    ],
)
def test_options_out_of_their_range(options: dict[str, float], sentence: str) -> None:
    """One sentence each."""
    with pytest.raises(SettingsError) as caught:
        FilmOptions(**options)  # type: ignore[arg-type]
    assert str(caught.value) == sentence


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--size", "big"], "--size is 'big'; give width and height in pixels, as 640x480"),
        (["--span", "3:1"], "--span is '3:1'; give seconds within 0:2.4, as 1.5:3"),
        (["--version", "3"], "--version is 3; the log has trajectories of versions 0, 20"),
    ],
)
def test_wrong_options_of_the_command(
    options: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2, before anything is rendered."""
    assert main(["film", str(usual_log(tmp_path)), *options]) == 2
    assert capsys.readouterr().err == f"reskpn film: {sentence}\n"


def test_nothing_renders_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """The Debian packages are named; of both backends, or of the one that was chosen."""
    monkeypatch.setattr(renderer, "_works", lambda backend: False)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    with pytest.raises(PhysicsError) as caught:
        renderer.choose_backend()
    assert str(caught.value) == (
        "no renderer: egl and osmesa did not work here. Rendering without a screen needs one of "
        "EGL, on Debian: apt-get install libegl1 libgl1-mesa-dri; OSMESA, on Debian: apt-get install libosmesa6"
    )


def test_a_film_and_a_strip(tmp_path: Path) -> None:
    """61 frames of 96 x 64 of the episode of 60 steps at 25 a second, and four pictures; something moves in them."""
    path = usual_log(tmp_path)
    options = ["--size", "96x64", "--fps", "25", "--frames", "4"]
    command = [sys.executable, "-m", "reskpn", "film", str(path), *options]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode == PhysicsError.exit_code and "no renderer" in done.stderr:
        pytest.skip(done.stderr.strip())
    assert done.returncode == 0, done.stderr
    assert "policy 20, episode 0 (run): 2.4 s of simulation, return 1,770.0; 60 frames" in done.stdout
    assert imageio_ffmpeg.count_frames_and_secs(str(path / "film.mp4")) == (60, pytest.approx(2.4))
    strip = iio.imread(path / "film.png")[..., :3].astype(float)
    assert strip.shape[:2] == (200, 4 * 160 + 3 * 4)
    # the cart is followed, and its pole turns by more than a radian
    assert np.abs(strip[:, :160] - strip[:, -160:]).mean() > 1.0


def test_a_diverged_simulation_is_filmed_or_says_that_there_is_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 5 for a log without one."""
    assert main(["film", str(write_log(tmp_path)), "--diverged"]) == 5
    assert "has no diverged simulation" in capsys.readouterr().err
