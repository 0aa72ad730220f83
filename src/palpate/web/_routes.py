"""The API: the same actions for the page and for robots."""

import asyncio
import io
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote

import numpy as np
from fastapi import APIRouter, HTTPException, Query, Request, Response
from numpy.typing import NDArray

from ..library import LibraryError
from ..sensors import ContactError, SensorError
from ..touches import Touches, TouchesError
from . import _models as m
from ._learning import LearningError
from ._pictures import read_picture, thumbnail
from ._refusals import lacks_room
from ._report import episode_report
from ._session import LiveSession

MAX_PIXELS = 4_000_000
_REFUSALS: dict[int | str, dict[str, Any]] = {
    400: {"model": m.Answer, "description": "A body that cannot be read."},
    401: {"model": m.Answer, "description": "No token."},
    403: {"model": m.Answer, "description": "Wrong token."},
    404: {"model": m.Answer, "description": "There is no such thing."},
    409: {"model": m.Answer, "description": "Not now, or not with this server."},
    413: {"model": m.Answer, "description": "Too large."},
    422: {"description": "Not what was asked for."},
    429: {"model": m.Answer, "description": "Too many requests."},
    507: {"model": m.Answer, "description": "The disk has no room."},
}
_PICTURE = {
    "requestBody": {
        "required": True,
        "content": {
            kind: {"schema": {"type": "string", "format": "binary"}}
            for kind in ("image/png", "image/jpeg")
        },
    }
}
Name = Annotated[str, Query(alias="object", min_length=1, max_length=80)]


def api(session: LiveSession) -> APIRouter:
    """Return the API of a session."""
    router = APIRouter(prefix="/api", responses=_REFUSALS)
    _add_state(router, session)
    _add_episode(router, session)
    _add_downloads(router, session)
    _add_teaching(router, session)
    _add_library(router, session)
    return router


def _add_state(router: APIRouter, session: LiveSession) -> None:
    @router.get("/state", response_model=m.State, tags=["state"])
    async def state() -> Any:
        """Return everything the page shows but pictures."""
        return await _done(session.state)

    @router.get("/health", tags=["state"])
    async def health() -> dict[str, Any]:
        """Return frame rate (Hz), frames dropped, latencies (ms)."""
        return session.health_state()

    @router.post("/zero", response_model=m.Done, tags=["sensor"])
    async def zero(order: m.ZeroOrder) -> Any:
        """Take the frame of no contact; refused while something touches."""
        await _done(lambda: session.take_zero(force=order.force))
        return {"message": "The zero is taken."}

    @router.post("/place", response_model=m.Done, tags=["sensor"])
    async def place(order: m.Placing) -> Any:
        """Put something else before a replayed or simulated sensor."""
        await _done(lambda: session.place(order.object))
        return {"message": f"{order.object or 'Nothing'} lies there now."}


def _add_episode(router: APIRouter, session: LiveSession) -> None:
    @router.get("/episode", response_model=m.EpisodeState, tags=["episode"])
    async def episode() -> Any:
        """Return the episode: its touches, the belief after each, the decision."""
        return session.episode.told()

    @router.post("/episode/start", response_model=m.EpisodeState, tags=["episode"])
    async def start() -> Any:
        """Begin a new episode."""
        await _done(session.begin_episode)
        return session.episode.told()

    @router.post("/episode/end", response_model=m.EpisodeState, tags=["episode"])
    async def end() -> Any:
        """End the episode; the next touch begins a new one."""
        return await _done(session.end_episode)

    @router.post("/touch", response_model=m.EpisodeState, tags=["episode"])
    async def touch(image: m.Image) -> Any:
        """Take one touch, as numbers, into the episode; return the belief."""
        levels = _levels(image)
        return await _done(lambda: session.post_touch(levels))

    @router.post(
        "/touch/picture",
        response_model=m.EpisodeState,
        tags=["episode"],
        openapi_extra=_PICTURE,
    )
    async def touch_picture(request: Request) -> Any:
        """Take one touch, as PNG or JPEG, into the episode; return the belief."""
        levels = await _picture(request)
        return await _done(lambda: session.post_touch(levels))


def _add_downloads(router: APIRouter, session: LiveSession) -> None:
    @router.get("/episode/archive", tags=["episode"], response_class=Response)
    async def archive() -> Response:
        """Download the touches of the episode as a touch archive (.npz)."""
        touches = await _done(session.episode.as_touches)
        name = f"episode-{session.episode.number}.npz"
        return await _done(lambda: _npz(touches, name))

    @router.get("/episode/report", tags=["episode"], response_class=Response)
    async def report() -> Response:
        """Download a page that shows the episode by itself."""
        page = await _done(lambda: episode_report(session.episode))
        return _download(
            page.encode(), "text/html", f"episode-{session.episode.number}.html"
        )

    @router.get(
        "/episode/touches/{number}/picture", tags=["episode"], response_class=Response
    )
    async def episode_picture(number: int) -> Response:
        """Return one touch of the episode as a small PNG."""
        touches = session.episode.touches
        if not 1 <= number <= len(touches):
            raise HTTPException(404, f"The episode has no touch {number}.")
        return await _shown(touches[number - 1].image)


