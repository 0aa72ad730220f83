"""The application: one session, its API, its websocket and one page."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from fastapi import FastAPI, Request, Response, WebSocket
from fastapi.responses import FileResponse, RedirectResponse
from fastapi.staticfiles import StaticFiles

from ._guard import COOKIE, Guard
from ._hub import Hub
from ._refusals import explain_refusals
from ._routes import api
from ._session import LiveSession

STATIC = Path(__file__).parent / "static"
_RULES = (
    "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "Content-Security-Policy": _RULES,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


def build_app(
    session: LiveSession, token: str, *, max_body: int, rate_hz: float
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
    )
    explain_refusals(app)
    hub = Hub(session)
    app.include_router(api(session))

    @app.middleware("http")
    async def with_headers(request: Request, call_next):  # type: ignore[no-untyped-def]
        response = await call_next(request)
        for name, value in _HEADERS.items():
            response.headers.setdefault(name, value)
        return response

    @app.get("/", include_in_schema=False)
    async def page(request: Request) -> Response:
        if "token" not in request.query_params:
            return FileResponse(STATIC / "index.html")
        moved = RedirectResponse(request.url.path, status_code=303)
        moved.set_cookie(COOKIE, token, httponly=True, samesite="strict", path="/")
        return moved

    @app.websocket("/ws")
    async def websocket(socket: WebSocket) -> None:
        await hub.serve(socket)

    app.mount("/static", StaticFiles(directory=STATIC), name="static")
    app.add_middleware(Guard, token=token, max_body=max_body, rate_hz=rate_hz)
    return app
