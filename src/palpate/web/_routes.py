"""The API: the same actions for the page and for robots.

Each runs in a thread of its own; what a session refuses becomes a clear answer in
`_app`. Images that come in are read by threads of their own: what is slow to read holds
up others of its kind alone, and no teaching, no websocket and no picture of the page.
"""

import asyncio
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, ParamSpec, TypeVar

from fastapi import APIRouter, Depends, HTTPException, Query, Request, Response
from fastapi.dependencies.models import Dependant
from fastapi.responses import FileResponse, JSONResponse
from fastapi.security import HTTPBearer
from starlette.background import BackgroundTask

from .._types import Array
from ..library import LibraryError
from ..touches import Touches
from ._episode import episode_report
from ._images import KINDS, NO_IMAGE, read_json, read_picture, thumbnail
from ._schemas import (
    LONGEST_TEXT,
    REFUSALS,
    Attempt,
    BaselineOrder,
    Done,
    EpisodeState,
    LessonOrder,
    Moving,
    NamedImage,
    NamedPlace,
    Numbers,
    OneObject,
    Place,
    PlacedImage,
    Placing,
    Renaming,
    SeenFromAbove,
    SomeTouches,
    State,
    Stored,
    StoredTouch,
)
from ._session import LiveSession
from ._teaching import Teacher

_Given = ParamSpec("_Given")
_Read = TypeVar("_Read")


class ReadingRoom:
    """A few threads that read images, each in bounded time, waiting included.

    A thread cannot be stopped: it goes on until what it reads ends, which the limits
    on size and scans bound, and its result is dropped.
    """

    def __init__(self, name: str, n_threads: int, limit_s: float) -> None:
        self._limit_s = limit_s
        self._pool = ThreadPoolExecutor(n_threads, f"palpate-{name}")

    async def read(
        self,
        read: Callable[_Given, _Read],
        *args: _Given.args,
        **how: _Given.kwargs,
    ) -> _Read:
        """Return what `read` returns; answer 503 where that takes too long."""
        reading = asyncio.wrap_future(self._pool.submit(read, *args, **how))
        try:
            return await asyncio.wait_for(reading, self._limit_s)
        except TimeoutError:
            raise HTTPException(
                503,
                f"The image took more than {self._limit_s:g} s to read, or to wait for "
                "others. Send it again, or a smaller one.",
                {"Retry-After": "1"},
            ) from None


def _body(schema: dict[str, Any], *kinds: str) -> dict[str, Any]:
    content = {kind: {"schema": schema} for kind in kinds}
    return {"requestBody": {"required": True, "content": content}}


PICTURES = ReadingRoom("pictures", 4, 10.0)
NUMBERS = ReadingRoom("numbers", 2, 30.0)
_MISS_WITH_IMAGE = (
    "A miss must come without a picture, as JSON to `touch`: nothing was met there. "
    "Leave `image` or `miss` out."
)
_PICTURE = _body({"type": "string", "format": "binary"}, *KINDS)
_ATTEMPTS = [kind.model_json_schema() for kind in (PlacedImage, Attempt)]
_IMAGE = _body({"anyOf": _ATTEMPTS}, "application/json")
_NAMED_IMAGE = _body(NamedImage.model_json_schema(), "application/json")
_EPISODE: Any = {"response_model": EpisodeState, "tags": ["episode"]}
_TOKEN = HTTPBearer(auto_error=False, description="The token that the server printed.")


def _names_in_address(dependant: Dependant) -> set[str]:
    names = {field.alias for field in dependant.query_params}
    return names.union(*map(_names_in_address, dependant.dependencies))


async def _know_all_names(request: Request) -> None:
    """Refuse to change anything where a name in the address would be ignored."""
    allowed = _names_in_address(request.scope["route"].dependant)
    others = sorted({*request.query_params} - allowed)
    if request.method != "GET" and others:
        names = ", ".join(sorted(allowed)) or "no name"
        raise ValueError(f"The address may hold {names} here, got {others[0]!r}.")


