"""The page as a web application: its files, the stream of what changes, figures for Prometheus."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route

from services.dashboard.collection import RunCollection
from services.dashboard.prometheus import exposition
from services.dashboard.run_view import Cursor
from services.dashboard.security import HEALTH

TYPES = {
    "page.html": "text/html; charset=utf-8",
    "page.css": "text/css; charset=utf-8",
    "uplot.min.css": "text/css; charset=utf-8",
    "uplot.min.js": "text/javascript; charset=utf-8",
    "page.js": "text/javascript; charset=utf-8",
    "plots.js": "text/javascript; charset=utf-8",
    "tables.js": "text/javascript; charset=utf-8",
    "texts.js": "text/javascript; charset=utf-8",
    "icon.svg": "image/svg+xml",
}
"""Every file of the page, and its type."""

TICK_S = 1.0
"""Seconds from one message of a stream to the next."""

SILENCE_S = 15.0
"""Seconds after which a stream says that it is still there, so that nothing on the way closes it."""

MOST_STREAMS = 32
MOST_SHOWN = 12
"""Runs that one page shows at most."""


class Page:
    """The routes; `stop` ends the streams that are open."""

    def __init__(self, runs: RunCollection, stop: threading.Event) -> None:
        self._runs = runs
        self._stop = stop
        self._streams = 0
        folder = Path(__file__).parent / "static"
        self._files = {name: (folder / name).read_bytes() for name in TYPES}

    def application(self) -> Starlette:
        """The application, without its guard."""
        return Starlette(
            routes=[
                Route("/", self._page),
                Route("/static/{name}", self._file),
                Route("/stream", self._stream),
                Route("/metrics", self._metrics),
                Route(HEALTH, self._health),
            ]
        )

    async def _page(self, request: Request) -> Response:
        return self._content("page.html")

    async def _file(self, request: Request) -> Response:
        name = request.path_params["name"]
        return self._content(name) if name in self._files else PlainTextResponse("no such file\n", 404)

    def _content(self, name: str) -> Response:
        return Response(self._files[name], headers={"Content-Type": TYPES[name]})

    async def _health(self, request: Request) -> Response:
        return PlainTextResponse("ok\n")

    async def _metrics(self, request: Request) -> Response:
        runs = self._runs.looked_at(self._runs.running())
        content = exposition(runs)
        return Response(content, headers={"Content-Type": "text/plain; version=0.0.4; charset=utf-8"})

    async def _stream(self, request: Request) -> Response:
        if self._streams >= MOST_STREAMS:
            return PlainTextResponse(f"{MOST_STREAMS} pages are open already; close one\n", 503)
        chosen = request.query_params.getlist("run")[:MOST_SHOWN]
        return StreamingResponse(self._counted(chosen), media_type="text/event-stream")

    async def _counted(self, chosen: Sequence[str]) -> AsyncIterator[str]:
        self._streams += 1
        try:
            async for message in self.messages(chosen):
                yield message
        finally:
            self._streams -= 1

    async def messages(self, chosen: Sequence[str]) -> AsyncIterator[str]:
        """Server-sent events: `runs`, the list of all runs, and `run`, what was added to one of the chosen.

        Of runs that were not found, or where none is chosen, the newest is shown.
        """
        entries: list[dict[str, Any]] | None = None
        cursors: dict[str, Cursor] = {}
        spoke_s = time.monotonic()
        while not self._stop.is_set():
            shown = self._runs.looked_at(chosen) or self._runs.looked_at(self._runs.default())
            now = self._runs.entries()
            if now != entries:
                entries = now
                yield _event("runs", {"runs": entries, "shown": [run.identity for run in shown]})
                spoke_s = time.monotonic()
            for run in shown:
                added, cursors[run.identity] = run.view.since(cursors.get(run.identity, Cursor()))
                if added is not None:
                    yield _event("run", added)
                    spoke_s = time.monotonic()
            if time.monotonic() - spoke_s > SILENCE_S:
                yield ": still here\n\n"
                spoke_s = time.monotonic()
            # Soon again where the first records of a run are still being read.
            quick = any(not run.view.state for run in shown)
            await asyncio.sleep(0.1 if quick else TICK_S)


def _event(name: str, content: dict[str, Any]) -> str:
    return f"event: {name}\ndata: {json.dumps(content, separators=(',', ':'), allow_nan=False)}\n\n"
