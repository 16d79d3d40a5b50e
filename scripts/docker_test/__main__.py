"""Build the image, run docker-compose.yml through all steps and count failures: `python -m scripts.docker_test`.

Exit code 0 where all passed, 1 where something failed, 77 where no Docker engine is to be had here.
"""

from __future__ import annotations

import secrets
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from reskpn.authority import make_all
from scripts.docker_test.engine import CannotRun, Engine, some_engine
from scripts.docker_test.project import build, project
from scripts.docker_test.story import ENVS, SETTINGS, STEPS, Story

IMAGE = "reskpn:test"
TENSORBOARD_IMAGE = "reskpn:test-tensorboard"
SHORT = {"RESKPN_TOTAL_STEPS": str(20 * ENVS * STEPS), "RESKPN_ACTORS": "2"}


def main() -> int:
    began_s = time.monotonic()

    def say(text: str) -> None:
        print(f"[{time.monotonic() - began_s:4.0f} s] {text}", flush=True)

    try:
        with some_engine() as engine:
            say("an engine answers; building the images")
            build(engine, IMAGE)
            build(engine, TENSORBOARD_IMAGE, "tensorboard")
            say("built")
            passed, failed = _all_checks(engine, say)
    except CannotRun as error:
        print(f"test-docker: cannot run here: {error}", flush=True)
        return 77
    print(f"{passed} passed, {failed} failed")
    return 1 if failed else 0


def _all_checks(engine: Engine, say: Callable[[str], None]) -> tuple[int, int]:
    """Run the steps; returns the numbers that passed and failed. Steps after a failure are skipped."""
    name = f"reskpn-test-{secrets.token_hex(3)}"
    images = {"IMAGE": IMAGE, "TENSORBOARD_IMAGE": TENSORBOARD_IMAGE}
    with project(engine, name, **images, **SETTINGS) as made:
        story = Story(made)
        steps = story.steps() | {
            "up in the foreground ends with exit code 0": lambda: _plain_up(engine, name),
            "a router lets in who has its certificates": lambda: _router(engine, name),
        }
        for passed, (what, step) in enumerate(steps.items()):
            try:
                step()
            except Exception:
                say(f"FAILED: {what}")
                traceback.print_exc()
                say(made.last_words(lines=30))
                return passed, 1
            say(f"ok: {what}")
        sizes = [int(made.docker("image", "inspect", "-f", "{{.Size}}", image)) for image in images.values()]
        say(f"image {sizes[0] / 1e9:.2f} GB, with TensorBoard {(sizes[1] - sizes[0]) / 1e6:.0f} MB more")
        say(f"first update {story.first_update_s:.1f} s after up, with an empty cache")
        say(f"the learner's crash cost {story.lost_s:.1f} s until the next new update")
    return len(steps), 0


def _plain_up(engine: Engine, name: str) -> None:
    """`up` in the foreground, as a user runs it: it returns with exit code 0 at the end of the run."""
    with project(engine, f"{name}-up", IMAGE=IMAGE, **SETTINGS | SHORT) as made:
        said = made.compose("up", "--no-build", timeout_s=600.0)
        assert "finished" in said, said
        assert made.updates() == 20, said
        assert not made.running()


def _router(engine: Engine, name: str) -> None:
    """The router, started by its profile with certificates of this machine; its health check connects like an actor."""
    with tempfile.TemporaryDirectory() as folder:
        certificates = Path(folder) / "certs"
        make_all(certificates, ["router"], days=1)
        for path in (Path(folder), *certificates.rglob("*")):
            path.chmod(0o755 if path.is_dir() else 0o644)  # throwaway keys, for the container's user to read
        settings = {"IMAGE": IMAGE, "CERTIFICATES": str(certificates), "ROUTER_PORT": "0"}
        with project(engine, f"{name}-router", **settings) as made:
            made.compose("--profile", "router", "up", "-d", "--no-build", "router")
            (router,) = made.containers("router")
            made.wait_for("health of the router", lambda: made.health(router) == "healthy", deadline_s=120.0)
            assert made.running() == []  # it is no part of a run
            made.docker("stop", router)
            assert made.state(router)["ExitCode"] == 0, made.last_words()
            assert "stopped; refused connections: none" in made.words(router), made.last_words()


if __name__ == "__main__":
    sys.exit(main())
