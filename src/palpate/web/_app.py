"""The application: one session, its API, its websocket and one page.

What a session refuses becomes an answer here: 409 for what cannot be done now, 422
for what was not asked well, 507 where the disk has no room.
"""

import asyncio
import errno
import sqlite3
from collections import deque
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from typing import Any

from fastapi import FastAPI, Request, Response, WebSocket, WebSocketDisconnect
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, JSONResponse
from fastapi.staticfiles import StaticFiles
from pydantic import ValidationError

from ..sensors import ContactError, SensorError
from ._learning import LearningError
from ._request_guard import STATIC, RequestGuard, cookie_name, once_per_minute
from ._routes import router
from ._sensor_watch import Event
from ._session import LiveSession
from ._teaching import MissingObjectError, MissingTouchError

_COOKIE_S = 30 * 24 * 3600
_NOT_NOW = (ContactError, SensorError, LearningError)
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)
_MOST_CLIENTS, _LONGEST_QUEUE, _PATIENCE_S = 64, 200, 10.0  # of the websocket


def build_app(sessions: Sequence[LiveSession], token: str, **limits: Any) -> FastAPI:
    """Return the application; `palpate.web.create_app` explains the arguments."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        with once_per_minute():
            LiveSession.start_all(sessions)
            try:
                yield
            finally:
                for session in sessions:
                    session.stop()

    app = FastAPI(
        title="palpate",
        description="Teach objects by touch, and ask what is touched.",
        version="1",
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan,
        exception_handlers={
            RequestValidationError: _malformed,
            ValidationError: _malformed,
            **dict.fromkeys((*_NOT_NOW, ValueError, TypeError, OSError), _refused),
        },
    )
    for number, session in enumerate(sessions, start=1):
        session.listeners.number = number
    app.state.session, app.state.sessions = sessions[0], sessions
    app.include_router(router)
    app.websocket("/ws")(_Hub(sessions).serve)

    @app.get("/", include_in_schema=False)
    async def page(request: Request) -> Response:
        # No redirect: a browser that comes from another site would not send the cookie
        # along. The page takes the token out of its address.
        shown = FileResponse(STATIC / "index.html")
        if "token" in request.query_params:
            name = cookie_name(request)
            shown.set_cookie(
                name, token, max_age=_COOKIE_S, httponly=True, samesite="strict"
            )
        return shown

    app.mount("/static", StaticFiles(directory=STATIC), name="static")
    app.add_middleware(RequestGuard, token=token, **limits)
    return app


async def _refused(request: Request, error: Exception) -> JSONResponse:
    status, detail = 507 if _lacks_room(error) else 422, str(error)
    if isinstance(error, _NOT_NOW):
        status = 409
    elif isinstance(error, MissingObjectError | MissingTouchError):
        status = 404
    elif isinstance(error, OSError):
        reason = error.strerror or error
        status, detail = 507, f"The disk cannot be written to: {reason}. Free space."
    return JSONResponse({"detail": detail}, status)


async def _malformed(request: Request, error: Exception) -> JSONResponse:
    """Say what is wrong with a request, in valid JSON and without repeating it."""
    assert isinstance(error, RequestValidationError | ValidationError)
    detail = [
        {key: str(problem[key]) for key in ("msg", "type")}
        | {"loc": [*map(str, problem["loc"])]}
        for problem in error.errors()[:10]
    ]
    return JSONResponse({"detail": detail}, 422)


def _lacks_room(error: BaseException) -> bool:
    """Whether something failed because the disk would not be written to."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in _NO_ROOM:
            return True
        if isinstance(cause, sqlite3.Error):
            code = getattr(cause, "sqlite_errorcode", 0) & 0xFF
            return code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR)
        cause = cause.__cause__
    return False


class _Hub:
    """Hands events of sessions to all their websockets, none waiting for another.

    Every client has a place for the newest frame of each, and a short queue for all
    else. One that stops reading misses frames; when its queue is full it is let go.
    """

    def __init__(self, sessions: Sequence[LiveSession]) -> None:
        self._sessions = sessions
        self._clients: set[_Client] = set()

    async def serve(self, socket: WebSocket) -> None:
        if len(self._clients) >= _MOST_CLIENTS:
            await socket.close(code=1013, reason="Too many pages are open.")
            return
        await socket.accept()
        client = _Client(socket, asyncio.get_running_loop())
        self._clients.add(client)
        tasks: list[asyncio.Task[None]] = []
        try:
            for session in self._sessions:
                session.listeners.add(client.receive)
                await asyncio.to_thread(session.tell_state, client.receive)
            tasks = [asyncio.create_task(w()) for w in (client.listen, client.send)]
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for session in self._sessions:
                session.listeners.discard(client.receive)
            self._clients.discard(client)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            with suppress(RuntimeError, TimeoutError, WebSocketDisconnect):
                async with asyncio.timeout(1.0):
                    await socket.close()


class _Client:
    def __init__(self, socket: WebSocket, loop: asyncio.AbstractEventLoop) -> None:
        self._socket, self._loop = socket, loop
        self._frames: dict[int, Event] = {}
        self._waiting: deque[Event] = deque()
        self._pending = asyncio.Event()
        self._full = False

    def receive(self, event: Event) -> None:
        """Take an event from another thread, where its text is written too."""
        _ = event.text
        self._loop.call_soon_threadsafe(self.put, event)

    def put(self, event: Event) -> None:
        """Keep an event until it is sent; a newer frame takes the place of one."""
        if event.kind == "frame":
            self._frames[event.values["sensor_number"]] = event
        elif len(self._waiting) < _LONGEST_QUEUE:
            self._waiting.append(event)
        else:
            self._full = True
        self._pending.set()

    async def send(self) -> None:
        """Send what there is, as it comes; end where the client is too slow."""
        while not self._full:
            await self._pending.wait()
            self._pending.clear()
            while self._waiting:
                await self._send_one(self._waiting.popleft())
            frames, self._frames = self._frames, {}
            for frame in frames.values():
                await self._send_one(frame)

    async def listen(self) -> None:
        """Read until the client goes; "ping" is answered, all else ignored."""
        while True:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            if message.get("text") == "ping":
                self.put(Event("pong"))

    async def _send_one(self, event: Event) -> None:
        async with asyncio.timeout(_PATIENCE_S):
            if not event.picture:
                await self._socket.send_text(event.text)
                return
            text = event.text.encode()
            length = len(text).to_bytes(4, "big")
            await self._socket.send_bytes(length + text + event.picture)
