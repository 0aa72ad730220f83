"""The API: the same actions for the page and for robots.

First what goes in and out, as OpenAPI describes it, then the actions. Each runs in a
thread of its own; what a session refuses becomes a clear answer in `_app`.
"""

import json
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from math import hypot
from pathlib import Path
from typing import Annotated, Any, Self

from fastapi import APIRouter, Depends, HTTPException, Query, Request, Response
from fastapi.responses import FileResponse, JSONResponse
from fastapi.security import HTTPBearer
from pydantic import BaseModel, ConfigDict, Field, model_validator
from starlette.background import BackgroundTask

from .._types import Array
from ..touches import Touches
from ._episode import LiveTouch, episode_report
from ._images import KINDS, is_miss, read_json, read_picture, thumbnail
from ._reading import NUMBERS, PICTURES
from ._session import LiveSession
from ._teaching import Teacher

_Number = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Vector = tuple[_Number, _Number, _Number]
Numbers = Annotated[list[float] | None, Query(min_length=3, max_length=3)]
Name = Annotated[str, Field(min_length=1, max_length=80, description="Object's name.")]
# What is wrong with a new name says `checked_name`, in one sentence.
NewName = Annotated[
    str, Field(max_length=1000, description="Object's name, 1 to 80 printed characters")
]


class Answer(BaseModel):
    """What was refused, and why."""

    detail: str


class Order(BaseModel):
    """The body of a request; a field that is not known is refused."""

    model_config = ConfigDict(extra="forbid")


class Image(Order):
    """One frame of numbers."""

    image: Annotated[
        list[list[float | None]],
        Field(
            min_length=1,
            max_length=4096,
            description="Taxels, rows of equal length, in the sensor's unit; null for "
            "a dead taxel.",
        ),
    ]


class Place(Order):
    """Where a touch was made, from where the middle of the object is assumed."""

    position_mm: Annotated[
        Vector | None, Field(description="Tip of the sensor (x, y, z), z up, in mm.")
    ] = None
    direction: Annotated[
        Vector | None, Field(description="Unit vector of the approach (x, y, z).")
    ] = None
    force_n: Annotated[
        float | None,
        Field(gt=0, le=1e3, allow_inf_nan=False, description="Of the press, in N."),
    ] = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.position_mm is None) != (self.direction is None):
            raise ValueError("position_mm and direction go together, got one of them.")
        if self.direction is not None and abs(hypot(*self.direction) - 1) > 0.01:
            raise ValueError(
                f"direction must have length 1, got {hypot(*self.direction):.3g}. "
                "Divide it by its length."
            )
        return self

    def columns(self) -> dict[str, Any]:
        """Return what is known of it, as columns of a touch."""
        return self.model_dump(include={*Place.model_fields}, exclude_none=True)


class Attempt(Place):
    """Where a touch was made, if known, or where nothing was met."""

    miss: Annotated[
        bool,
        Field(description="The tip went there, that way, and met nothing: no image."),
    ] = False

    @model_validator(mode="after")
    def _check_miss(self) -> Self:
        if self.miss and (self.position_mm is None or self.force_n is not None):
            raise ValueError(
                "A miss must have position_mm and direction and no force_n: where the "
                "tip ended, and the way that it went without meeting anything."
            )
        return self


class PlacedImage(Place, Image):
    """One frame of numbers, and where it was taken, if known."""


class OneObject(Order):
    """An object."""

    object: Name


class NamedObject(Order):
    """An object, which may be a new one."""

    object: NewName


class LessonOrder(NamedObject):
    """What to teach with the next touches of the sensor."""

    touches: Annotated[int, Field(ge=1, le=1000, description="How many.")] = 12
    keep_episode: Annotated[
        bool, Field(description="The touches of the episode become its first.")
    ] = False


class Renaming(OneObject):
    """An object's name and its new one."""

    name: NewName
    merge: Annotated[bool, Field(description="Join the object of that name.")] = False


class NamedPlace(NamedObject, Place):
    """An object, and where it was touched, if known."""


