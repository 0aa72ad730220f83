"""What goes in and out of the API, as OpenAPI describes it."""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

Name = Annotated[
    str, Field(min_length=1, max_length=80, description="Name of an object.")
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


class NamedImage(Image):
    """One frame of numbers, of an object."""

    object: Name


class LessonOrder(Order):
    """What to teach with the next touches of the sensor."""

    object: Name
    touches: Annotated[int, Field(ge=1, le=1000, description="How many.")] = 12


class Renaming(Order):
    """An object's name and its new one."""

    object: Name
    name: Name


class OneObject(Order):
    """An object."""

    object: Name


class Placing(Order):
    """What lies before a replayed or simulated sensor; null for nothing."""

    object: Name | None


class BaselineOrder(Order):
    """How to take the baseline, the frame of touching nothing."""

    force: Annotated[
        bool, Field(description="Take it although something seems to touch.")
    ] = False


class TouchState(BaseModel):
    """One touch of an episode and the belief after it."""

    number: int
    time_s: float
    posterior: dict[str, float]
    unknown: float | None
    limit: float | None
    latency_ms: float | None


class EpisodeState(BaseModel):
    """An episode: its touches, the belief after each, the decision."""

    number: int
    open: bool
    error: Annotated[float, Field(description="Accepted share of wrong decisions.")]
    decision: Annotated[
        str | None, Field(description='An object, "unknown", or null: undecided.')
    ]
    best: str | None
    reason: str
    touches: list[TouchState]


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


class State(BaseModel):
    """Everything the page shows but pictures."""

    sensor: dict[str, Any] | None
    model: dict[str, Any] | None
    library: dict[str, Any] | None
    lesson: dict[str, Any] | None
    episode: EpisodeState
    nearest: list[NearTouch]
    learning: bool
    learn_error: str
    message: str
    health: dict[str, Any]
