"""MuJoCo's own web viewer, `mujoco.studio`, playing recorded trajectories instead of simulating.

Its interface is replaced where it is about simulating: a plugin on the simulation's side sets the recorded state in the
place of a step, and a plugin on the viewer's side has the controls of the player. The picture is drawn by the browser.
"""

from __future__ import annotations

import contextlib
import io
import logging
import socket
import time
from collections.abc import Callable, Iterator

from mujoco.studio import app, launch_web, messages, plugin, viewer_protocol
from mujoco.studio.dear_imgui import dear_imgui as imgui
from mujoco.studio.web import web_server

from common.errors import SessionError
from reskpn.viewing.player import FASTEST, SLOWEST, Player
from reskpn.viewing.scene import Scene

HOST = "127.0.0.1"
TICK_S = 1 / 120
PANEL = "Recorded run"


class Playback(plugin.SimPlugin):
    """Shows the player's step in the place of stepping the simulation."""

    def __init__(self, player: Player, scene: Scene) -> None:
        self._player = player
        self._scene = scene
        self._before_s = time.monotonic()

    @messages.handler(priority=messages.Priority.CRITICAL)
    def _on_step(self, event: messages.StepEvent) -> bool:
        now_s = time.monotonic()
        self._player.advance(now_s - self._before_s)
        self._before_s = now_s
        position = self._player.position()
        self._scene.show(position.take, position.step)
        time.sleep(TICK_S)
        return True

    @messages.handler(priority=messages.Priority.CRITICAL)
    def _on_load(self, event: messages.LoadModelEvent) -> bool:
        return True  # consumed: a file that is dropped onto the page would replace the run's model

    @messages.handler(priority=messages.Priority.CRITICAL)
    def _on_perturb(self, event: messages.PerturbSnapshot) -> bool:
        return True  # consumed: what was recorded cannot be pushed

    @messages.handler(priority=messages.Priority.CRITICAL)
    def _on_state(self, event: messages.StateEvent) -> bool:
        return True


class Controls(plugin.ViewerPlugin):
    """The panel of the player, and the view that follows the robot."""

    def __init__(self, player: Player, scene: Scene, title: str) -> None:
        self._player = player
        self._scene = scene
        self._title = title
        self._follow = scene.shot.follows
        self._aimed = False

    @messages.handler(priority=messages.Priority.CRITICAL)
    def _on_update(self, event: messages.UpdateEvent) -> None:
        if self.viewer.model.nq != self._scene.model.nq:
            return  # the viewer has not been given the model yet
        camera = self.viewer.camera
        if not self._aimed:
            wanted = self._scene.camera()
            camera.azimuth, camera.elevation, camera.distance = wanted.azimuth, wanted.elevation, wanted.distance
            camera.lookat[:] = wanted.lookat
            self._aimed = True
        if self._follow:
            camera.lookat[:2] = self.viewer.data.subtree_com[0][:2]

    @messages.handler
    def _on_gui(self, event: messages.BuildGuiEvent) -> None:
        imgui.SetNextWindowPos(imgui.Vec2(12, 40), int(imgui.Cond.FirstUseEver))
        imgui.SetNextWindowSize(imgui.Vec2(440, 270), int(imgui.Cond.FirstUseEver))
        self._keys()
        if imgui.Begin(PANEL)[0]:
            self._choice()
            self._timeline()
            self._figures()
        imgui.End()

    def _keys(self) -> None:
        """Space plays or stays, the arrows go a step."""
        if imgui.IsAnyItemActive():
            return  # a number is being typed, or a slider held
        now = self._player.position()
        if imgui.IsKeyPressed(imgui.Key.Space):
            self._player.play(not now.playing)
        for key, by in ((imgui.Key.LeftArrow, -1), (imgui.Key.RightArrow, 1)):
            if imgui.IsKeyPressed(key):
                self._player.seek(now.step + by)

    def _choice(self) -> None:
        player, take = self._player, self._player.position().take
        imgui.TextUnformatted(self._title)
        versions = player.versions
        changed, index = imgui.Combo("policy version", versions.index(take.version), [str(v) for v in versions])
        if changed:
            player.choose(player.episodes(versions[index])[0])
            take = player.position().take
        episodes = player.episodes(take.version)
        names = [f"{found.episode}: {found.source}" for found in episodes]
        changed, index = imgui.Combo("divergence" if take.diverged else "episode", episodes.index(take), names)
        if changed:
            player.choose(episodes[index])

    def _timeline(self) -> None:
        player, now = self._player, self._player.position()
        last = now.take.motion.steps - 1
        changed, step = imgui.SliderInt("step", now.step, 0, max(1, last))
        if changed:
            player.seek(step)
        if imgui.Button("Pause" if now.playing else "Play"):
            player.play(not now.playing)
        for label, by in (("-1", -1), ("+1", 1)):
            imgui.SameLine()
            if imgui.Button(label):
                player.seek(now.step + by)
        imgui.SameLine()
        if imgui.Button("Start"):
            player.choose(now.take)
        changed, speed = imgui.SliderFloat("speed", now.speed, SLOWEST, FASTEST, "%.2f x")
        if changed:
            player.set_speed(speed)
        _, self._follow = imgui.Checkbox("follow the robot", self._follow)

    def _figures(self) -> None:
        now = self._player.position()
        take = now.take
        imgui.TextUnformatted(f"time {now.step * take.step_s:.2f} of {take.seconds:.2f} s")
        imgui.TextUnformatted(f"reward {now.reward:.3f}, return up to here {now.total:,.1f}")
        action = ", ".join(f"{value:.2f}" for value in take.motion.action[now.step][:8])
        more = ", ..." if take.motion.action.shape[1] > 8 else ""
        imgui.TextUnformatted(f"action {action}{more} (the environment clips it to -1 to 1)")
        if take.diverged and now.step == take.motion.steps - 1:
            imgui.TextColored(imgui.Vec4(0.85, 0.15, 0.1, 1.0), "the next step diverged: there is no state after it")


