"""Teaching: touches of a named object, each on the disk before it is acknowledged.

And whether they will do: how touches differ, and what was learnt is asked about every
touch of it as if that, and its neighbours, had not been taught. Neither says anything
of places that were never touched.
"""

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from .._checks import check_count, did_you_mean
from .._types import Array, Floats
from ..library import LibraryError, SensorDescription, TouchLibrary, TouchRow, quoted
from ..recognition import ObjectRecogniser, with_floor
from ..sensors import DetectedTouch, LiveSensor, SensorError
from ..touches import Touches
from ._images import ImageKind, Names
from ._learning import LEAST_TOUCHES, of_size

LONGEST_NAME = 80
MOST_PER_LESSON = 1000
# 1 less the cosine of two changes. Recorded touches moved by a hundredth of the picture
# and made a fifth harder differ by 0.03 to 0.06 from themselves; two touches of a box,
# a shoe or a bottle by 0.3 to 0.5 at the median, of a ball or a soft toy by 0.06.
_ALIKE, _SIDE, _MAPPED = 0.03, 24, 60
# Touches of a draw, draws, shares that are enough of draws and touches, objects named.
_SOME, _DRAWN, _WELL, _HALF, _MOST_SAID = 8, 40, 0.9, 0.5, 4


class MissingObjectError(LibraryError):
    """There is no object of that name."""

    def __init__(self, name: str, known: dict[str, int]) -> None:
        super().__init__(
            f"There is no object {name!r} in the library.{did_you_mean(name, known)} "
            "Teach it first."
        )


class Variety:
    """Which touches of a lesson are alike.

    A touch is its change from the baseline on at most 24 cells a side, of length 1: a
    harder press of one place is the same. `like` holds for each touch the number of the
    first one that it is like, within the noise of the sensor, or None: it is new.
    """

    def __init__(self) -> None:
        self.like: list[int | None] = []
        self._touches: list[tuple[Floats, float]] = []

    @property
    def n_new(self) -> int:
        """How many touches are like none before them."""
        return self.like.count(None)

    def add(self, image: Array, baseline: Array | None, noise: float) -> None:
        """Take in a touch; `noise` (sensor's unit) is that of one taxel."""
        change = np.nan_to_num(image.astype(np.float32))
        if baseline is not None:
            change = np.nan_to_num(change - baseline)
        power = max(float(np.mean(change**2)), 1e-12)
        n_rows, n_cols = image.shape[:2]
        scale = min(1.0, _SIDE / max(n_rows, n_cols))
        size = max(1, round(n_cols * scale)), max(1, round(n_rows * scale))
        channels = np.moveaxis(np.atleast_3d(change), 2, 0)
        cells = [cv2.resize(c, size, interpolation=cv2.INTER_AREA) for c in channels]
        small = np.ravel(cells).astype(np.float64)
        small /= max(float(np.linalg.norm(small)), 1e-12)
        self._append(small, _ALIKE / 2 + noise**2 / power)

    def drop(self, number: int) -> None:
        """Leave a touch out; `number` counts from 0."""
        kept = [*self._touches[:number], *self._touches[number + 1 :]]
        self.like, self._touches = [], []
        for touch in kept:
            self._append(*touch)

    def _append(self, change: Floats, limit: float) -> None:
        like = (
            number
            for number, (other, its) in enumerate(self._touches, start=1)
            if self.like[number - 1] is None and 1 - other @ change <= limit + its
        )
        self.like.append(next(like, None))
        self._touches.append((change, limit))

    def map(self) -> list[dict[str, Any]]:
        """Return the newest touches as places, -1 to 1, in two main directions."""
        if not self.like:
            return []
        start = max(0, len(self.like) - _MAPPED)
        changes = np.stack([change for change, _ in self._touches[start:]])
        left, spread, _ = np.linalg.svd(changes - changes.mean(0), full_matrices=False)
        places = np.pad(left * spread, ((0, 0), (0, 2)))[:, :2]
        places *= np.where(places[0] < 0, -1, 1)  # the same way round each time
        return [
            {"number": start + k + 1, "x": x, "y": y, "like": self.like[start + k]}
            for k, (x, y) in enumerate(places.tolist())
        ]


