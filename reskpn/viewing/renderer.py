"""Images of a scene, rendered without a screen: by EGL or OSMesa, whichever this machine has.

MuJoCo chooses its backend when it is first imported, by `MUJOCO_GL`; so `choose_backend` comes before all else here.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from common.errors import PhysicsError

if TYPE_CHECKING:
    from reskpn.viewing.scene import Scene

Image = Callable[[], np.ndarray]

VARIABLE = "MUJOCO_GL"
BACKENDS = {"egl": "libegl1 libgl1-mesa-dri", "osmesa": "libosmesa6"}
"""The backends that need no screen, and the Debian packages that each needs."""

PROBE_S = 120.0
_PROBE = """
import mujoco
with mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 8, 8) as renderer:
    renderer.update_scene(mujoco.MjData(renderer.model))
    renderer.render()
"""

SHADOW_SIZE = 2048
"""Pixels of the shadow map: a quarter of MuJoCo's own, which takes most of the time where the CPU renders."""


def choose_backend() -> str:
    """Set the backend for this process, which has not imported MuJoCo yet, and return its name.

    Raises:
        PhysicsError: none works here.
    """
    if "mujoco" in sys.modules and os.environ.get(VARIABLE) in BACKENDS:
        return os.environ[VARIABLE]
    given = os.environ.get(VARIABLE, "")
    for backend in [given] if given else BACKENDS:
        if _works(backend):
            os.environ[VARIABLE] = backend
            return backend
    raise PhysicsError(
        f"no renderer: {given or ' and '.join(BACKENDS)} did not work here. Rendering without a screen needs one of "
        + "; ".join(f"{name.upper()}, on Debian: apt-get install {packages}" for name, packages in BACKENDS.items())
    )


def _works(backend: str) -> bool:
    """True if MuJoCo renders by this backend, tried in a process of its own: it cannot be changed within one."""
    environment = os.environ | {VARIABLE: backend}
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE], env=environment, capture_output=True, timeout=PROBE_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


@contextmanager
def rendering(scene: Scene, width: int, height: int, camera: str) -> Iterator[tuple[Scene, Image]]:
    """The scene and a function that returns its state as an image [height, width, 3] uint8.

    Raises:
        SettingsError: the model has no such camera.
    """
    import mujoco

    view = scene.camera(camera)
    _soften(scene.model, width, height)
    with mujoco.Renderer(scene.model, height, width) as renderer:

        def image() -> np.ndarray:
            scene.follow(view)
            renderer.update_scene(scene.data, view)
            return np.array(renderer.render())

        yield scene, image


def _soften(model: Any, width: int, height: int) -> None:
    """Give the model a calm floor and light from all sides; MuJoCo's tasks have a mirror of black and white."""
    model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
    model.vis.global_.offheight = max(height, model.vis.global_.offheight)
    model.vis.quality.shadowsize = min(SHADOW_SIZE, model.vis.quality.shadowsize)
    model.vis.headlight.ambient[:] = 0.35
    model.vis.headlight.diffuse[:] = 0.5
    model.mat_reflectance[:] = 0.0
    model.mat_specular[:] = np.minimum(model.mat_specular, 0.3)
    for number in range(model.ntex):
        first = model.tex_adr[number]
        pixels = model.tex_data[first : first + model.tex_width[number] * model.tex_height[number] * 3]
        if model.tex_type[number] == 0:  # 2d: the floor's
            pixels[:] = (105 + 0.3 * pixels).astype(np.uint8)