@contextlib.contextmanager
def _on_loopback(port: int) -> Iterator[None]:
    """Make the viewer listen on 127.0.0.1: it has no setting for it, and would listen on all interfaces.

    Raises SessionError where the port is in use.
    """
    original = web_server.bind_public_socket

    def bind(host: str, wanted: int = 0) -> socket.socket:
        return original(HOST, wanted)

    try:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((HOST, port))
    except OSError as error:
        raise SessionError(f"cannot listen on {HOST}:{port}: {error.strerror}; choose another with --port") from None
    web_server.bind_public_socket = bind
    try:
        yield
    finally:
        web_server.bind_public_socket = original


def show(
    player: Player,
    scene: Scene,
    *,
    title: str,
    port: int,
    open_browser: bool,
    stopped: Callable[[], bool],
    say: Callable[[str], None],
) -> None:
    """Serve the viewer on 127.0.0.1 until `stopped` or until it is closed.

    Args:
        port: 0 for any that is free.

    Raises:
        SessionError: the port is in use.
    """
    port = port or _free_port()
    studio = app.App(
        app.plugins.Config(show_options=False, show_inspector=False, show_status_bar=False, show_toolbar=False)
    )
    plugins = [studio, Controls(player, scene, title), Playback(player, scene)]
    config = viewer_protocol.ViewerConfig(title=title, gfx="web", http_port=port, open_browser=open_browser)
    logging.getLogger("WebServer").setLevel(logging.WARNING)
    # Its banner warns of other machines that can connect, which none can here.
    with contextlib.redirect_stdout(io.StringIO()):
        with _on_loopback(port):
            handle = launch_web.launch(config, plugins=plugins)
            handle.set_model(scene.model, data=scene.data)
            while not _answers(port) and handle.is_running() and not stopped():
                handle.sync()
        say(f"http://{HOST}:{port}/ shows {title}; Ctrl-C ends it")
        with handle:
            while handle.is_running() and not stopped():
                handle.sync()


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex((HOST, port)) == 0


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        port: int = probe.getsockname()[1]
    return port
