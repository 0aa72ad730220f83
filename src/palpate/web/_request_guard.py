"""Who may come in, and how much they may bring: token, size, rate, connections.

Everything but the look of the page that asks for it needs the token: pages, API and
websocket. It comes as `Authorization: Bearer TOKEN`, as the cookie that the page sets
the first time, or, where nothing is changed, as `?token=TOKEN`; it is compared in
constant time. A request that a page of another site makes is refused by its `Origin`,
one for a name that is not this server's (DNS rebinding) by its `Host`. A browser that
is refused gets a page with a field for the token. Every answer forbids what the page
does not need.

Nobody needs a token to connect. Of connections that have not shown it yet the oldest
gives way to the next, so that whoever has the token always comes in, and the files the
process may open are never used up. What goes wrong again and again is said once a
minute.
"""

import asyncio
import hmac
import logging
import socket
import sys
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from ipaddress import ip_address
from pathlib import Path
from string import Template
from typing import Any
from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders
from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn import Server
from uvicorn.protocols.http.h11_impl import H11Protocol

STATIC = Path(__file__).parent / "static"
_RULES = (
    "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'"
)
_HEADERS = {
    "Content-Security-Policy": _RULES,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
# What the page that asks for the token looks like; everybody may have it.
_OPEN = ("/static/style.css", "/static/icon.svg")
_WHERE = "open the address that was printed when this server started."
_MOST_CLIENTS = 1000
_MOST_FIELDS = 100
_MORE_HEADERS = {401: {"WWW-Authenticate": "Bearer"}, 429: {"Retry-After": "1"}}
# Of a body that is too large so much more is read, and so long, before the refusal.
_DROP_TIMES, _DROP_S = 10, 0.5
# Bodies are images at these addresses; elsewhere they are a few words, which are read
# in the event loop.
_IMAGES, _FEW_WORDS = ("/api/touch", "/api/teach/touch"), 2**16  # or their /picture
# A body of which nothing comes for so long is given up.
_PART_S = 20.0
# A head that takes so long is given up.
_HEAD_S = 10.0
# Of the files that the process may open, this share may be connections without a token,
# and as much those with it; so many are accepted before any of them is looked at, and
# so many wait for that in the system.
_SHARE, _FILES, AT_ONCE, _QUEUE = 1 / 3, 1024, 32, 1024
_AGAIN_S, _MOST_MESSAGES = 60.0, 1000
_LOGGERS = ("asyncio", "uvicorn.error")

_Permits = dict[str, tuple[float, float]]  # of an address: how many, and when


class RequestGuard:
    """ASGI middleware that lets in whoever knows the token, within limits.

    These are bytes of a body, and requests per second that one address may keep up,
    twice as many at once; those without the token are counted apart, so that nobody's
    refused requests use up the owner's. `names` are those of this server beside its
    machine's own.
    """

    def __init__(
        self,
        app: ASGIApp,
        token: str,
        max_body: int,
        rate_hz: float,
        names: Collection[str] = (),
    ) -> None:
        self._app, self._token = app, token.encode()
        host = socket.gethostname().lower()
        self._names = {"localhost", host, f"{host}.local", *map(str.lower, names)}
        self._max_body, self._rate_hz = max_body, rate_hz
        self._signed_in: _Permits = {}
        self._strangers: _Permits = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        request = HTTPConnection(scope)
        refusal = self._refusal(request)
        signed_in = refusal is None and scope["path"] not in _OPEN
        if signed_in and (connection := scope.get("state", {}).get("connection")):
            connection.signed_in = True
        if not self._in_time(
            request, self._signed_in if signed_in else self._strangers
        ):
            refusal = 429, "Too many requests; slow down."
        if scope["type"] == "websocket":
            if refusal is None:
                await self._app(scope, receive, send)
            else:
                reason = {"code": 1008, "reason": refusal[1]}
                await send({"type": "websocket.close", **reason})
            return

        async def send_with_rules(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        if refusal is not None:
            await _refuse(scope, receive, send_with_rules, *refusal)
            return
        with suppress(ClientDisconnect):
            await self._within_size(scope, receive, send_with_rules)

    def _refusal(self, request: HTTPConnection) -> tuple[int, str] | None:
        if not self._is_ours(request.headers.get("host", "")):
            return 403, (
                "Host must be a name of this server, got another. Use its address, "
                "or start it with that as one of its `names`."
            )
        if _from_elsewhere(request):
            return 403, "Requests from pages of other sites are refused."
        if request.scope["path"] in _OPEN:
            return None
        few = request.scope["query_string"].count(b"&") < _MOST_FIELDS
        in_address = request.query_params.get("token") if few else None
        if in_address and request.scope.get("method", "GET") not in ("GET", "HEAD"):
            return 403, (
                "The token must not be in the address of a request that changes "
                "something. Send it as Authorization: Bearer TOKEN."
            )
        kind, _, bearer = request.headers.get("authorization", "").partition(" ")
        named = bearer.strip() if kind.lower() == "bearer" else ""
        token = named or in_address or request.cookies.get(cookie_name(request))
        if token is None:
            return 401, f"The token is missing; {_WHERE}"
        if not hmac.compare_digest(token.encode(), self._token):
            return 403, f"The token is wrong; {_WHERE}"
        return None

    def _is_ours(self, host: str) -> bool:
        """Whether a request names this server: by a number, or by a name it has."""
        with suppress(ValueError):
            name = urlsplit(f"//{host}").hostname or ""
            if name in self._names:
                return True
            return bool(ip_address(name))
        return False

    def _in_time(self, request: HTTPConnection, permits: _Permits) -> bool:
        """Take a permit of an address; they come back at the rate, up to twice it."""
        client = "" if request.client is None else request.client.host
        if client not in permits and len(permits) >= _MOST_CLIENTS:
            permits.clear()
        now_s, most = time.monotonic(), 2 * self._rate_hz
        left, before_s = permits.get(client, (most, now_s))
        left = min(most, left + (now_s - before_s) * self._rate_hz)
        permits[client] = (left - 1 if left >= 1 else left), now_s
        return left >= 1

    async def _within_size(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand on a request whose body is read here, up to the limit."""
        images = scope["path"].removesuffix("/picture") in _IMAGES
        most = self._max_body if images else min(self._max_body, _FEW_WORDS)
        try:
            body = await self._body(Request(scope, receive), most)
            refusal = 413, f"The body must be at most {most} bytes."
        except TimeoutError:
            body = None
            refusal = 408, f"The body stopped coming for {_PART_S:g} s. Send it again."
        if body is None:
            await _refuse(scope, receive, send, *refusal)
            return
        read = False

        async def receive_read() -> Message:
            nonlocal read
            if read:
                return await receive()
            read = True
            return {"type": "http.request", "body": body, "more_body": False}

        await self._app(scope, receive_read, send)

    async def _body(self, request: Request, most: int) -> bytes | None:
        """Return the body of a request, None where it is over `most` bytes.

        Of such a one more is read for a while, and dropped: a client that is still
        sending does not read the answer.
        """
        now_s = asyncio.get_running_loop().time
        length = request.headers.get("content-length", "")
        too_large = length.isdecimal() and int(length) > most
        body, n_dropped = bytearray(), 0
        try:
            async with asyncio.timeout(_DROP_S if too_large else _PART_S) as limit:
                async for part in request.stream():
                    if not too_large and len(body) + len(part) > most:
                        too_large = True
                        limit.reschedule(now_s() + _DROP_S)
                    if not too_large:
                        body += part
                        limit.reschedule(now_s() + _PART_S)
                        continue
                    n_dropped += len(part)
                    if n_dropped > _DROP_TIMES * most:
                        break
        except TimeoutError:
            if not too_large:
                raise
        return None if too_large else bytes(body)


def cookie_name(request: HTTPConnection) -> str:
    """Return the cookie's name: cookies are of all ports of a host alike."""
    return f"palpate_token_{(request.scope.get('server') or ('', 0))[1]}"


def _from_elsewhere(request: HTTPConnection) -> bool:
    """Whether a page of another site sent this (pages of ours name our host)."""
    origin = request.headers.get("origin")
    if origin is None:
        return False
    try:
        return urlsplit(origin).netloc != request.headers.get("host", "")
    except ValueError:
        return True


async def _refuse(
    scope: Scope, receive: Receive, send: Send, status: int, detail: str
) -> None:
    headers = {"Connection": "close", **_MORE_HEADERS.get(status, {})}
    answer: Response = JSONResponse({"detail": detail}, status, headers)
    request = Request(scope)
    if request.method == "GET" and "text/html" in request.headers.get("accept", ""):
        page = Template((STATIC / "sign-in.html").read_text(encoding="utf-8"))
        answer = HTMLResponse(page.substitute(detail=detail), status, headers)
    await answer(scope, receive, send)


class PatientProtocol(H11Protocol):
    """HTTP whose connections are bounded, as is the time that a head may take.

    uvicorn limits how long a connection may rest between two requests, not how long
    the first one, or one that was begun, may take. `RequestGuard` finds a connection
    in the state of its requests, and tells it by `signed_in` that the token was shown.
    """

    signed_in = False
    _ending: asyncio.TimerHandle | None = None

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.app_state = {**self.app_state, "connection": self}

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._made_s = self.loop.time()
        self._make_room()
        self._wait()

    def data_received(self, data: bytes) -> None:
        """Go on waiting unless a request is whole, or a websocket by now."""
        super().data_received(data)
        self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self._wait(False)

    @property
    def _answering(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _make_room(self) -> None:
        """Close the oldest of the connections that wait, beyond what may be open."""
        waiting = [
            connection
            for connection in self.connections
            if isinstance(connection, PatientProtocol)
            and not connection._answering
            and not connection.transport.is_closing()
        ]
        for signed_in in (False, True):
            alike = [
                connection
                for connection in waiting
                if connection.signed_in == signed_in
            ]
            if len(alike) > most_waiting():
                min(alike, key=lambda connection: connection._made_s).transport.abort()

    def _wait(self, whether: bool = True) -> None:
        upgraded = self.transport.get_protocol() is not self
        if not whether or self._answering or upgraded:
            if self._ending is not None:
                self._ending.cancel()
            self._ending = None
        elif self._ending is None:
            self._ending = self.loop.call_later(_HEAD_S, self.transport.close)


def most_waiting() -> int:
    """Return how many connections of a kind may wait, by the limit of open files."""
    files = _FILES
    if sys.platform != "win32":
        import resource

        files = min(files, resource.getrlimit(resource.RLIMIT_NOFILE)[0])
    return int(files * _SHARE)


class PatientServer(Server):
    """A server that takes a few connections at a time from a long queue.

    asyncio has one number for both, and while it takes, nothing else goes on.
    """

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        for listening in sockets or ():
            listening.listen(_QUEUE)


class OncePerMinute(logging.Filter):
    """Lets a message through once a minute, by its first line."""

    def __init__(self) -> None:
        super().__init__()
        self._last_s: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the message was not said within the last minute."""
        message, now_s = record.getMessage().partition("\n")[0], time.monotonic()
        if now_s - self._last_s.get(message, -_AGAIN_S) < _AGAIN_S:
            return False
        if len(self._last_s) >= _MOST_MESSAGES:
            self._last_s.clear()
        self._last_s[message] = now_s
        return True


@contextmanager
def once_per_minute() -> Iterator[None]:
    """Keep the log of a server from growing by one message again and again."""
    once = OncePerMinute()
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    for logger in loggers:
        logger.addFilter(once)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeFilter(once)
