"""The viewer's page, served on loopback; its picture is drawn by a browser, which docs/look.md shows."""

from __future__ import annotations

import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from logs import usual_log

from common.wire.endpoint import free_port
from reskpn.cli import main

ROOT = Path(__file__).parents[3]
DEADLINE_S = 150.0


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return usual_log(tmp_path_factory.mktemp("run"))


@pytest.fixture(scope="module")
def viewer(run_dir: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command, and the line that it prints once the page is there."""
    command = [sys.executable, "-m", "reskpn", "view", str(run_dir), "--no-browser", "--port", str(free_port())]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process, process.stdout.readline()
        finally:
            process.terminate()


def test_the_page_is_served_on_loopback_and_ends_with_a_signal(viewer: tuple[subprocess.Popen[str], str]) -> None:
    """One line with its address, the page and the model behind it, exit code 0, and nothing else on the screen."""
    process, line = viewer
    assert line.startswith("http://127.0.0.1:"), process.communicate(timeout=DEADLINE_S)[1]
    assert line.endswith("/ shows cart-1; Ctrl-C ends it\n")
    address = line.split()[0]
    with urllib.request.urlopen(address, timeout=DEADLINE_S) as page:
        assert b"<canvas" in page.read()
    with urllib.request.urlopen(f"{address}model", timeout=DEADLINE_S) as model:
        assert len(model.read()) > 1000
    port = int(address.rstrip("/").rpartition(":")[2])
    listening = Path("/proc/net/tcp").read_text() + Path("/proc/net/tcp6").read_text()
    # addresses are hexadecimal, the bytes of an IPv4 address in reverse; state 0A listens
    found = [words[1] for words in map(str.split, listening.splitlines()) if words[3] == "0A"]
    assert [at for at in found if at.endswith(f":{port:04X}")] == [f"0100007F:{port:04X}"]
    process.terminate()
    out, err = process.communicate(timeout=DEADLINE_S)
    assert (process.returncode, out, err) == (0, "", "")


@pytest.mark.parametrize(
    ("options", "code", "sentence"),
    [
        (["--port", "70000"], 2, "--port is 70000; allowed: 0 to 65535"),
        (["--speed", "9"], 2, "--speed is 9; allowed: 0.05 to 4"),
        (["--version", "7"], 2, "--version is 7; the log has trajectories of versions 0, 20"),
        (["--diverged", "--episode", "5"], 2, "--episode is 5; the log has 2 diverged simulations, counted from 0"),
    ],
)
def test_wrong_options(
    run_dir: Path, options: list[str], code: int, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Refused before a port is opened."""
    assert main(["view", str(run_dir), *options]) == code
    assert capsys.readouterr().err == f"reskpn view: {sentence}\n"


def test_looking_needs_no_jax() -> None:
    """Neither command imports it, so that a page is there in a second or two."""
    program = (
        "import sys; import reskpn.commands.view, reskpn.commands.film; "
        "import reskpn.viewing.studio, reskpn.viewing.foxglove; "
        "raise SystemExit(str([name for name in sys.modules if name in ('jax', 'brax', 'flax')] or ''))"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stderr.strip()) in ((0, ""), (1, "")), done.stderr
