"""Teaching: touches of a named object, each on the disk before it is acknowledged."""

import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .._checks import check_count
from .._types import Array
from ..library import LibraryError, SensorDescription, TouchLibrary, TouchRow, quoted
from ..sensors import LiveSensor, SensorError, channels_of
from ..touches import Touches
from ._learning import LEAST_TOUCHES, of_size

LONGEST_NAME = 80
MOST_PER_LESSON = 1000


class MissingObjectError(LibraryError):
    """There is no object of that name."""

    def __init__(self, name: str) -> None:
        super().__init__(f"There is no object {name!r} in the library. Teach it first.")


@dataclass(eq=False)
class Lesson:
    """One object being taught: touches wanted, and the ids of those stored so far."""

    name: str
    wanted: int
    ids: list[str] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {"name": self.name, "wanted": self.wanted, "done": len(self.ids)}


class Teacher:
    """Stores what is taught with a sensor, if there is one, in a library.

    Where there is no library it is made, by `open` or when it is first needed.
    """

    def __init__(self, folder: str | Path, sensor: LiveSensor | None) -> None:
        self.folder = Path(folder)
        self._opened: TouchLibrary | None = None
        self._opening = threading.Lock()
        self._sensor, self._described = sensor, SensorDescription("posted")
        if sensor is not None:
            self._described = SensorDescription(
                sensor.name, unit=sensor.unit, geometry=sensor.geometry
            )
        self._session = time.strftime("%Y-%m-%d %H:%M:%S")
        self._lessons = 0
        self._stored: list[str] = []
        self.lesson: Lesson | None = None
        if TouchLibrary.is_library(self.folder):
            self.open()

    @property
    def library(self) -> TouchLibrary:
        """The library; opened, or made, the first time it is asked for."""
        return self.open()

    def open(self) -> TouchLibrary:
        """Open the library, or make it, unless it is open; return it."""
        with self._opening:
            if self._opened is None:
                self._opened = TouchLibrary.open(self.folder, create=True)
            return self._opened

    def close(self) -> None:
        """Close the library if it is open."""
        if self._opened is not None:
            self._opened.close()

    def begin(self, name: str, wanted: int) -> None:
        """Start to teach an object; a lesson under way ends."""
        check_count("count", wanted)
        if wanted > MOST_PER_LESSON:
            raise ValueError(f"count must be at most {MOST_PER_LESSON}, got {wanted}.")
        if self._sensor is None:
            raise SensorError(
                "There is no sensor here whose touches could be stored. Post them "
                "(teach/touch), or start again with --sensor."
            )
        self._lessons += 1
        self.lesson = Lesson(checked_name(name), wanted)

    def store(self, name: str, image: Array, baseline: Array | None) -> str:
        """Store one touch of an object; return its id once it is on the disk."""
        touch = Touches(
            image[np.newaxis],
            object=[checked_name(name)],
            time_s=[time.time()],
            no_contact=baseline,
            channels=channels_of(image.shape),
            geometry=self._described.geometry,
        )
        (key,) = self.library.add(
            touches=touch,
            session=self._session,
            episode=f"lesson {self._lessons}",
            sensor=self._described,
            progress=False,
        )
        self._stored.append(key)
        return key

    def take(self, image: Array, baseline: Array | None) -> str:
        """Store one touch of the lesson, which ends when full; return what to say."""
        assert self.lesson is not None
        lesson = self.lesson
        lesson.ids.append(self.store(lesson.name, image, baseline))
        count = f"{len(lesson.ids)} of {lesson.wanted}"
        said = f"Touch {count} of {lesson.name} is stored."
        if len(lesson.ids) < lesson.wanted:
            return said
        self.lesson = None
        return f"{said} Learn to recognise it."

    def undo(self) -> str:
        """Leave the touch stored last by this teacher out; return its object.

        Touches that have been left out since are passed over; what others stored is
        never touched.
        """
        while self._stored:
            key = self._stored[-1]
            rows = self.library.list(f"id = '{key}'")
            self.library.retract([key], reason="undone on the page")
            self._stored.pop()
            if self.lesson is not None and key in self.lesson.ids:
                self.lesson.ids.remove(key)
            if rows:
                return str(rows[0].object)
        raise LibraryError(
            "There is no touch to undo: none taught since the start is left. "
            "`palpate library retract` leaves older ones out."
        )

    def rename(self, old: str, new: str, *, learnt: bool, merge: bool = False) -> str:
        """Give an object another name; return that as it is kept.

        Refused where the model has learnt it, from elsewhere, and the library has too
        few touches of it to learn it by its new name.
        """
        tidy = checked_name(new)
        rows, size = self._rows(old), self.image_shape()
        n_usable = sum(row.image_shape == size for row in rows)
        if learnt and not merge and n_usable < LEAST_TOUCHES:
            raise ValueError(
                f"{old!r} must have at least {LEAST_TOUCHES} touches in the library to "
                f"be learnt by another name, got {n_usable}. Teach it some more first."
            )
        if merge:
            self.library.merge_objects(old, tidy)
        else:
            self.library.rename_object(old, tidy)
        return tidy

    def forget(self, name: str, *, learnt: bool) -> None:
        """Leave all touches of an object out, of one that library or model know."""
        stored = name in self._counts()
        if not stored and not learnt:
            raise MissingObjectError(name)
        if stored:
            self.library.retract(object=name, reason="forgotten on the page")

    def to_dict(self) -> dict[str, Any]:
        """Return what the library holds, as plain values."""
        return {
            "folder": str(self.folder.resolve()),
            "objects": [
                {"name": name, "n_touches": count}
                for name, count in self._counts().items()
            ],
            "undoable": len(self._stored),
        }

    def ids(self, name: str, limit: int) -> list[str]:
        """Return the ids of the newest touches of an object, newest first."""
        return [row.id for row in self._rows(name, limit)[::-1]]

    def touches(self, name: str) -> Touches:
        """Return an object's touches of the sensor's size, or else of the newest's."""
        sizes = [row.image_shape for row in self._rows(name)]
        size = sizes[-1]
        if self._sensor is not None and self._sensor.image_shape in sizes:
            size = self._sensor.image_shape
        return self.library.touches(f"object = {quoted(name)} and {of_size(size)}")

    def known_ids(self) -> set[str]:
        """Return the ids of all touches, also those left out; none before it opens."""
        if self._opened is None:
            return set()
        return {row.id for row in self._opened.list(limit=None, retracted=True)}

    def image_shape(self) -> tuple[int, ...] | None:
        """Return the size of the images to learn: the sensor's, or the newest's."""
        if self._sensor is not None:
            return self._sensor.image_shape
        newest = self.newest_type()
        return None if newest is None else newest[0]

    def newest_type(self) -> tuple[tuple[int, ...], np.dtype[Any]] | None:
        """Return size and type of the newest touch's image, or None."""
        rows = self.library.list(limit=1, offset=max(0, len(self.library) - 1))
        if not rows:
            return None
        return rows[0].image_shape, np.dtype(rows[0].dtype)

    def _counts(self) -> dict[str, int]:
        """Return how many touches each object has, sorted by name."""
        return {row.name: row.n_touches for row in self.library.objects()}

    def _rows(self, name: str, limit: int | None = None) -> list[TouchRow]:
        """Return the newest touches of an object, all without a limit, in order."""
        count = self._counts().get(name, 0)
        if not count:
            raise MissingObjectError(name)
        offset = 0 if limit is None else max(0, count - limit)
        return self.library.list(f"object = {quoted(name)}", limit, offset)


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
