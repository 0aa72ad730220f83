"""Refusals of malformed requests, in words that are always valid JSON."""

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse


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
