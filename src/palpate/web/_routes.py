"""The API: the same actions for the page and for robots.

Each function runs in a thread of its own; what a session refuses becomes a clear
answer in `_app`.
"""

import asyncio
import tempfile
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote

from fastapi import APIRouter, Depends, HTTPException, Query, Request, Response

from .._types import Array
from ..library import LibraryError
from ..touches import Touches
from . import _schemas as m
from ._episode import episode_report
from ._images import read_numbers, read_picture, thumbnail
from ._session import LiveSession
from ._teaching import Teacher

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
router = APIRouter(prefix="/api", responses=_REFUSALS)


async def _session(request: Request) -> LiveSession:
    session: LiveSession = request.app.state.session
    return session


Session = Annotated[LiveSession, Depends(_session)]


async def _teacher(session: Session) -> Teacher:
    if session.teacher is None:
        raise HTTPException(409, "There is no library here; start with --library.")
    return session.teacher


async def _picture(request: Request) -> Array:
    kind = request.headers.get("content-type", "")
    return await asyncio.to_thread(read_picture, await request.body(), kind)


StoredTouches = Annotated[Teacher, Depends(_teacher)]
Picture = Annotated[Array, Depends(_picture)]
Name = Annotated[str, Query(alias="object", min_length=1, max_length=80)]


@router.get("/state", response_model=m.State, tags=["state"])
def state(session: Session) -> Any:
    """Return everything the page shows but pictures."""
    return session.to_dict()


@router.get("/health", tags=["state"])
def health(session: Session) -> dict[str, Any]:
    """Return frame rate (Hz), frames dropped, latencies (ms)."""
    return session.health.to_dict()


@router.post("/baseline", response_model=m.Done, tags=["sensor"])
def baseline(order: m.BaselineOrder, session: Session) -> Any:
    """Take the baseline, the frame of touching nothing; refused in contact."""
    session.take_baseline(force=order.force)
    return {"message": "The baseline is taken."}


@router.post("/zero", response_model=m.Done, tags=["sensor"], deprecated=True)
def zero(order: m.BaselineOrder, session: Session) -> Any:
    """Use /api/baseline instead: this name goes with the next release."""
    return baseline(order, session)


@router.post("/place", response_model=m.Done, tags=["sensor"])
def place(order: m.Placing, session: Session) -> Any:
    """Put something else before a replayed or simulated sensor."""
    session.place(order.object)
    return {"message": f"{order.object or 'Nothing'} lies there now."}


@router.get("/episode", response_model=m.EpisodeState, tags=["episode"])
def episode(session: Session) -> Any:
    """Return the episode: its touches, the belief after each, the decision."""
    return session.episode.to_dict()


@router.post("/episode/start", response_model=m.EpisodeState, tags=["episode"])
def start(session: Session) -> Any:
    """Begin a new episode."""
    session.begin_episode()
    return session.episode.to_dict()


@router.post("/episode/end", response_model=m.EpisodeState, tags=["episode"])
def end(session: Session) -> Any:
    """End the episode; the next touch begins a new one."""
    return session.end_episode()


@router.post("/touch", response_model=m.EpisodeState, tags=["episode"])
def touch(image: m.Image, session: Session) -> Any:
    """Take one touch, as numbers, into the episode; return the belief."""
    return session.post_touch(read_numbers(image.image))


@router.post(
    "/touch/picture",
    response_model=m.EpisodeState,
    tags=["episode"],
    openapi_extra=_PICTURE,
)
def touch_picture(picture: Picture, session: Session) -> Any:
    """Take one touch, as PNG or JPEG, into the episode; return the belief."""
    return session.post_touch(picture)


@router.get("/episode/archive", tags=["episode"], response_class=Response)
def archive(session: Session) -> Response:
    """Download the touches of the episode as a touch archive (.npz)."""
    episode = session.episode
    return _archive(episode.as_touches(), f"episode-{episode.number}.npz")


@router.get("/episode/report", tags=["episode"], response_class=Response)
def report(session: Session) -> Response:
    """Download a page that shows the episode by itself."""
    page = episode_report(session.episode).encode()
    return _download(page, "text/html", f"episode-{session.episode.number}.html")


