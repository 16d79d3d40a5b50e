"""The guard in front of the page: the Host that was asked for, the token where one is needed, and headers."""

from __future__ import annotations

import hmac
import ipaddress
import re
import socket
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any
from urllib.parse import urlencode

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

HEADERS = {
    # Everything comes from this server; styles that scripts set one by one are not inline styles.
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}

_HOST = re.compile(r"(?P<name>\[[^][]+\]|[^][:]+)(?::\d{1,5})?")

HEALTH = "/health"
"""Answers without a token, and says nothing about runs."""


class Guard:
    """Lets requests through to `app` whose Host is this machine's, with the token if there is one.

    A page elsewhere could have its own name point here (DNS rebinding) and read what comes back: so names are refused
    that are neither an address, nor localhost, nor among `names`.

    The token comes as `Authorization: Bearer`, as `?token=` in the address, which sets a cookie and is taken out of the
    address again, or as that cookie. The cookie's name has the port: cookies of a host are those of all its ports.
    """

    def __init__(self, app: App, token: str | None, names: frozenset[str], port: int) -> None:
        self._app = app
        self._token = token
        self._names = names | {"localhost"}
        self._cookie = f"reskpn-dashboard-{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(raw=message["headers"])
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
                message["headers"] = headers.raw
            await send(message)

        refused = self._refusal(Request(scope))
        await (refused or self._app)(scope, receive, send_guarded)

    def _refusal(self, request: Request) -> Response | None:
        """The answer to a request that is not let through; None for one that is."""
        if not self.is_own_host(request.headers):
            return PlainTextResponse("The page is not served under that name: use its address, or --allow-host.\n", 421)
        if self._token is None or request.url.path == HEALTH:
            return None
        given = request.query_params.get("token")
        if given is not None and self._is_token(given):
            return self._without_token(request, given)
        kind, _, bearer = request.headers.get("Authorization", "").partition(" ")
        if kind.lower() == "bearer" and self._is_token(bearer.strip()):
            return None
        if self._is_token(request.cookies.get(self._cookie, "")):
            return None
        return PlainTextResponse(
            "A token is needed: open the address with ?token=... that was given with it, or send it as "
            "'Authorization: Bearer ...'.\n",
            401,
            {"WWW-Authenticate": "Bearer"},
        )

    def is_own_host(self, headers: Headers) -> bool:
        """True if the Host header is an address or one of the names of this machine."""
        match = _HOST.fullmatch(headers.get("Host", ""))
        if match is None:
            return False
        name = match["name"].strip("[]")
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name.lower().rstrip(".") in self._names
        return True

    def _is_token(self, given: str) -> bool:
        return self._token is not None and hmac.compare_digest(given.encode(), self._token.encode())

    def _without_token(self, request: Request, token: str) -> Response:
        rest = [(name, value) for name, value in request.query_params.multi_items() if name != "token"]
        # A path of slashes would be another server's address.
        place = "/" + request.url.path.lstrip("/\\") + (f"?{urlencode(rest)}" if rest else "")
        answer = RedirectResponse(place, 303)
        answer.set_cookie(self._cookie, token, httponly=True, samesite="lax", path="/")
        return answer


def own_names() -> frozenset[str]:
    """The names by which this machine knows itself."""
    return frozenset(name.lower().rstrip(".") for name in (socket.gethostname(), socket.getfqdn()) if name)
