"""Refusals: malformed requests, in words that are always valid JSON; full disks."""

import errno
import sqlite3

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)


def lacks_room(error: BaseException) -> bool:
    """Tell whether something failed because the disk would not be written to."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in _FULL:
            return True
        if isinstance(cause, sqlite3.Error):
            code = getattr(cause, "sqlite_errorcode", 0) & 0xFF
            return code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR)
        cause = cause.__cause__
    return False


def explain_refusals(app: FastAPI) -> None:
    """Answer malformed requests with what is wrong, without repeating them."""

    @app.exception_handler(RequestValidationError)
    async def refuse(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, RequestValidationError)
        detail = [
            {
                "loc": [str(part) for part in one["loc"]],
                "msg": str(one["msg"]),
                "type": str(one["type"]),
            }
            for one in error.errors()[:10]
        ]
        return JSONResponse({"detail": detail}, status_code=422)