def _add_teaching(router: APIRouter, session: LiveSession) -> None:
    @router.post("/teach", response_model=m.Done, tags=["teach"])
    async def teach(order: m.LessonOrder) -> Any:
        """Store the next touches of the sensor as touches of an object."""
        await _done(lambda: session.teach(order.object, order.touches))
        return {"message": f"Touch {order.object} {order.touches} times."}

    @router.post("/teach/stop", response_model=m.Done, tags=["teach"])
    async def stop() -> Any:
        """End the lesson; what was stored stays."""
        await _done(session.stop_teaching)
        return {"message": "The lesson is over."}

    @router.post("/teach/undo", response_model=m.Done, tags=["teach"])
    async def undo() -> Any:
        """Leave out the touch stored last."""
        name = await _done(session.undo)
        return {"message": f"The last touch of {name} is undone."}

    @router.post("/teach/touch", response_model=m.Stored, tags=["teach"])
    async def teach_touch(image: m.NamedImage) -> Any:
        """Store one touch, as numbers, of an object; answered once on the disk."""
        levels = _levels(image)
        return {"id": await _done(lambda: session.post_lesson(image.object, levels))}

    @router.post(
        "/teach/touch/picture",
        response_model=m.Stored,
        tags=["teach"],
        openapi_extra=_PICTURE,
    )
    async def teach_picture(request: Request, name: Name) -> Any:
        """Store one touch, as PNG or JPEG, of an object."""
        levels = await _picture(request)
        return {"id": await _done(lambda: session.post_lesson(name, levels))}

    @router.post("/learn", response_model=m.Done, status_code=202, tags=["teach"])
    async def learn() -> Any:
        """Learn what the library holds; `state` tells when it is done."""
        await _done(session.learn)
        return {"message": "Learning."}


def _add_library(router: APIRouter, session: LiveSession) -> None:
    @router.post("/objects/rename", response_model=m.Done, tags=["objects"])
    async def rename(order: m.Renaming) -> Any:
        """Give an object of the library another name."""
        await _done(lambda: session.rename(order.object, order.name))
        return {"message": f"{order.object} is called {order.name} now."}

    @router.post("/objects/forget", response_model=m.Done, tags=["objects"])
    async def forget(order: m.OneObject) -> Any:
        """Leave all touches of an object out and learn without it."""
        await _done(lambda: session.forget(order.object))
        return {"message": f"{order.object} is forgotten."}

    @router.get("/objects/archive", tags=["objects"], response_class=Response)
    async def export(name: Name) -> Response:
        """Download the touches of an object as a touch archive (.npz)."""
        teacher = _teacher(session)
        touches = await _done(lambda: teacher.touches(name))
        return await _done(lambda: _npz(touches, f"{name}.npz"))

    @router.get("/objects/touches", response_model=list[m.Stored], tags=["objects"])
    async def stored(name: Name, limit: Annotated[int, Query(ge=1, le=200)] = 8) -> Any:
        """Return the newest touches of an object, newest first."""
        teacher = _teacher(session)
        return [{"id": key} for key in await _done(lambda: teacher.ids(name, limit))]

    @router.get("/touches/{key}/picture", tags=["objects"], response_class=Response)
    async def picture(key: str) -> Response:
        """Return a stored touch as a small PNG."""
        teacher = _teacher(session)
        try:
            image = await asyncio.to_thread(teacher.library.image, key)
        except LibraryError as error:
            raise HTTPException(404, str(error)) from error
        shown = await _shown(image)
        shown.headers["Cache-Control"] = "private, max-age=86400, immutable"
        return shown


async def _done(work: Callable[[], Any]) -> Any:
    """Do something in a thread; what goes wrong becomes a clear 4xx."""
    try:
        return await asyncio.to_thread(work)
    except (ContactError, SensorError, LearningError) as error:
        raise HTTPException(409, str(error)) from error
    except (ValueError, TypeError) as error:  # TouchesError and LibraryError too
        raise HTTPException(507 if lacks_room(error) else 422, str(error)) from error
    except OSError as error:
        told = f"The disk cannot be written to: {error.strerror or error}. Free space."
        raise HTTPException(507, told) from error


def _teacher(session: LiveSession) -> Any:
    if session.teacher is None:
        raise HTTPException(409, "There is no library here; start with --library.")
    return session.teacher


def _levels(image: m.Image) -> NDArray[np.float32]:
    rows = [[np.nan if v is None else v for v in row] for row in image.image]
    if len({len(row) for row in rows}) != 1 or not rows[0]:
        raise HTTPException(422, "The image must have rows of one length, at least 1.")
    with np.errstate(over="ignore"):
        levels = np.array(rows, dtype=np.float32)
    if np.isinf(levels).any():
        raise HTTPException(422, "The image must be finite (null for a dead taxel).")
    return levels


async def _picture(request: Request) -> NDArray[Any]:
    data = await request.body()
    kind = request.headers.get("content-type", "")
    try:
        return await asyncio.to_thread(read_picture, data, kind, MAX_PIXELS)
    except TouchesError as error:
        raise HTTPException(422, str(error)) from error


async def _shown(image: NDArray[Any]) -> Response:
    content = await asyncio.to_thread(thumbnail, image)
    return Response(content, media_type="image/png")


def _npz(touches: Touches, name: str) -> Response:
    with tempfile.TemporaryDirectory(prefix="palpate-") as folder:
        path = Path(folder) / "touches.npz"
        touches.save(path)
        content = io.BytesIO(path.read_bytes()).getvalue()
    return _download(content, "application/octet-stream", name)


def _download(content: bytes, kind: str, name: str) -> Response:
    held = f"attachment; filename*=UTF-8''{quote(name, safe='')}"
    return Response(content, media_type=kind, headers={"Content-Disposition": held})
