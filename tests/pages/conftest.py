"""The live page in Debian's Chromium: a server in this process, and what the browser reports as wrong."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from page_server import Server
from playwright.sync_api import Browser, Page, expect

from scripts.dashboard_picture import CHROMIUM, browser
from services.dashboard.service import Served

DEADLINE_MS = 30_000

expect.set_options(timeout=DEADLINE_MS)


def pytest_sessionstart() -> None:
    """Say so where there is no Chromium; in CI that is a failure."""
    if not CHROMIUM.exists():
        in_ci = bool(os.environ.get("CI"))
        pytest.exit(f"no page was tested: {CHROMIUM} is missing; as root: apt-get install chromium", int(in_ci))


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    with browser() as opened:
        yield opened


@pytest.fixture
def server() -> Iterator[Callable[..., Server]]:
    """Makes servers, started, and ends them."""
    made: list[Server] = []

    def make(*paths: Path, **options: object) -> Server:
        made.append(Server(Served(paths, **options)))  # type: ignore[arg-type]
        made[-1].start()
        return made[-1]

    yield make
    for one in made:
        one.end()


@pytest.fixture
def open_page(chromium: Browser) -> Iterator[Callable[..., Page]]:
    """Opens addresses. At the end nothing may have gone wrong in a page or have been asked of another server."""
    pages: list[Page] = []
    wrong: list[str] = []

    def make(address: str, width: int = 1280, dark: bool = False, expected: str = "") -> Page:
        page = chromium.new_page(
            viewport={"width": width, "height": 900}, color_scheme="dark" if dark else "light", locale="en-GB"
        )
        page.set_default_timeout(DEADLINE_MS)
        origin = "/".join(address.split("/")[:3]) + "/"

        def told(text: str) -> None:
            if not expected or expected not in text:
                wrong.append(text)

        page.on("console", lambda message: told(message.text) if message.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: told(str(error)))
        page.on("dialog", lambda dialog: told(f"dialog {dialog.message}"))
        page.on("request", lambda request: None if request.url.startswith((origin, "data:")) else told(request.url))
        pages.append(page)
        page.goto(address)
        return page

    yield make
    for page in pages:
        page.close()
    assert not wrong