router = APIRouter(
    prefix="/api",
    responses=REFUSALS,
    dependencies=[Depends(_TOKEN), Depends(_know_all_names)],
)


async def _session(
    request: Request, sensor: Annotated[int, Query(ge=1, description="Which one.")] = 1
) -> Any:
    sessions = request.app.state.sessions
    if sensor > len(sessions):
        raise HTTPException(
            404, f"sensor must be at most {len(sessions)}, got {sensor}."
        )
    return sessions[sensor - 1]


Session = Annotated[LiveSession, Depends(_session)]


async def _teacher(session: Session) -> Teacher:
    return session._teacher()


async def _picture(
    request: Request,
    session: Session,
    colour: Annotated[bool, Query(description="The first one is in colour.")] = False,
) -> Array:
    kind = request.headers.get("content-type", "")
    in_colour = colour or session.takes_colour()
    return await PICTURES.read(read_picture, await request.body(), kind, in_colour)


async def _place(
    position_mm: Numbers = None,
    direction: Numbers = None,
    force_n: float | None = None,
    miss: bool = False,
) -> Place:
    if miss:
        raise ValueError(_MISS_WITH_IMAGE)
    return Place.model_validate(
        {"position_mm": position_mm, "direction": direction, "force_n": force_n}
    )


async def _posted(request: Request) -> tuple[dict[str, Any], Array | None]:
    return await NUMBERS.read(read_json, await request.body())


Posted = Annotated[tuple[dict[str, Any], Array | None], Depends(_posted)]
PlaceQuery = Annotated[Place, Depends(_place)]
StoredTouches = Annotated[Teacher, Depends(_teacher)]
Picture = Annotated[Array, Depends(_picture)]
NameQuery = Annotated[str, Query(alias="object", min_length=1, max_length=LONGEST_TEXT)]


@router.get("/state", response_model=State, tags=["state"])
def state(session: Session) -> Any:
    """Return everything the page shows but pictures."""
    return JSONResponse(session.to_dict())


@router.get("/health", tags=["state"])
def health(session: Session) -> dict[str, Any]:
    """Return frame rate (Hz), frames dropped, latencies (ms)."""
    return session.health.to_dict()


@router.get("/frame", tags=["sensor"])
def frame(session: Session) -> JSONResponse:
    """Return the newest frame, `{"image": [[0, null]]}`, of at most 4096 taxels."""
    image = session._watched().sensor.read_latest().image
    if image.shape[0] * image.shape[1] > 4096:
        raise HTTPException(409, "Frames of more than 4096 taxels are pictures.")
    values = image.astype(object)
    values[image != image] = None
    return JSONResponse({"image": values.tolist()})


@router.post("/baseline", tags=["sensor"])
def baseline(order: BaselineOrder, session: Session) -> Done:
    """Take the baseline, the frame of touching nothing; refused in contact."""
    session.take_baseline(force=order.force, ask_press=order.ask_press)
    return Done(message="The baseline is taken.")


@router.post("/baseline/keep", tags=["sensor"])
def keep_baseline(session: Session) -> Done:
    """End the trial of a baseline: touches count from now on."""
    session.end_press()
    return Done(message="The baseline is kept.")


@router.post("/baseline/undo", tags=["sensor"])
def undo_baseline(session: Session) -> Done:
    """Go back to the baseline before the last one, none where there was none."""
    session.end_press(undo=True)
    return Done(message="The baseline is undone.")


@router.get("/baseline/press", tags=["sensor"], response_class=Response)
def press(session: Session) -> Response:
    """Return the last test press, as its difference from the baseline, as a PNG."""
    channels = session._watched().sensor.channels
    return _shown_touch(session.press_difference(), channels)


@router.post("/zero", tags=["sensor"], deprecated=True)
def zero(order: BaselineOrder, session: Session) -> Done:
    """Use /api/baseline instead: this name goes with the next release."""
    return baseline(order, session)