@router.get(
    "/episode/touches/{number}/picture", tags=["episode"], response_class=Response
)
def episode_picture(number: int, session: Session) -> Response:
    """Return one touch of the episode as a small PNG."""
    touches = session.episode.touches
    if not 1 <= number <= len(touches):
        raise HTTPException(404, f"The episode has no touch {number}.")
    return _shown(touches[number - 1].image)


@router.post("/teach", response_model=m.Done, tags=["teach"])
def teach(order: m.LessonOrder, session: Session) -> Any:
    """Store the next touches of the sensor as touches of an object."""
    session.teach(order.object, order.touches)
    return {"message": f"Touch {order.object} {order.touches} times."}


@router.post("/teach/stop", response_model=m.Done, tags=["teach"])
def stop(session: Session) -> Any:
    """End the lesson; what was stored stays."""
    session.stop_teaching()
    return {"message": "The lesson is over."}


@router.post("/teach/undo", response_model=m.Done, tags=["teach"])
def undo(session: Session) -> Any:
    """Leave out the touch stored last."""
    return {"message": f"The last touch of {session.undo()} is undone."}


@router.post("/teach/touch", response_model=m.Stored, tags=["teach"])
def teach_touch(image: m.NamedImage, session: Session) -> Any:
    """Store one touch, as numbers, of an object; answered once on the disk."""
    return {"id": session.post_lesson(image.object, read_numbers(image.image))}


@router.post(
    "/teach/touch/picture",
    response_model=m.Stored,
    tags=["teach"],
    openapi_extra=_PICTURE,
)
def teach_picture(picture: Picture, name: Name, session: Session) -> Any:
    """Store one touch, as PNG or JPEG, of an object."""
    return {"id": session.post_lesson(name, picture)}


@router.post("/learn", response_model=m.Done, status_code=202, tags=["teach"])
def learn(session: Session) -> Any:
    """Learn what the library holds; `state` tells when it is done."""
    session.learn()
    return {"message": "Learning."}


@router.post("/objects/rename", response_model=m.Done, tags=["objects"])
def rename(order: m.Renaming, session: Session) -> Any:
    """Give an object of the library another name."""
    session.rename(order.object, order.name)
    return {"message": f"{order.object} is called {order.name} now."}


@router.post("/objects/forget", response_model=m.Done, tags=["objects"])
def forget(order: m.OneObject, session: Session) -> Any:
    """Leave all touches of an object out and learn without it."""
    session.forget(order.object)
    return {"message": f"{order.object} is forgotten."}


@router.get("/objects/archive", tags=["objects"], response_class=Response)
def export(name: Name, teacher: StoredTouches) -> Response:
    """Download the touches of an object as a touch archive (.npz)."""
    return _archive(teacher.touches(name), f"{name}.npz")


@router.get("/objects/touches", response_model=list[m.Stored], tags=["objects"])
def stored(
    name: Name,
    teacher: StoredTouches,
    limit: Annotated[int, Query(ge=1, le=200)] = 8,
) -> Any:
    """Return the newest touches of an object, newest first."""
    return [{"id": key} for key in teacher.ids(name, limit)]


@router.get("/touches/{key}/picture", tags=["objects"], response_class=Response)
def picture(key: str, teacher: StoredTouches) -> Response:
    """Return a stored touch as a small PNG."""
    try:
        image = teacher.library.image(key)
    except LibraryError as error:
        raise HTTPException(404, str(error)) from error
    shown = _shown(image)
    shown.headers["Cache-Control"] = "private, max-age=86400, immutable"
    return shown


def _shown(image: Array) -> Response:
    return Response(thumbnail(image), media_type="image/png")


def _archive(touches: Touches, name: str) -> Response:
    with tempfile.TemporaryDirectory(prefix="palpate-") as folder:
        path = Path(folder) / "touches.npz"
        touches.save(path)
        content = path.read_bytes()
    return _download(content, "application/octet-stream", name)


def _download(content: bytes, kind: str, name: str) -> Response:
    held = f"attachment; filename*=UTF-8''{quote(name, safe='')}"
    return Response(content, media_type=kind, headers={"Content-Disposition": held})
