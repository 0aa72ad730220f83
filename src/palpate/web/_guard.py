"""Who may come in, and how much they may bring: token, body size and rate.

Everything is asked for the token alike: pages, API and websocket. It comes as
`Authorization: Bearer TOKEN`, as `?token=TOKEN`, or as the cookie that the page sets
the first time; it is compared in constant time. A request that a page of another
site makes is refused by its `Origin`.
"""

import asyncio
import hmac
import json
import time
from collections.abc import Awaitable, Callable, MutableMapping
from contextlib import suppress
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

COOKIE = "palpate_token"
_MOST_CLIENTS = 1000
# Of a body that is too large so much more is read, and so long, before the refusal.
_DROP_TIMES, _DROP_S = 10, 0.5


class Guard:
    """ASGI middleware that lets in whoever knows the token, within limits.

    Parameters
    ----------
    app : ASGI application
        What is guarded.
    token : str
        The secret.
    max_body : int
        Largest body of a request, in bytes.
    rate_hz : float
        Requests per second that one address may keep up; twice as many at once.
    """

    def __init__(self, app: App, token: str, max_body: int, rate_hz: float) -> None:
        self._app, self._token = app, token.encode()
        self._max_body = max_body
        self._buckets: dict[str, _Bucket] = {}
        self._rate_hz = rate_hz

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer or hand on one request or one websocket."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        refusal = self._refusal(scope)
        if refusal is not None:
            await _refuse(scope, send, *refusal)
            return
        if scope["type"] == "websocket":
            await self._app(scope, receive, send)
            return
        await self._within_size(scope, receive, send)

    def _refusal(self, scope: Scope) -> tuple[int, str] | None:
        """Return status and sentence where somebody must stay out."""
        if not self._in_time(scope):
            return 429, "Too many requests; slow down."
        given = _given_token(scope)
        if given is None:
            return 401, "The token is missing; open the address palpate serve printed."
        if not hmac.compare_digest(given.encode(), self._token):
            return 403, "The token is wrong; open the address palpate serve printed."
        if _from_elsewhere(scope):
            return 403, "Requests from pages of other sites are refused."
        return None

    def _in_time(self, scope: Scope) -> bool:
        client = (scope.get("client") or ("", 0))[0]
        if client not in self._buckets and len(self._buckets) >= _MOST_CLIENTS:
            self._buckets.clear()
        bucket = self._buckets.setdefault(client, _Bucket(self._rate_hz))
        return bucket.take()

    async def _within_size(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand on a request whose body is read here, up to the limit."""
        told = f"The body must be at most {self._max_body} bytes."
        length = _header(scope, b"content-length")
        if length is not None and length.isdigit() and int(length) > self._max_body:
            await _drop_rest(receive, self._max_body)
            await _refuse(scope, send, 413, told)
            return
        body = bytearray()
        more = True
        while more:
            message = await receive()
            if message["type"] == "http.disconnect":
                return
            body += message.get("body", b"")
            more = message.get("more_body", False)
            if len(body) > self._max_body:
                if more:
                    await _drop_rest(receive, self._max_body)
                await _refuse(scope, send, 413, told)
                return
        read = False

        async def receive_read() -> Message:
            nonlocal read
            if read:
                return await receive()
            read = True
            return {"type": "http.request", "body": bytes(body), "more_body": False}

        await self._app(scope, receive_read, send)


class _Bucket:
    """Permits that come back at a rate; twice the rate may wait."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._left, self._at_s = 2 * rate_hz, time.monotonic()

    def take(self) -> bool:
        now_s = time.monotonic()
        gained = (now_s - self._at_s) * self._rate_hz
        self._left, self._at_s = min(2 * self._rate_hz, self._left + gained), now_s
        if self._left < 1:
            return False
        self._left -= 1
        return True


def _given_token(scope: Scope) -> str | None:
    """Return the token that came with a request, or None."""
    authorization = _header(scope, b"authorization") or ""
    kind, _, given = authorization.partition(" ")
    if kind.lower() == "bearer" and given:
        return given.strip()
    query = scope.get("query_string", b"").decode("latin-1")
    asked = parse_qs(query, max_num_fields=100) if query.count("&") < 100 else {}
    if asked.get("token"):
        return asked["token"][0]
    try:
        morsel = SimpleCookie(_header(scope, b"cookie") or "").get(COOKIE)
    except CookieError:
        return None
    return None if morsel is None else morsel.value


def _from_elsewhere(scope: Scope) -> bool:
    """Tell whether a page of another site sent this (pages of ours name our host)."""
    origin = _header(scope, b"origin")
    if origin is None:
        return False
    try:
        return urlsplit(origin).netloc != (_header(scope, b"host") or "")
    except ValueError:
        return True


def _header(scope: Scope, name: bytes) -> str | None:
    for key, value in scope["headers"]:
        if key == name:
            return str(value.decode("latin-1"))
    return None


async def _drop_rest(receive: Receive, most_bytes: int) -> None:
    """Read on for a while without keeping it: who is still sending hears no answer."""
    dropped, more = 0, True
    with suppress(TimeoutError):
        async with asyncio.timeout(_DROP_S):
            while more and dropped <= _DROP_TIMES * most_bytes:
                message = await receive()
                dropped += len(message.get("body", b""))
                more = message.get("more_body", False)


async def _refuse(scope: Scope, send: Send, status: int, told: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": told})
        return
    body = json.dumps({"detail": told}).encode()
    headers = [
        (b"content-type", b"application/json"),
        (b"content-length", str(len(body)).encode()),
        (b"connection", b"close"),
    ]
    if status == 401:
        headers.append((b"www-authenticate", b"Bearer"))
    if status == 429:
        headers.append((b"retry-after", b"1"))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
