"""A take as an MP4 and as a strip of pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from common.errors import SettingsError
from reskpn.viewing.footage import Take

if TYPE_CHECKING:
    from reskpn.viewing.scene import Scene

STRIP_GAP = 4
"""White pixels between the pictures of a strip."""


@dataclass(frozen=True)
class FilmOptions:
    """The choices of a film; `speed` is simulated seconds per second of the film.

    Raises SettingsError for a number out of its range.
    """

    width: int = 640
    height: int = 480
    fps: int = 30
    speed: float = 1.0
    camera: str = "auto"
    frames: int = 8

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("--size: the width", self.width, 64, 4096),
            ("--size: the height", self.height, 64, 4096),
            ("--fps", self.fps, 1, 240),
            ("--speed", self.speed, 0.01, 100.0),
            ("--frames", self.frames, 1, 64),
        ):
            if not low <= value <= high:
                raise SettingsError(f"{name} is {value:g}; allowed: {low:g} to {high:g}")
        if self.width % 2 or self.height % 2:
            raise SettingsError(f"--size is {self.width}x{self.height}; a film needs even numbers")


def film_steps(take: Take, fps: int, speed: float) -> list[int]:
    """The step of the take that each frame shows."""
    count = 1 + round(take.seconds / speed * fps)
    times = np.arange(count) * speed / fps
    return np.minimum(np.round(times / take.step_s).astype(int), take.motion.steps - 1).tolist()


def strip_steps(take: Take, frames: int, span: tuple[float, float]) -> list[int]:
    """The steps of `frames` pictures, evenly spaced over the seconds `span` of the take."""
    times = np.linspace(max(0.0, span[0]), min(span[1], take.seconds), min(frames, take.motion.steps))
    return np.round(times / take.step_s).astype(int).tolist()


def pictures(scene: Scene, take: Take, steps: Iterable[int], image: Callable[[], np.ndarray]) -> Iterator[np.ndarray]:
    """The pictures [h, w, 3] of these steps of the take, as they are asked for."""
    for step in steps:
        scene.show(take, step)
        yield image()


def write_film(path: Path, frames: Iterable[np.ndarray], options: FilmOptions) -> int:
    """Write an MP4 (H.264) and return the number of frames. Raises SettingsError where `path` cannot be written."""
    import imageio_ffmpeg

    count = 0
    try:
        # Opened first: ffmpeg's own words for a folder that is not there fill a screen.
        path.open("wb").close()
        size = (options.width, options.height)
        writer = imageio_ffmpeg.write_frames(
            str(path), size, fps=options.fps, quality=7, macro_block_size=2, ffmpeg_log_level="error"
        )
        writer.send(None)
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))
            count += 1
        writer.close()
    except OSError as error:
        raise SettingsError(f"cannot write {path}: {error.strerror or error}; give another file with --out") from None
    return count


def write_strip(path: Path, frames: Iterable[np.ndarray]) -> None:
    """Write pictures side by side as a PNG. Raises SettingsError where `path` cannot be written."""
    from matplotlib.image import imsave

    images = list(frames)
    gap = np.full((images[0].shape[0], STRIP_GAP, 3), 255, np.uint8)
    parts = [part for image in images for part in (image, gap)][:-1]
    try:
        imsave(path, np.concatenate(parts, axis=1))
    except OSError as error:
        raise SettingsError(f"cannot write {path}: {error.strerror or error}; give another file with --strip") from None


def crop(image: np.ndarray, width: int) -> np.ndarray:
    """The middle `width` columns of an image."""
    left = max(0, (image.shape[1] - width) // 2)
    return image[:, left : left + width]
