"""A sensor on the desk: the live loop, and the page and API that show it.

`LiveSession` is the loop and needs none of the extras; `create_app` wraps it in a
FastAPI application (`pip install palpate[web]`).
"""

import secrets
from typing import TYPE_CHECKING

from ._episode import LiveEpisode, LiveTouch
from ._events import Event
from ._learning import LearningError
from ._origin import remember_library
from ._session import LiveSession

if TYPE_CHECKING:
    from fastapi import FastAPI

MAX_BODY = 16 * 2**20
RATE_HZ = 200.0


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
    try:
        import fastapi
        import uvicorn
        import websockets  # noqa: F401
    except ImportError as error:
        raise ImportError(
            "The page needs fastapi, uvicorn and websockets: pip install palpate[web]."
        ) from error
    del fastapi, uvicorn


__all__ = [
    "MAX_BODY",
    "RATE_HZ",
    "Event",
    "LearningError",
    "LiveEpisode",
    "LiveSession",
    "LiveTouch",
    "create_app",
    "new_token",
    "remember_library",
    "require_web",
]
