"""Serving a session: its application, its token, and the socket it listens on."""

import secrets
import socket
from typing import TYPE_CHECKING, Any

from .._extras import needed
from ._session import LiveSession

if TYPE_CHECKING:
    from fastapi import FastAPI

MAX_BODY = 16 * 2**20
RATE_HZ = 200.0
LAST_PORT = 65535


def create_app(
    session: LiveSession,
    token: str,
    *,
    max_body: int = MAX_BODY,
    rate_hz: float = RATE_HZ,
) -> "FastAPI":
    """Return the web application of a session.

    Parameters
    ----------
    session : LiveSession
        Started and stopped with the application.
    token : str
        What everybody must know: as `Authorization: Bearer TOKEN`, as `?token=TOKEN`,
        or as the cookie that the page sets. See `new_token`.
    max_body : int, default=16 MiB
        Largest body of a request, in bytes.
    rate_hz : float, default=200
        Requests per second that one address may keep up.

    Raises
    ------
    ImportError
        FastAPI is missing; the message names the extra.
    """
    require_web()
    from ._app import build_app

    return build_app(session, token, max_body=max_body, rate_hz=rate_hz)


def new_token() -> str:
    """Return a token that nobody guesses: 192 random bits."""
    return secrets.token_urlsafe(24)


def require_web() -> None:
    """Raise `ImportError`, naming the extra, where the web packages are missing."""
    for module in ("fastapi", "uvicorn", "websockets"):
        needed(module, "web", "The page")


def open_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens, or say what is in the way."""
    if not 0 <= port <= LAST_PORT:
        raise ValueError(
            f"--port must be 0 to {LAST_PORT}, got {port}. 0 takes a free one."
        )
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    opened = socket.socket(family, socket.SOCK_STREAM)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        opened.bind((host, port))
        opened.listen(128)
    except OSError as error:
        opened.close()
        raise OSError(
            f"Cannot listen on {host} port {port}: {error.strerror}. "
            "Choose another with --port, or 0 for a free one."
        ) from error
    return opened


def run_app(app: Any, opened: socket.socket) -> None:
    """Run an ASGI application on a socket until the process is told to end."""
    import uvicorn

    config = uvicorn.Config(
        app,
        log_level="warning",
        access_log=False,  # its lines would hold the token
        ws="websockets-sansio",
        ws_max_size=2**16,
        timeout_graceful_shutdown=3,
        server_header=False,
    )
    uvicorn.Server(config).run(sockets=[opened])