class NamedImage(NamedPlace, Image):
    """One frame of numbers, of an object."""


class Placing(Order):
    """What lies before a replayed or simulated sensor; null for nothing."""

    object: Name | None


class BaselineOrder(Order):
    """How to take the baseline, the frame of touching nothing."""

    force: Annotated[
        bool, Field(description="Take it although something seems to touch.")
    ] = False
    ask_press: Annotated[
        bool,
        Field(description="Then only try touches, until press/keep or press/undo."),
    ] = False


class EpisodeState(BaseModel):
    """An episode: its touches, the belief after each, the decision."""

    number: int
    open: bool
    error: Annotated[float, Field(description="Accepted share of wrong names.")]
    refusal: Annotated[
        float, Field(description="Unknown is said at a probability of 1 less this.")
    ]
    strangers: Annotated[
        float, Field(description="Expected share of episodes with something unlearnt.")
    ]
    decision: Annotated[
        str | None, Field(description='An object, "unknown", or null: undecided.')
    ]
    category: Annotated[
        str | None, Field(description="The category, where only that is sure.")
    ]
    in_doubt: Annotated[
        bool, Field(description="Something else is more probable than what is decided.")
    ]
    best: str | None
    sentence: Annotated[str, Field(description="What is decided, or what it may be.")]
    reason: Annotated[str, Field(description="As `sentence`.")]
    limits: Annotated[
        str,
        Field(description="What a name is worth where little was learnt, or empty."),
    ]
    withdrawn: Annotated[
        list[str], Field(description="A sentence for each decision withdrawn.")
    ]
    why: Annotated[list[str], Field(description="The figures behind the sentence.")]
    touches: list[LiveTouch]


class Stored(BaseModel):
    """A touch that is on the disk."""

    id: str


class Done(BaseModel):
    """What was done, for people."""

    message: str


class NearTouch(BaseModel):
    """A stored touch and how far it is from the current one."""

    id: str | None
    object: str
    distance: float


class SeenTouch(BaseModel):
    """Where a touch of the episode was made, from above."""

    number: int
    x_mm: float
    y_mm: float


class SurfacePoint(BaseModel):
    """Where the surface is expected, with an ellipse of one standard deviation."""

    x_mm: float
    y_mm: float
    long_mm: Annotated[float, Field(description="Half of the longer axis.")]
    short_mm: float
    turn_deg: Annotated[float, Field(description="Of the longer axis, from x.")]


class SeenFromAbove(BaseModel):
    """What the places of touches tell; empty where none has one."""

    sentence: Annotated[str, Field(description="How it stands, or why it is open.")] = (
        ""
    )
    pose: Annotated[
        dict[str, Any] | None,
        Field(description="Object, face, turn and offset, with their deviations."),
    ] = None
    touches: list[SeenTouch] = []
    misses: Annotated[
        list[SeenTouch], Field(description="Where the tip ended without a contact.")
    ] = []
    surface: list[SurfacePoint] = []


class State(BaseModel):
    """Everything the page shows but pictures."""

    sensor: dict[str, Any] | None
    model: dict[str, Any] | None
    library: dict[str, Any] | None
    lesson: dict[str, Any] | None
    episode: EpisodeState
    nearest: list[NearTouch]
    quality: Annotated[
        list[dict[str, Any]],
        Field(description="Of each learnt object, how left-out touches are recognised"),
    ]
    advice: Annotated[list[str], Field(description="What to teach next.")]
    learning: bool
    unlearnt: Annotated[
        bool, Field(description="Touches were taught, removed or moved since.")
    ]
    learn_error: str
    message: str
    health: dict[str, Any]


