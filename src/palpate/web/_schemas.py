"""What goes into the API and comes out of it, as OpenAPI describes it."""

from math import hypot
from typing import Annotated, Any, Self

from fastapi import Query
from pydantic import BaseModel, ConfigDict, Field, model_validator

from ._episode import LiveTouch
from ._teaching import LONGEST_NAME, MOST_PER_LESSON

_Number = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Vector = tuple[_Number, _Number, _Number]
Numbers = Annotated[list[float] | None, Query(min_length=3, max_length=3)]
LONGEST_TEXT = 1000
# An object of elsewhere may have a longer name than a new one.
Name = Annotated[
    str, Field(min_length=1, max_length=LONGEST_TEXT, description="Object's name.")
]
# What is wrong with a new name says `teachable_name`, in one sentence.
NewName = Annotated[
    str,
    Field(
        max_length=LONGEST_TEXT, description="Object's name, 1 to 80 printed characters"
    ),
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

    touches: Annotated[
        int, Field(ge=1, le=MOST_PER_LESSON, description="How many.")
    ] = 12
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
        Field(
            description="Then only try touches, until baseline/keep or baseline/undo."
        ),
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
    n_counted: Annotated[
        int, Field(description="How many of the touches show contact.")
    ]
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
    no_contact: Annotated[
        list[str], Field(description="Ids of touches that show no contact.")
    ] = []
    advice: Annotated[list[str], Field(description="What to teach next.")]
    alarm: Annotated[
        str, Field(description="That recent touches look like another sensor's.")
    ] = ""
    learning: bool
    unlearnt: Annotated[
        bool, Field(description="Touches were taught, removed or moved since.")
    ]
    learn_error: str
    message: str
    trouble: Annotated[
        str, Field(description="Why the last touch could not be taken, or empty.")
    ] = ""
    health: dict[str, Any]


class SomeTouches(Order):
    """Stored touches."""

    ids: Annotated[
        list[Annotated[str, Field(min_length=1, max_length=LONGEST_NAME)]],
        Field(min_length=1, max_length=200, description="Their ids."),
    ]


class Moving(SomeTouches, NamedObject):
    """Stored touches, and the object that they are of."""


class StoredTouch(Stored):
    """A touch that is on the disk, with its session and when it was added."""

    session: str
    added_s: float


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
