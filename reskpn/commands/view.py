"""`reskpn view`: the trajectories of a recorded run in MuJoCo's own web viewer."""

from __future__ import annotations

import argparse
import sys
from functools import partial

from common.errors import SettingsError
from common.output import say
from reskpn.commands.command import EXIT_CODES, Command
from reskpn.commands.film import add_choice
from reskpn.viewing.footage import choose, diverged_takes, read_footage
from reskpn.viewing.player import FASTEST, SLOWEST, Player

EPILOG = f"""\
The page needs a browser with WebGL, and no network. It is served on 127.0.0.1
alone; from another machine: ssh -L PORT:127.0.0.1:PORT HOST.

{EXIT_CODES}"""


def add_options(parser: argparse.ArgumentParser) -> None:
    add_choice(parser)
    add = parser.add_argument
    add("--port", type=int, default=0, metavar="N", help="port of the page on 127.0.0.1 (default: any that is free)")
    add("--speed", type=float, default=1.0, metavar="X", help="simulated seconds per second (default: %(default)s)")
    add("--no-browser", action="store_true", help="do not open the page in a browser")


def run(given: argparse.Namespace) -> int:
    """Serve the viewer until Ctrl-C. Returns 0."""
    if not 0 <= given.port <= 65535:
        raise SettingsError(f"--port is {given.port}; allowed: 0 to 65535")
    if not SLOWEST <= given.speed <= FASTEST:
        raise SettingsError(f"--speed is {given.speed:g}; allowed: {SLOWEST:g} to {FASTEST:g}")
    footage = read_footage(given.path)
    first = choose(footage, version=given.version, episode=given.episode, diverged=given.diverged)
    takes = diverged_takes(footage, given.version) if given.diverged else list(footage.evaluated)
    if given.diverged:
        first = takes[given.episode]
    from reskpn.supervision.stopping import stopping
    from reskpn.viewing.scene import Scene
    from reskpn.viewing.studio import show

    player = Player(takes, takes.index(first), given.speed)
    with stopping(supervised=False) as stop:
        show(
            player,
            Scene(footage, takes),
            title=f"{footage.run}",
            port=given.port,
            open_browser=not given.no_browser,
            stopped=stop.is_set,
            say=partial(say, stream=sys.stdout),
        )
    return 0


COMMAND = Command(add_options, run, EPILOG, usage="reskpn view RUN [options]")
