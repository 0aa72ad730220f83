"""Who may come in, and how much they may bring: token, body size and rate.

Everything is asked for the token alike: pages, API and websocket. It comes as
`Authorization: Bearer TOKEN`, as `?token=TOKEN`, or as the cookie that the page sets
the first time; it is compared in constant time. A request that a page of another
site makes is refused by its `Origin`.
"""

import asyncio
import hmac
import time
from contextlib import suppress
from urllib.parse import urlsplit

from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

COOKIE = "palpate_token"
_MOST_CLIENTS = 1000
_MOST_FIELDS = 100
_MORE_HEADERS = {401: {"WWW-Authenticate": "Bearer"}, 429: {"Retry-After": "1"}}
# Of a body that is too large so much more is read, and so long, before the refusal.
_DROP_TIMES, _DROP_S = 10, 0.5


class RequestGuard:
    """ASGI middleware that lets in whoever knows the token, within limits.

    These are bytes of a body, and requests per second that one address may keep up,
    twice as many at once.
    """

    def __init__(self, app: ASGIApp, token: str, max_body: int, rate_hz: float) -> None:
        self._app, self._token = app, token.encode()
        self._max_body, self._rate_hz = max_body, rate_hz
        self._permits: dict[str, tuple[float, float]] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer or hand on one request or one websocket."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        refusal = self._refusal(HTTPConnection(scope))
        if refusal is not None:
            await _refuse(scope, receive, send, *refusal)
        elif scope["type"] == "websocket":
            await self._app(scope, receive, send)
        else:
            with suppress(ClientDisconnect):
                await self._within_size(scope, receive, send)

    def _refusal(self, asked: HTTPConnection) -> tuple[int, str] | None:
        """Return status and sentence where somebody must stay out."""
        if not self._in_time(asked):
            return 429, "Too many requests; slow down."
        given = _given_token(asked)
        if given is None:
            return 401, "The token is missing; open the address palpate serve printed."
        if not hmac.compare_digest(given.encode(), self._token):
            return 403, "The token is wrong; open the address palpate serve printed."
        if _from_elsewhere(asked):
            return 403, "Requests from pages of other sites are refused."
        return None

    def _in_time(self, asked: HTTPConnection) -> bool:
        """Take a permit of an address; they come back at the rate, up to twice it."""
        client = "" if asked.client is None else asked.client.host
        if client not in self._permits and len(self._permits) >= _MOST_CLIENTS:
            self._permits.clear()
        now_s, most = time.monotonic(), 2 * self._rate_hz
        left, before_s = self._permits.get(client, (most, now_s))
        left = min(most, left + (now_s - before_s) * self._rate_hz)
        self._permits[client] = (left - 1 if left >= 1 else left), now_s
        return left >= 1

    async def _within_size(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand on a request whose body is read here, up to the limit."""
        body = await self._body(Request(scope, receive))
        if body is None:
            detail = f"The body must be at most {self._max_body} bytes."
            await _refuse(scope, receive, send, 413, detail)
            return
        read = False

        async def receive_read() -> Message:
            nonlocal read
            if read:
                return await receive()
            read = True
            return {"type": "http.request", "body": body, "more_body": False}

        await self._app(scope, receive_read, send)

    async def _body(self, request: Request) -> bytes | None:
        """Return the body of a request, None where it is too large.

        Of such a one more is read for a while, and dropped: a client that is still
        sending does not read the answer.
        """
        length = request.headers.get("content-length", "")
        too_large = length.isdecimal() and int(length) > self._max_body
        body, n_dropped = bytearray(), 0
        with suppress(TimeoutError):
            async with asyncio.timeout(_DROP_S if too_large else None) as limit:
                async for part in request.stream():
                    if not too_large and len(body) + len(part) > self._max_body:
                        too_large = True
                        now_s = asyncio.get_running_loop().time()
                        limit.reschedule(now_s + _DROP_S)
                    if not too_large:
                        body += part
                        continue
                    n_dropped += len(part)
                    if n_dropped > _DROP_TIMES * self._max_body:
                        break
        return None if too_large else bytes(body)


def _given_token(asked: HTTPConnection) -> str | None:
    """Return the token that came with a request, or None."""
    kind, _, given = asked.headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer" and given:
        return given.strip()
    few = asked.scope["query_string"].count(b"&") < _MOST_FIELDS
    in_address = asked.query_params.get("token") if few else None
    return in_address or asked.cookies.get(COOKIE)


def _from_elsewhere(asked: HTTPConnection) -> bool:
    """Whether a page of another site sent this (pages of ours name our host)."""
    origin = asked.headers.get("origin")
    if origin is None:
        return False
    try:
        return urlsplit(origin).netloc != asked.headers.get("host", "")
    except ValueError:
        return True


async def _refuse(
    scope: Scope, receive: Receive, send: Send, status: int, detail: str
) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": detail})
        return
    headers = {"Connection": "close", **_MORE_HEADERS.get(status, {})}
    answer = JSONResponse({"detail": detail}, status, headers)
    await answer(scope, receive, send)