REFUSALS: dict[int | str, dict[str, Any]] = {
    400: {"model": Answer, "description": "A body that cannot be read."},
    401: {"model": Answer, "description": "No token."},
    403: {"model": Answer, "description": "Wrong token, name of server, or origin."},
    404: {"model": Answer, "description": "There is no such thing."},
    408: {"model": Answer, "description": "The body stopped coming."},
    409: {"model": Answer, "description": "Not now, or not with this server."},
    413: {"model": Answer, "description": "Too large."},
    422: {"description": "Not what was asked for."},
    429: {"model": Answer, "description": "Too many requests."},
    503: {"model": Answer, "description": "The image took too long to read."},
    507: {"model": Answer, "description": "The disk has no room."},
}


def _body(schema: dict[str, Any], *kinds: str) -> dict[str, Any]:
    content = {kind: {"schema": schema} for kind in kinds}
    return {"requestBody": {"required": True, "content": content}}


_MISS_WITH_IMAGE = (
    "A miss must come without a picture, as JSON to `touch`: nothing was met there. "
    "Leave `image` or `miss` out."
)
_PICTURE = _body({"type": "string", "format": "binary"}, *KINDS)
_ATTEMPTS = [kind.model_json_schema() for kind in (PlacedImage, Attempt)]
_IMAGE = _body({"anyOf": _ATTEMPTS}, "application/json")
_NAMED_IMAGE = _body(NamedImage.model_json_schema(), "application/json")
_EPISODE: Any = {"response_model": EpisodeState, "tags": ["episode"]}
TOKEN = HTTPBearer(auto_error=False, description="The token that the server printed.")
router = APIRouter(prefix="/api", responses=REFUSALS, dependencies=[Depends(TOKEN)])


async def _session(
    request: Request, sensor: Annotated[int, Query(ge=1, description="Which one.")] = 1
) -> Any:
    sessions = request.app.state.sessions
    if sensor > len(sessions):
        raise HTTPException(404, f"There are {len(sessions)} sensors, got {sensor}.")
    return sessions[sensor - 1]


Session = Annotated[LiveSession, Depends(_session)]


async def _teacher(session: Session) -> Teacher:
    if session.teacher is None:
        raise HTTPException(
            409, "There is no library here; start with `library=FOLDER`."
        )
    return session.teacher


async def _picture(request: Request, session: Session) -> Array:
    kind = request.headers.get("content-type", "")
    colour = request.query_params.get("colour") == "1" or session.takes_colour()
    return await PICTURES.read(read_picture, await request.body(), kind, colour)


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


async def _posted(request: Request) -> tuple[dict[str, Any], Array]:
    return await NUMBERS.read(read_json, await request.body())


async def _attempted(request: Request) -> tuple[dict[str, Any], Array | None]:
    body = await request.body()
    if is_miss(body):
        return json.loads(body), None
    return await NUMBERS.read(read_json, body)


Posted = Annotated[tuple[dict[str, Any], Array], Depends(_posted)]
Attempted = Annotated[tuple[dict[str, Any], Array | None], Depends(_attempted)]
PlaceQuery = Annotated[Place, Depends(_place)]
StoredTouches = Annotated[Teacher, Depends(_teacher)]
Picture = Annotated[Array, Depends(_picture)]
NameQuery = Annotated[str, Query(alias="object", min_length=1, max_length=80)]


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
    if session.watch is None:
        raise HTTPException(409, "There is no sensor here.")
    image = session.watch.sensor.read_latest().image
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
    channels = None if session.watch is None else session.watch.sensor.channels
    return shown_touch(session.press_difference(), channels)


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
def touch(attempted: Attempted, session: Session) -> Any:
    """Take one touch, as numbers, or a miss into the episode; return the belief.

    Of more than some thousand taxels, send `touch/picture`: that is read at once.
    """
    rest, image = attempted
    attempt = Attempt.model_validate(rest)
    if attempt.miss and image is not None:
        raise ValueError(_MISS_WITH_IMAGE)
    if not attempt.miss and image is None:
        raise ValueError("A touch must have an image, unless it is a miss; got none.")
    place = attempt.columns()
    return JSONResponse(session.post_touch(image, place))


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
    return _archive(episode.as_touches(), f"episode-{episode.number}.npz")


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
    return shown_touch(image, episode.channels, side)


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


def shown_touch(
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
