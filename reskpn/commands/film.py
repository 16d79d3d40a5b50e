"""`reskpn film`: a trajectory of a recorded run as an MP4 and as a strip of pictures."""

from __future__ import annotations

import argparse
import re
from dataclasses import replace
from pathlib import Path

from common.errors import SettingsError
from reskpn.commands.command import EXIT_CODES, Command
from reskpn.viewing.film import FilmOptions, crop, film_steps, pictures, strip_steps, write_film, write_strip
from reskpn.viewing.footage import Take, choose, read_footage

EPILOG = f"""\
Rendering needs no screen: it uses EGL, or OSMesa where there is no EGL. Set
MUJOCO_GL to egl or osmesa to choose.

{EXIT_CODES}"""

STRIP_HEIGHT = 200


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add_choice(parser)
    add("--out", type=Path, metavar="FILE", help="the film (default: RUN/film.mp4)")
    add("--strip", type=Path, metavar="FILE", help="the strip of pictures (default: RUN/film.png)")
    add("--size", default="640x480", metavar="WxH", help="pixels of the film (default: %(default)s)")
    add("--fps", type=int, default=30, metavar="N", help="frames per second (default: %(default)s)")
    add("--speed", type=float, default=1.0, metavar="X", help="simulated seconds per second (default: %(default)s)")
    add("--camera", default="auto", metavar="NAME", help="a camera of the model (default: one that follows the robot)")
    add("--frames", type=int, default=8, metavar="N", help="pictures of the strip (default: %(default)s)")
    add("--span", default="", metavar="A:B", help="seconds that the strip covers (default: the whole episode)")
    add("--foxglove", type=Path, metavar="FILE", help="write FILE.mcap for Foxglove or Lichtblick instead of a film")


def add_choice(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose a trajectory."""
    add = parser.add_argument
    add("path", type=Path, metavar="RUN", help="directory of a run, or its log directory")
    add("--version", type=int, metavar="V", help="version of the policy (default: the newest with a trajectory)")
    add("--episode", type=int, default=0, metavar="N", help="episode of that version, from 0 (default: %(default)s)")
    add("--diverged", action="store_true", help="the steps before a simulation diverged, instead of an evaluation")


def run(given: argparse.Namespace) -> int:
    """Write the film and the strip, or the file for Foxglove. Returns 0."""
    width, height = _size(given.size)
    options = FilmOptions(width, height, given.fps, given.speed, given.camera, given.frames)
    footage = read_footage(given.path)
    take = choose(footage, version=given.version, episode=given.episode, diverged=given.diverged)
    if given.foxglove is not None:
        from reskpn.viewing.foxglove import write_foxglove

        count = write_foxglove(given.foxglove, footage, take)
        print(f"{footage.run}: {take.name}: {count} messages in {given.foxglove}")
        return 0
    from reskpn.viewing.renderer import choose_backend, rendering

    span = _span(given.span, take)
    backend = choose_backend()
    from reskpn.viewing.scene import Scene

    folder = given.path if given.path.is_dir() else given.path.parent
    out, strip = given.out or folder / "film.mp4", given.strip or folder / "film.png"
    with rendering(Scene(footage, [take]), width, height, given.camera) as (scene, image):
        count = write_film(out, pictures(scene, take, film_steps(take, options.fps, options.speed), image), options)
    small = replace(options, height=STRIP_HEIGHT, width=2 * (STRIP_HEIGHT * width // height // 2))
    with rendering(Scene(footage, [take]), small.width, small.height, given.camera) as (scene, image):
        shown = pictures(scene, take, strip_steps(take, options.frames, span), image)
        write_strip(strip, (crop(picture, STRIP_HEIGHT * 4 // 5) for picture in shown))
    print(
        f"{footage.run}: {take.name}: {take.seconds:.1f} s of simulation, return {take.motion.reward.sum():,.1f}; "
        f"{count} frames in {out}, strip in {strip} (rendered by {backend})"
    )
    return 0


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if found is None:
        raise SettingsError(f"--size is {text!r}; give width and height in pixels, as 640x480")
    return int(found[1]), int(found[2])


def _span(text: str, take: Take) -> tuple[float, float]:
    """The seconds of the strip. Raises SettingsError for what is not two numbers within the take, in order."""
    if not text:
        return 0.0, take.seconds
    found = re.fullmatch(r"(\d+(?:\.\d+)?):(\d+(?:\.\d+)?)", text)
    if found is None or not float(found[1]) <= float(found[2]) or float(found[1]) > take.seconds:
        raise SettingsError(f"--span is {text!r}; give seconds within 0:{take.seconds:.1f}, as 1.5:3")
    return float(found[1]), float(found[2])


COMMAND = Command(add_options, run, EPILOG, usage="reskpn film RUN [options]")
