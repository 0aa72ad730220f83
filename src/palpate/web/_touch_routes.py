"""The API of stored touches: listed, shown, removed, moved to another object."""

from typing import Annotated

from fastapi import APIRouter, Depends, HTTPException, Query, Response
from pydantic import Field

from ..library import LibraryError
from ._routes import (
    REFUSALS,
    TOKEN,
    Done,
    NamedObject,
    NameQuery,
    Order,
    Session,
    Stored,
    StoredTouches,
    shown_touch,
)

router = APIRouter(prefix="/api", responses=REFUSALS, dependencies=[Depends(TOKEN)])


class SomeTouches(Order):
    """Stored touches."""

    ids: Annotated[
        list[Annotated[str, Field(min_length=1, max_length=80)]],
        Field(min_length=1, max_length=200, description="Their ids."),
    ]


class Moving(SomeTouches, NamedObject):
    """Stored touches, and the object that they are of."""


class StoredTouch(Stored):
    """A touch that is on the disk, with its session and when it was added."""

    session: str
    added_s: float


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
    answer = shown_touch(image, channels, side)
    answer.headers["Cache-Control"] = "private, max-age=86400, immutable"
    return answer