@router.post("/place", tags=["sensor"])
def place(order: Placing, session: Session) -> Done:
    """Put something else before a replayed or simulated sensor."""
    session.place(order.object)
    return Done(message=f"{order.object or 'Nothing'} lies there now.")


@router.get("/episode", **_EPISODE)
def episode(session: Session) -> Any:
    """Return the episode: its touches, the belief after each, the decision."""
    return JSONResponse(session.episode.to_dict())


@router.post("/episode/start", **_EPISODE)
def start(session: Session) -> Any:
    """Begin a new episode."""
    session.begin_episode()
    return JSONResponse(session.episode.to_dict())


@router.post("/episode/end", **_EPISODE)
def end(session: Session) -> Any:
    """End the episode; the next touch begins a new one."""
    return JSONResponse(session.end_episode())


@router.post("/touch", **_EPISODE, openapi_extra=_IMAGE)
def touch(posted: Posted, session: Session) -> Any:
    """Take one touch, as numbers, or a miss into the episode; return the belief.

    Of more than some thousand taxels, send `touch/picture`: that is read at once.
    """
    rest, image = posted
    attempt = Attempt.model_validate(rest)
    if attempt.miss and image is not None:
        raise ValueError(_MISS_WITH_IMAGE)
    if not attempt.miss and image is None:
        raise ValueError(f"{NO_IMAGE} Or, of a miss, `miss`: true.")
    return JSONResponse(session.post_touch(image, attempt.columns()))


@router.post("/touch/picture", **_EPISODE, openapi_extra=_PICTURE)
def touch_picture(picture: Picture, place: PlaceQuery, session: Session) -> Any:
    """Take one touch, as PNG, JPEG or npy, into the episode; return the belief."""
    return JSONResponse(session.post_touch(picture, place.columns()))


@router.get("/episode/above", tags=["episode"])
def view_from_above(session: Session) -> SeenFromAbove:
    """Return where touches of the episode met something, and how the object stands.

    Of touches that were posted with their places, with a model that was taught so.
    """
    return SeenFromAbove(**session.view_from_above())


@router.get("/episode/archive", tags=["episode"], response_class=Response)
def archive(session: Session) -> Response:
    """Download the touches of the episode as a touch archive (.npz)."""
    episode = session.episode
    geometry = None if session.watch is None else session.watch.sensor.geometry
    touches = episode.as_touches(session.baseline, geometry)
    return _archive(touches, f"episode-{episode.number}.npz")


@router.get("/episode/report", tags=["episode"], response_class=Response)
def report(session: Session) -> Response:
    """Download a page that shows the episode by itself."""
    name = f"attachment; filename=episode-{session.episode.number}.html"
    headers = {"Content-Disposition": name}
    return Response(episode_report(session.episode), 200, headers, "text/html")


@router.get(
    "/episode/touches/{number}/picture", tags=["episode"], response_class=Response
)
def episode_picture(
    number: int,
    session: Session,
    side: Annotated[int, Query(ge=16, le=640, description="Pixels.")] = 96,
) -> Response:
    """Return one touch of the episode as a PNG."""
    episode = session.episode
    image = None
    if 1 <= number <= len(episode.images):
        image = episode.images[number - 1]
    if image is None:
        raise HTTPException(404, f"The episode has no picture of touch {number}.")
    return _shown_touch(image, episode.channels, side)


@router.post("/teach", tags=["teach"])
def teach(order: LessonOrder, session: Session) -> Done:
    """Store the next touches of the sensor as touches of an object."""
    session.teach(order.object, order.touches, keep_episode=order.keep_episode)
    return Done(message=f"Touch {order.object} {order.touches} times.")


@router.post("/teach/stop", tags=["teach"])
def stop(session: Session) -> Done:
    """End the lesson; what was stored stays."""
    session.stop_teaching()
    return Done(message="The lesson is over.")


@router.post("/teach/undo", tags=["teach"])
def undo(session: Session) -> Done:
    """Take back the last touch taught, removed or moved, also after a restart."""
    session.undo()
    return Done(message=session.message)


