"""The application: one session, its API, its websocket and one page.

What a session refuses becomes an answer here: 409 for what cannot be done now, 422
for what was not asked well, 507 where the disk has no room.
"""

import errno
import sqlite3
from collections.abc import AsyncIterator, Collection
from contextlib import asynccontextmanager

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, JSONResponse
from fastapi.staticfiles import StaticFiles
from pydantic import ValidationError

from ..sensors import ContactError, SensorError
from ._learning import LearningError
from ._request_guard import STATIC, RequestGuard, cookie_name
from ._routes import router
from ._session import LiveSession
from ._teaching import MissingObjectError
from ._websocket import Hub

_COOKIE_S = 30 * 24 * 3600
_NOT_NOW = (ContactError, SensorError, LearningError)
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)


def build_app(
    session: LiveSession,
    token: str,
    *,
    max_body: int,
    rate_hz: float,
    names: Collection[str],
) -> FastAPI:
    """Return the application; `palpate.web.create_app` explains the arguments."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        session.start()
        try:
            yield
        finally:
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
    app.state.session = session
    app.include_router(router)
    app.websocket("/ws")(Hub(session).serve)

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
    app.add_middleware(
        RequestGuard, token=token, max_body=max_body, rate_hz=rate_hz, names=names
    )
    return app


async def _refused(request: Request, error: Exception) -> JSONResponse:
    status, detail = 507 if _lacks_room(error) else 422, str(error)
    if isinstance(error, _NOT_NOW):
        status = 409
    elif isinstance(error, MissingObjectError):
        status = 404
    elif isinstance(error, OSError):
        reason = error.strerror or error
        status, detail = 507, f"The disk cannot be written to: {reason}. Free space."
    return JSONResponse({"detail": detail}, status)


async def _malformed(request: Request, error: Exception) -> JSONResponse:
    """Say what is wrong with a request, in valid JSON and without repeating it."""
    assert isinstance(error, RequestValidationError | ValidationError)
    detail = [
        {key: str(one[key]) for key in ("msg", "type")}
        | {"loc": [*map(str, one["loc"])]}
        for one in error.errors()[:10]
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
