"""Teaching: touches of a named object, each on the disk before it is acknowledged."""

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..library import LibraryError, SensorDescription, TouchLibrary
from ..sensors import LiveSensor
from ..touches import Touches

LONGEST_NAME = 80


@dataclass(eq=False)
class Lesson:
    """One object being taught.

    Attributes
    ----------
    name : str
        What the object is called.
    wanted : int
        Touches to take.
    ids : list of str
        Those stored so far, in their order.
    """

    name: str
    wanted: int
    ids: list[str] = field(default_factory=list)

    def told(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {"name": self.name, "wanted": self.wanted, "done": len(self.ids)}


class Teacher:
    """Stores what is taught in a library.

    Parameters
    ----------
    folder : path
        The library; made where there is none.
    sensor : LiveSensor or None
        What the touches come from.
    """

    def __init__(self, folder: str | Path, sensor: LiveSensor | None) -> None:
        self.library = TouchLibrary.open(folder, create=True)
        self._sensor = sensor
        self._session = time.strftime("%Y-%m-%d %H:%M:%S")
        self._lessons = 0
        self.lesson: Lesson | None = None

    @property
    def folder(self) -> Path:
        """Where the library is."""
        return self.library.folder

    def begin(self, name: str, wanted: int) -> Lesson:
        """Start to teach an object; a lesson under way ends.

        Raises
        ------
        ValueError
            The name cannot be one.
        """
        self._lessons += 1
        self.lesson = Lesson(checked_name(name), wanted)
        return self.lesson

    def end(self) -> None:
        """End the lesson; what was stored stays."""
        self.lesson = None

    def store(self, name: str, image: NDArray[Any], zero: NDArray[Any] | None) -> str:
        """Store one touch of an object; return its id once it is on the disk."""
        touch = Touches(
            image[np.newaxis],
            object=[checked_name(name)],
            time_s=[time.time()],
            no_contact=zero,
            geometry=None if self._sensor is None else self._sensor.geometry,
        )
        (key,) = self.library.add(
            touches=touch,
            session=self._session,
            episode=f"lesson {self._lessons}",
            sensor=_described(self._sensor),
            progress=False,
        )
        return key

    def take(self, image: NDArray[Any], zero: NDArray[Any] | None) -> Lesson:
        """Store one touch of the lesson; return the lesson, over when it is full."""
        assert self.lesson is not None
        lesson = self.lesson
        lesson.ids.append(self.store(lesson.name, image, zero))
        if len(lesson.ids) >= lesson.wanted:
            self.lesson = None
        return lesson

    def undo(self) -> str:
        """Leave the newest touch of the library out; return its object.

        Raises
        ------
        LibraryError
            There is none.
        """
        rows = self._newest(1)
        if not rows:
            raise LibraryError("There is no touch to undo; nothing has been taught.")
        self.library.retract([rows[0].id], reason="undone on the page")
        if self.lesson is not None and rows[0].id in self.lesson.ids:
            self.lesson.ids.remove(rows[0].id)
        return str(rows[0].object)

    def told(self) -> dict[str, Any]:
        """Return what the library holds, as plain values."""
        return {
            "folder": str(self.folder.resolve()),
            "objects": [
                {"name": row.name, "n_touches": row.n_touches}
                for row in self.library.objects()
            ],
        }

    def ids(self, name: str, limit: int) -> list[str]:
        """Return the ids of the newest touches of an object, newest first."""
        rows = [r for r in self.library.list(limit=None) if r.object == name]
        return [row.id for row in rows[::-1][:limit]]

    def touches(self, name: str) -> Touches:
        """Return all touches of an object.

        Raises
        ------
        LibraryError
            It has none.
        """
        rows = self.library.list("object is not null", limit=None)
        wanted = [n for n, row in enumerate(rows) if row.object == name]
        if not wanted:
            raise LibraryError(f"There is no object {name!r} in the library.")
        return self.library.touches("object is not null")[wanted]

    def newest_type(self) -> tuple[tuple[int, int], np.dtype[Any]] | None:
        """Return size and type of the newest touch's image, or None."""
        rows = self._newest(1)
        if not rows:
            return None
        return (rows[0].n_rows, rows[0].n_cols), np.dtype(rows[0].dtype)

    def _newest(self, count: int) -> list[Any]:
        n_touches = self.library.count()
        return self.library.list(limit=count, offset=max(0, n_touches - count))


def checked_name(name: str) -> str:
    """Return the name of an object without blanks at its ends, or explain."""
    tidy = " ".join(name.split())
    if not tidy or len(tidy) > LONGEST_NAME or not tidy.isprintable():
        raise ValueError(
            f"The name of an object must be 1 to {LONGEST_NAME} printable characters, "
            f"got {name[:LONGEST_NAME]!r}."
        )
    if tidy == "unknown":
        raise ValueError(
            "The name of an object must not be 'unknown', which is what palpate says "
            "of objects it has not learnt."
        )
    return tidy


def _described(sensor: LiveSensor | None) -> SensorDescription:
    if sensor is None:
        return SensorDescription("posted")
    return SensorDescription(sensor.name, unit=sensor.unit, geometry=sensor.geometry)