@router.post("/teach/resume", tags=["teach"])
def resume(session: Session) -> Done:
    """Go on with the lesson that a restart interrupted."""
    session.resume_teaching()
    return Done(message="The lesson goes on.")


@router.post("/teach/touch", tags=["teach"], openapi_extra=_NAMED_IMAGE)
def teach_touch(posted: Posted, session: Session) -> Stored:
    """Store one touch, as numbers, of an object; answered once on the disk."""
    rest, image = posted
    order = NamedPlace.model_validate(rest)
    if image is None:
        raise ValueError(NO_IMAGE)
    return Stored(id=session.post_lesson(order.object, image, order.columns()))


@router.post("/teach/touch/picture", tags=["teach"], openapi_extra=_PICTURE)
def teach_picture(
    picture: Picture, name: NameQuery, place: PlaceQuery, session: Session
) -> Stored:
    """Store one touch, as PNG, JPEG or npy, of an object."""
    return Stored(id=session.post_lesson(name, picture, place.columns()))


@router.post("/learn", status_code=202, tags=["teach"])
def learn(session: Session) -> Done:
    """Learn what the library holds; `state` tells when it is done."""
    session.learn()
    return Done(message="Learning.")


@router.post("/objects/rename", tags=["objects"])
def rename(order: Renaming, session: Session) -> Done:
    """Give an object of the library another name."""
    session.rename(order.object, order.name, merge=order.merge)
    return Done(message=f"{order.object} is called {order.name} now.")


@router.post("/objects/forget", tags=["objects"])
def forget(order: OneObject, session: Session) -> Done:
    """Leave all touches of an object out and learn without it."""
    session.forget(order.object)
    return Done(message=f"{order.object} is forgotten.")


@router.get("/objects/archive", tags=["objects"], response_class=Response)
def export(name: NameQuery, teacher: StoredTouches) -> Response:
    """Download the touches of an object as a touch archive (.npz)."""
    return _archive(teacher.touches(name), f"{name}.npz")


@router.get("/objects/touches", tags=["objects"])
def stored(
    name: NameQuery,
    teacher: StoredTouches,
    limit: Annotated[int, Query(ge=1, le=200)] = 8,
    offset: Annotated[int, Query(ge=0, description="So many newer ones.")] = 0,
) -> list[StoredTouch]:
    """Return the newest touches of an object, newest first."""
    return [
        StoredTouch(id=row.id, session=str(row.session or ""), added_s=row.added_s)
        for row in teacher.newest(name, limit, offset)
    ]


@router.post("/touches/remove", tags=["objects"])
def remove(order: SomeTouches, session: Session) -> Done:
    """Leave stored touches out; `teach/undo` takes them back in."""
    return Done(message=session.remove_touches(order.ids))


@router.post("/touches/move", tags=["objects"])
def move(order: Moving, session: Session) -> Done:
    """Let stored touches be of another object; `teach/undo` moves them back."""
    return Done(message=session.move_touches(order.ids, order.object))


@router.get("/touches/{key}/picture", tags=["objects"], response_class=Response)
def picture(
    key: str,
    teacher: StoredTouches,
    side: Annotated[int, Query(ge=16, le=640, description="Pixels.")] = 96,
) -> Response:
    """Return a stored touch as a PNG."""
    try:
        image = teacher.library.image(key)
        channels = teacher.channels(key) if image.ndim == 3 else None
    except LibraryError as error:
        raise HTTPException(404, str(error)) from error
    answer = _shown_touch(image, channels, side)
    answer.headers["Cache-Control"] = "private, max-age=86400, immutable"
    return answer


def _shown_touch(
    image: Array, channels: Sequence[str] | None, side: int = 96
) -> Response:
    return Response(thumbnail(image, channels, side), media_type="image/png")


def _archive(touches: Touches, name: str) -> Response:
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="palpate-"))
        path = Path(folder) / "touches.npz"
        touches.save(path)
        sent = BackgroundTask(stack.pop_all().close)
    return FileResponse(
        path, media_type="application/octet-stream", filename=name, background=sent
    )