@dataclass(eq=False)
class Lesson:
    """One object being taught: touches wanted, and the ids of those stored so far."""

    name: str
    wanted: int
    ids: list[str] = field(default_factory=list)
    variety: Variety = field(default_factory=Variety)

    @property
    def prompt(self) -> str:
        """What to do where the last two touches showed nothing new, else empty."""
        like = self.variety.like
        same = len(like) > 2 and None not in like[-2:]
        return "The last two touches are like earlier ones: touch it elsewhere." * same

    @property
    def verdict(self) -> str:
        """What to do where most touches are alike, else empty."""
        n_touches, n_like = len(self.ids), len(self.ids) - self.variety.n_new
        return (n_touches > 3 and 2 * n_like > n_touches) * (
            f"Of {n_touches} touches of {self.name} {n_like} are like others: ten more "
            "touches of it, elsewhere, unless it is the same all over."
        )

    def to_dict(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "wanted": self.wanted,
            "done": len(self.ids),
            "n_new": self.variety.n_new,
            "map": self.variety.map(),
            "prompt": self.prompt,
        }


class Teacher:
    """Stores what is taught with a sensor, if there is one, in a library.

    Where there is no library it is made when it is first needed.
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
        self.begin_session()
        self._lessons = 0
        self._stored: list[str] = []
        self.lesson: Lesson | None = None
        # Of each object taught, that its last lesson was of touches alike, or "".
        self.verdicts: dict[str, str] = {}
        if TouchLibrary.is_library(self.folder):
            _ = self.library

    @property
    def library(self) -> TouchLibrary:
        """The library; opened, or made, the first time it is asked for."""
        with self._opening:
            if self._opened is None:
                self._opened = TouchLibrary.open(self.folder, create=True)
            return self._opened

    def close(self) -> None:
        if self._opened is not None:
            self._opened.close()

    def begin_session(self, why: str = "", name: str | None = None) -> None:
        """Let touches stored from now on be of another session: `why`, in words.

        With a `name` it is called that, and goes on where the library has it.
        """
        if name is not None and not name.strip():
            raise ValueError("session must have a name, got nothing.")
        started = time.strftime("%Y-%m-%d %H:%M:%S")
        self._session = f"{started} {why}".strip() if name is None else name.strip()

    def begin(self, name: str, wanted: int) -> None:
        check_count("count", wanted, at_most=MOST_PER_LESSON)
        if self._sensor is None:
            raise SensorError(
                "There is no sensor here whose touches could be stored. Post them "
                "(teach/touch), or start again with --sensor."
            )
        lesson = Lesson(checked_name(name), wanted)
        self.end()
        self._lessons += 1
        self.lesson = lesson

    def end(self) -> None:
        """End the lesson under way, if any; what was stored stays."""
        if self.lesson is not None:
            self.verdicts[self.lesson.name] = self.lesson.verdict
        self.lesson = None

    def store(
        self,
        name: str,
        image: Array,
        channels: Names,
        baseline: Array | None,
        columns: Mapping[str, float] | None = None,
    ) -> str:
        """Store one touch of an object; return its id once it is on the disk."""
        touch = Touches(
            image[np.newaxis],
            object=[checked_name(name)],
            time_s=[time.time()],
            no_contact=baseline,
            channels=channels,
            geometry=self._described.geometry,
            **{name: [value] for name, value in (columns or {}).items()},
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

    def take(
        self,
        image: Array,
        baseline: Array | None,
        noise: float,
        columns: Mapping[str, float] | None = None,
    ) -> str:
        """Store one touch of the lesson, which ends when full; return what to say."""
        assert self.lesson is not None
        lesson = self.lesson
        channels = None if self._sensor is None else self._sensor.channels
        lesson.ids.append(self.store(lesson.name, image, channels, baseline, columns))
        count = f"{len(lesson.ids)} of {lesson.wanted}"
        said = f"Touch {count} of {lesson.name} is stored."
        lesson.variety.add(image, baseline, noise)
        if len(lesson.ids) < lesson.wanted:
            return said
        self.end()
        return f"{said} {lesson.verdict or 'Learn to recognise it.'}"

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
                number = self.lesson.ids.index(key)
                self.lesson.ids.pop(number)
                self.lesson.variety.drop(number)
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
        self.verdicts.pop(old, None)
        if merge:
            self.library.merge_objects(old, tidy)
        else:
            self.library.rename_object(old, tidy)
        return tidy

    def forget(self, name: str, *, learnt: bool) -> None:
        """Leave all touches of an object out, of one that library or model know."""
        stored = name in self._counts()
        if not stored and not learnt:
            raise MissingObjectError(name, self._counts())
        self.verdicts.pop(name, None)
        if stored:
            self.library.retract(object=name, reason="forgotten on the page")

    def to_dict(self) -> dict[str, Any]:
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
        newest = self.newest_kind()
        return None if newest is None else newest.shape

    def channels(self, key: str) -> list[str]:
        """Return what the channels of a stored touch are called."""
        touch = self.library.select(f"id = {quoted(key)}")
        names: list[str] = touch.whole["channels"].tolist()
        return names

    def newest_kind(self) -> ImageKind | None:
        """Return what the newest touch's image is like, or None."""
        rows = self.library.list(limit=1, offset=max(0, len(self.library) - 1))
        if not rows:
            return None
        shape, dtype = rows[0].image_shape, np.dtype(rows[0].dtype)
        names = self.channels(rows[0].id) if len(shape) == 3 else None
        return ImageKind(shape, dtype, names)

    def _counts(self) -> dict[str, int]:
        return {row.name: row.n_touches for row in self.library.objects()}

    def _rows(self, name: str, limit: int | None = None) -> list[TouchRow]:
        """Return the newest touches of an object, all without a limit, in order."""
        count = self._counts().get(name, 0)
        if not count:
            raise MissingObjectError(name, self._counts())
        offset = 0 if limit is None else max(0, count - limit)
        return self.library.list(f"object = {quoted(name)}", limit, offset)


