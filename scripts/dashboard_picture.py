"""Write a picture of the live page: `python -m scripts.dashboard_picture RUN... --out docs/pictures/dashboard.png`.

Needs Debian's chromium, and playwright of the development requirements.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

CHROMIUM = Path("/usr/bin/chromium")

ARGUMENTS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip

DEADLINE_MS = 60_000


@contextmanager
def browser() -> Iterator[Browser]:
    """Debian's Chromium without a window, told to ask nobody for anything."""
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
        try:
            yield opened
        finally:
            opened.close()


@contextmanager
def served(runs: list[Path]) -> Iterator[str]:
    """The address of a page of these runs."""
    command = [sys.executable, "-m", "reskpn", "dashboard", "--supervised", "--run-dir", *map(str, runs)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield next(word for word in process.stdout.readline().split() if word.startswith("http://"))
    finally:
        process.terminate()
        process.communicate()


def take(address: str, out: Path, *, width: int, height: int | None, dark: bool) -> None:
    """Open the page, wait for its curves, and write the picture: the whole page where no height is given."""
    with browser() as opened:
        page = opened.new_page(
            viewport={"width": width, "height": height or 900}, color_scheme="dark" if dark else "light"
        )
        page.goto(address)
        # Not `wait_for_function`: the page's policy forbids to evaluate text in it.
        page.locator(".plot:not([hidden]) canvas").nth(6).wait_for(timeout=DEADLINE_MS)
        page.wait_for_timeout(1500)
        page.screenshot(path=out, full_page=height is None)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--width", type=int, default=1280)
    parser.add_argument("--height", type=int, help="cut the picture there (default: the whole page)")
    parser.add_argument("--dark", action="store_true")
    parser.add_argument("--show", default="", help="runs to lay over each other, as run=NAME&run=NAME")
    given = parser.parse_args()
    with served(given.runs) as address:
        take(f"{address}#{given.show}", given.out, width=given.width, height=given.height, dark=given.dark)


if __name__ == "__main__":
    main()