def columns_of(touch: DetectedTouch) -> dict[str, float]:
    """Return what a device told beside the image of a touch, as columns."""
    columns = dict(touch.columns)
    if touch.device_time_s is not None:
        columns["device_time_s"] = touch.device_time_s
    return columns


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


def object_quality(recogniser: ObjectRecogniser) -> list[dict[str, Any]]:
    """Return how often left-out touches of each object are recognised.

    By `name`: `n_touches` with contact; `after_one` and `after_eight`, shares of right
    answers after one touch and after eight drawn ones, None where there are not so
    many; `taken_for`, the most frequent wrong answer to one touch, or None.
    """
    memory, names = recogniser.memory_, recogniser.classes_.astype(str).tolist()
    said = with_floor(recogniser.left_out_log_likelihood(), recogniser.floor_)
    left_out = recogniser.left_out_rows
    felt = recogniser.uses_no_contact_ | ~memory.nothing[left_out]
    labels = memory.labels[left_out]
    rng, result = np.random.default_rng(0), []
    for code, name in enumerate(names):
        rows = np.flatnonzero((labels == recogniser.classes_[code]) & felt)
        answers = np.bincount(said[rows].argmax(axis=1), minlength=len(names))
        right, answers[code] = answers[code], 0
        drawn = rng.permuted(np.tile(rows, (_DRAWN, 1)), axis=1)[:, :_SOME]
        best = said[drawn].sum(axis=1).argmax(axis=1)
        after_eight = float(np.mean(best == code)) if len(rows) >= _SOME else None
        result.append(
            {
                "name": name,
                "n_touches": len(rows),
                "after_one": float(right / len(rows)) if len(rows) else None,
                "after_eight": after_eight,
                "taken_for": names[answers.argmax()] if answers.any() else None,
            }
        )
    return result


def advice(qualities: list[dict[str, Any]]) -> list[str]:
    """Return what to teach next, in sentences, of what `object_quality` returned.

    Of objects that too few touches, one or eight, are right of, the worst first.
    """
    few = [one["name"] for one in qualities if one["after_eight"] is None]
    judged = (one for one in qualities if one["after_eight"] is not None)
    low = [x for x in judged if x["after_one"] < _HALF or x["after_eight"] < _WELL]
    low = sorted(low, key=lambda one: one["after_one"])[:_MOST_SAID]
    weak, said = {one["name"]: one["taken_for"] for one in low}, []
    for name, other in weak.items():
        if other is None or weak.get(other) != name:
            what = f"is taken for {other}" if other else "is not sure"
            said.append(f"{name} {what}: ten more touches of {name}, elsewhere.")
        elif name < other:
            what = f"{name} and {other} are taken for each other"
            said.append(f"{what}: ten more touches of each, elsewhere.")
    if few:
        said.append(f"Fewer than {_SOME} touches cannot be judged: {', '.join(few)}.")
    return said
