"""Teaching: touches of a named object, each on the disk before it is acknowledged.

What was done can be undone, also after a restart: see `Journal`.
"""

import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from .._checks import check_count, did_you_mean
from .._types import Array
from ..library import (
    LibraryError,
    SensorDescription,
    TouchLibrary,
    TouchRow,
    quoted,
)
from ..sensors import LiveSensor
from ..touches import Touches
from ._images import ImageKind, Names
from ._learning import LEAST_TOUCHES, newest_row, of_size
from ._lesson import Action, Journal, Lesson

LONGEST_NAME = 80
MOST_PER_LESSON = 1000
JOURNAL = "page.jsonl"

NO_CONTACT_MESSAGE = (
    "That touch of {} shows no contact and does not count: touch it again. It is "
    "stored; press its picture to remove it."
)
REPEATED = (
    "That touch of {} is stored already, the same to the last number: it was played "
    "again and is not stored twice."
)
NO_MORE = (
    "All {n} touches that were recorded here are stored: {done} of {wanted} of {name}."
)
UNDONE = {
    "taught": "The last touch of {name} is undone.",
    "removed": "What was removed of {name} is back.",
    "moved": "What was moved to {to} is back with {name}.",
    "forgotten": "The touches of {name} are back: learn again.",
}


class MissingObjectError(LibraryError):
    """There is no object of that name."""

    def __init__(self, name: str, names: dict[str, int]) -> None:
        super().__init__(
            f"There is no object {name!r} in the library.{did_you_mean(name, names)} "
            "Teach it first."
        )


class MissingTouchError(LibraryError):
    """There is no touch of that id."""

    def __init__(self, key: str) -> None:
        super().__init__(
            f"There is no touch {key!r} in the library, or it was removed. "
            "Load the page again."
        )


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
        self._desk = None if sensor is None else sensor.desk
        # Pictures of the object of the lesson, where touches are played: by touch id.
        self._pictures: dict[str, bytes] = {}
        self._n_repeated = 0  # one after the other
        self.journal = Journal(self.folder / JOURNAL)
        self._lessons = self.journal.n_lessons
        self._session, self._is_new_session = "", True
        self.begin_session(name=self.journal.goes_on(self._described.name))
        self.lesson: Lesson | None = None
        # Of each object taught, that its last lesson was of touches alike, or "".
        self.verdicts: dict[str, str] = {}
        self.elsewhere: set[str] = set()  # objects that the model knows from elsewhere
        if TouchLibrary.is_library(self.folder):
            _ = self.library
            if (moving := self.journal.moving) is not None:  # killed in the middle
                self.journal.begin_move((), "")
                with suppress(ValueError):  # all are moved
                    self.move(*moving)
            if self._desk is not None:
                stats = self.library.stats()
                self._desk.go_on(stats.n_touches + stats.n_retracted)

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
        self._session_before = self._session, self._is_new_session
        started = time.strftime("%Y-%m-%d %H:%M:%S")
        self._session = f"{started} {why}".strip() if name is None else name.strip()
        self._is_new_session = name is None

    def undo_session(self) -> None:
        """Go on with the session before the last one that was begun."""
        self._session, self._is_new_session = self._session_before

    def begin(self, name: str, wanted: int) -> None:
        check_count("wanted", wanted, at_most=MOST_PER_LESSON)
        lesson = Lesson(teachable_name(name), wanted)
        self.end()
        self.journal.begin_lesson(lesson.name, wanted)  # where refused, there is none
        self._lessons += 1
        self.lesson = lesson
        self._n_repeated, self._pictures = 0, {}
        if self._desk is not None and lesson.name in self._counts():
            rows = self._rows(lesson.name)
            self._pictures = {
                row.id: _digest(self.library.image(row.id)) for row in rows
            }

    def resume(self, baseline: Array | None, noise: float) -> str:
        """Go on with the lesson that a restart interrupted; return its object."""
        interrupted = self.journal.interrupted
        if interrupted is None:
            raise ValueError("There is no interrupted lesson. Start one with a name.")
        name = self._name_now(interrupted.name, interrupted.ids)
        rows = [row for key in interrupted.ids for row in self._row(key)]
        keys = [row.id for row in rows if not row.retracted]  # elsewhere, meanwhile
        wanted = max(interrupted.wanted, interrupted.done + 1)
        self.begin(name, wanted)
        assert self.lesson is not None
        self.journal.begin_lesson(name, wanted, keys)
        size = self.image_shape()
        for key in keys:
            image = self.library.image(key)
            if image.shape == size:
                # Judged when it was stored: the baseline of then is not that of now.
                if key in interrupted.no_contact_ids:
                    self._mark_no_contact(key)
                self.lesson.add(key, image, baseline, noise)
        return name

    def end(self) -> None:
        """End the lesson under way, if any; what was stored stays."""
        if self.lesson is not None:
            self.verdicts[self.lesson.name] = self.lesson.verdict
        self.lesson = None
        self.journal.end_lesson()

    def store(
        self,
        name: str,
        image: Array,
        channels: Names,
        baseline: Array | None,
        columns: Mapping[str, Any] | None = None,
        *,
        posted: bool = True,
    ) -> str:
        """Store one touch of an object; return its id once it is on the disk.

        What is not `posted` is of the lesson under way.
        """
        tidy = teachable_name(name)
        fixed: dict[str, Any] = {
            "images": image[np.newaxis],
            "object": [tidy],
            "time_s": [time.time()],
            "no_contact": baseline,
            "channels": channels,
            "geometry": self._described.geometry,
            **({} if self._sensor is not None else self._layout()),
        }
        measured = {name: [value] for name, value in (columns or {}).items()}
        if taken := sorted(fixed.keys() & measured):
            raise ValueError(
                "Columns beside the frames of a sensor must not be called "
                f"{', '.join(taken)}: every touch has these. Rename them in its driver."
            )
        touch = Touches(**fixed, **measured)
        named = f"session = {quoted(self._session)}"
        if self._is_new_session and self.library.list(named, 1, retracted=True):
            # Begun within the same second, perhaps by another program.
            self._session += f".{int(time.time() % 1 * 1000):03}"
        self._is_new_session = False
        (key,) = self.library.add(
            touches=touch,
            session=self._session,
            episode=f"lesson {self._lessons}",
            sensor=self._described,
            progress=False,
        )
        self.journal.store_in(self._session, self._described.name)
        self.journal.add(Action("taught", tidy, [key]), posted=posted)
        return key

    def take(
        self,
        image: Array,
        baseline: Array | None,
        noise: float,
        columns: Mapping[str, Any] | None = None,
    ) -> str:
        """Store one touch of the lesson, which ends when full; return what to say.

        A touch that is played again is not stored again: it would be learnt, and asked
        about, as if it were another.
        """
        assert self.lesson is not None
        lesson = self.lesson
        if self._desk is not None and _digest(image) in self._pictures.values():
            return self._repeat(lesson, self._desk.n_recorded)
        channels = None if self._sensor is None else self._sensor.channels
        touch = image, channels, baseline, columns
        key = self.store(lesson.name, *touch, posted=False)
        self._n_repeated = 0
        if self._desk is not None:
            self._pictures[key] = _digest(image)
        if not self._add(key, image, baseline, noise):
            return NO_CONTACT_MESSAGE.format(lesson.name)
        stored = f"Touch {lesson.done} of {lesson.wanted} of {lesson.name} is stored."
        if lesson.done < lesson.wanted:
            return stored
        self.end()
        taught = {name for name, count in self._counts().items() if count > 1}
        can_learn = len(taught | self.elsewhere) > 1
        then = (
            "Next: Learn, or another object." if can_learn else "Teach another object."
        )
        return f"{stored} {lesson.verdict or then}"

    def _repeat(self, lesson: Lesson, n_recorded: int | None) -> str:
        """Say that a touch was played again; of a whole recording the lesson ends."""
        self._n_repeated += 1
        if n_recorded is None or self._n_repeated < n_recorded:
            return REPEATED.format(lesson.name)
        self.end()
        about = {"done": lesson.done, "wanted": lesson.wanted, "name": lesson.name}
        return NO_MORE.format(n=n_recorded, **about)

    def _add(
        self, key: str, image: Array, baseline: Array | None, noise: float
    ) -> bool:
        """Take a stored touch into the lesson; return whether it counts."""
        assert self.lesson is not None
        channels = None if self._sensor is None else self._sensor.channels
        about = self._described.geometry, channels
        counts = self.lesson.shows_contact(image, baseline, *about)
        if not counts:  # known before it is there, so that it is never counted
            self._mark_no_contact(key)
        self.lesson.add(key, image, baseline, noise)
        return counts

    def _mark_no_contact(self, key: str) -> None:
        assert self.lesson is not None
        self.lesson.no_contact_ids.add(key)
        self.journal.add_no_contact(key)

    def undo(self) -> tuple[str, str]:
        """Take back what was done last on the page; return the object and what to say.

        What has been undone elsewhere since is passed over; what others added is never
        touched.
        """
        while (last := self.journal.last) is not None:
            name = self._undo(last)
            self.journal.pop()
            # As they are called by now, perhaps otherwise than then.
            keys = (*last.ids, *last.copies)
            rows = [row for key in keys for row in self._row(key)]
            self.journal.changed |= {*_objects(rows)}
            self.journal.learnt()
            if name is not None:
                to = self._name_now(last.to, last.copies)
                return name, UNDONE[last.kind].format(name=name, to=to)
        raise LibraryError(
            "There is no touch to undo: nothing done on this page is left. "
            "Older ones are removed by their pictures."
        )

    def _undo(self, last: Action) -> str | None:
        """Take one action back; None where nothing of it is left."""
        rows = [row for key in last.ids for row in self._row(key)]
        if last.kind == "taught":
            left = [row for row in rows if not row.retracted]
            if left:
                reason = "undone on the page"
                self.library.retract([row.id for row in left], reason=reason)
            self._drop_from_lesson(last.ids)
            return str(left[0].object) if left else None
        gone = [row.id for row in rows if row.retracted]
        copies = [row.id for key in last.copies for row in self._row(key)]
        if gone:
            self.library.restore(gone)
        if copies:
            self.library.retract(copies, reason="the move was undone on the page")
        return ", ".join(_objects(rows)) if gone else None

    def remove(self, ids: Sequence[str]) -> str:
        """Leave touches out, which can be undone; return what to say."""
        rows = self._present(ids)
        keys = [row.id for row in rows]
        self.library.retract(keys, reason="removed on the page")
        names = _objects(rows)
        self.journal.add(Action("removed", names[0], keys, others=names[1:]))
        self._drop_from_lesson(keys)
        return f"{_counted(rows)} of {', '.join(names)} removed."

    def move(self, ids: Sequence[str], name: str) -> str:
        """Let touches be of another object, which can be undone; return what to say."""
        tidy = teachable_name(name)
        rows = [row for row in self._present(ids) if row.object != tidy]
        if not rows:
            raise ValueError(f"The touch is of {tidy} already. Choose another object.")
        keys, names = [row.id for row in rows], _objects(rows)
        copies: list[str] = []
        self.journal.begin_move(keys, tidy)
        try:
            for row in rows:
                copies.append(self._copy(row, tidy))
            self.library.retract(keys, reason=f"moved to {tidy} on the page")
        except ValueError:  # a touch is of one object, not of both
            if copies:
                self.library.retract(copies, reason="the move failed on the page")
            self.journal.begin_move((), "")
            raise
        self.journal.add(Action("moved", names[0], keys, copies, tidy, names[1:]))
        self._drop_from_lesson(keys)
        return f"{_counted(rows)} of {', '.join(names)} moved to {tidy}."

    def _copy(self, row: TouchRow, name: str) -> str:
        """Add a touch once more under another name; return its id."""
        touch = self.library.touches(f"id = {quoted(row.id)}")
        if "category" in touch.columns:
            touch = touch.without("category")
            newest = self._rows(name, 1) if name in self._counts() else []
            if newest and newest[0].category is not None:
                touch = touch.with_columns(category=[newest[0].category])
        sensors = {sensor.name: sensor for sensor in self.library.sensors()}
        about: dict[str, Any] = {"sensor": sensors.get(row.sensor or "")}
        about["progress"] = False
        touch = touch.with_columns(object=[name])
        (key,) = self.library.add(touch, **about)
        (stored,) = self._row(key)
        if key == row.id or (stored.retracted and stored.object != name):
            # The library knows it again, by a name that its object had before.
            episode = f"{row.episode or ''} moved at {time.time():.6f}".strip()
            (key,) = self.library.add(touch.with_columns(episode=[episode]), **about)
            (stored,) = self._row(key)
            if stored.object == row.object:
                self.library.retract([key], reason="the move failed on the page")
                raise ValueError(
                    f"The touch is of {row.object} already: {name} was merged into it. "
                    "Choose another object."
                )
        if stored.retracted:  # it was there before
            self.library.restore([key])
        return key

    def _row(self, key: str) -> list[TouchRow]:
        """Return the touch of an id, also one left out; none where it is not there."""
        return self.library.list(f"id = {quoted(key)}", retracted=True)

    def _present(self, ids: Sequence[str]) -> list[TouchRow]:
        """Return touches by their ids, or say which is not there."""
        rows = []
        for key in dict.fromkeys(ids):
            present = [row for row in self._row(key) if not row.retracted]
            if not present:
                raise MissingTouchError(key)
            rows += present
        return rows

    def _name_now(self, name: str, ids: Sequence[str]) -> str:
        """Return what the object of touches is called by now."""
        rows = self._row(ids[-1]) if ids else []
        return str(rows[0].object) if rows else name

    def _drop_from_lesson(self, ids: Sequence[str]) -> None:
        lesson = self.lesson
        for key in ids:
            self._pictures.pop(key, None)
            if lesson is not None and key in lesson.ids:
                lesson.drop(key)

    def rename(self, old: str, new: str, *, learnt: bool, merge: bool = False) -> str:
        """Give an object another name; return that as it is kept.

        Refused where the model has learnt it, from elsewhere, and the library has too
        few touches of it to learn it by its new name.
        """
        tidy = teachable_name(new)
        of_model = tidy in self.elsewhere and tidy not in {old, *self._counts()}
        if of_model and not merge:
            raise ValueError(
                f"The new name must not be taken, got {tidy!r}, which the model knows "
                f"from elsewhere. To make two objects one, merge {old!r} into it."
            )
        rows, size = self._rows(old), self.image_shape()
        n_usable = sum(row.image_shape == size for row in rows)
        if learnt and not merge and n_usable < LEAST_TOUCHES:
            raise ValueError(
                f"{old!r} must have at least {LEAST_TOUCHES} touches in the library to "
                f"be learnt by another name, got {n_usable}. Teach it some more first."
            )
        self.verdicts.pop(old, None)
        if merge and not of_model:
            self.library.merge_objects(old, tidy)
        else:
            self.library.rename_object(old, tidy)
        lesson = self.lesson or self.journal.interrupted
        if lesson is not None and lesson.name == old:
            lesson.name = tidy
            self.journal.begin_lesson(tidy, lesson.wanted, lesson.ids)
            for key in lesson.no_contact_ids:
                self.journal.add_no_contact(key)
            if self.lesson is None:
                self.journal.interrupted = lesson
        return tidy

    def forget(self, name: str, *, learnt: bool) -> None:
        """Leave all touches of an object out, of one that library or model know."""
        stored = name in self._counts()
        if not stored and not learnt:
            raise MissingObjectError(name, self._counts())
        self.verdicts.pop(name, None)
        if stored:
            keys = [row.id for row in self._rows(name)]
            self.library.retract(object=name, reason="forgotten on the page")
            self.journal.add(Action("forgotten", name, keys))
            self._drop_from_lesson(keys)

    def to_dict(self) -> dict[str, Any]:
        last = self.journal.last
        return {
            "folder": str(self.folder.resolve()),
            "objects": [
                {"name": name, "n_touches": count}
                for name, count in self._counts().items()
            ],
            "undoable": len(self.journal.actions),
            "undo": None
            if last is None
            else {
                "kind": last.kind,
                "object": self._name_now(last.object, last.ids[:1]),
                "to": self._name_now(last.to, last.copies),
            },
            "interrupted": self._interrupted(),
            "changed": sorted(self.journal.changed),
        }

    def _interrupted(self) -> dict[str, Any] | None:
        """Return the lesson that a restart cut off, where it can go on."""
        interrupted = self.journal.interrupted
        if interrupted is None or self._sensor is None or self.lesson is not None:
            return None
        name = self._name_now(interrupted.name, interrupted.ids)
        about = {"wanted": interrupted.wanted, "done": interrupted.done}
        return {"name": name, **about}

    def newest(self, name: str, limit: int, offset: int = 0) -> list[TouchRow]:
        """Return the newest touches of an object but the first `offset`."""
        rows = self._rows(name, limit + offset)[::-1]
        return rows[offset:]

    def touches(self, name: str) -> Touches:
        """Return an object's touches of the sensor's size, or else of the newest's."""
        sizes = [row.image_shape for row in self._rows(name)]
        size = sizes[-1]
        if self._sensor is not None and self._sensor.image_shape in sizes:
            size = self._sensor.image_shape
        return self.library.touches(f"object = {quoted(name)} and {of_size(size)}")

    def touches_of_ids(
        self, ids: Sequence[str], image_shape: Sequence[int]
    ) -> Touches | None:
        """Return stored touches of one size by their ids, None if one is missing."""
        chosen = self.library.select(f"object is not null and {of_size(image_shape)}")
        row_of = {key: row for row, key in enumerate(chosen.touch_id.tolist())}
        if not ids or not row_of.keys() >= {*ids}:
            return None
        rows, order = np.unique([row_of[key] for key in ids], return_inverse=True)
        return chosen.touches(rows)[order]

    def known_ids(self) -> set[str]:
        """Return the ids of all touches, also those left out; none before it opens."""
        if self._opened is None:
            return set()
        return {row.id for row in self._opened.list(limit=None, retracted=True)}

    def image_shape(self) -> tuple[int, ...] | None:
        """Return the size of the images to learn: the sensor's, or the newest's."""
        if self._sensor is not None:
            return self._sensor.image_shape
        newest = newest_row(self.library)
        return None if newest is None else newest.image_shape

    def channels(self, key: str) -> list[str]:
        """Return what the channels of a stored touch are called."""
        touch = self.library.select(f"id = {quoted(key)}")
        names: list[str] = touch.whole["channels"].tolist()
        return names

    def _layout(self) -> dict[str, Any]:
        """Return how the taxels of the newest touch lie, as far as that is told."""
        newest = newest_row(self.library)
        if newest is None:
            return {}
        whole = self.library.select(f"id = {quoted(newest.id)}").whole
        names = "geometry", "pads", "pad_names"
        layout = {name: whole[name] for name in names if name in whole}
        return {n: str(v) if n == "geometry" else v for n, v in layout.items()}

    def newest_kind(self) -> ImageKind | None:
        """Return what the newest touch's image is like, or None."""
        newest = newest_row(self.library)
        if newest is None:
            return None
        shape, dtype = newest.image_shape, np.dtype(newest.dtype)
        names = self.channels(newest.id) if len(shape) == 3 else None
        return ImageKind(shape, dtype, names)

    def ids_of(self, name: str) -> set[str]:
        """Return the ids of an object's touches that are to be learnt."""
        size = self.image_shape()
        rows = self.library.list(f"object = {quoted(name)}", limit=None)
        return {row.id for row in rows if row.image_shape == size}

    def _counts(self) -> dict[str, int]:
        return {row.name: row.n_touches for row in self.library.objects()}

    def _rows(self, name: str, limit: int | None = None) -> list[TouchRow]:
        """Return the newest touches of an object, all without a limit, in order."""
        count = self._counts().get(name, 0)
        if not count:
            raise MissingObjectError(name, self._counts())
        offset = 0 if limit is None else max(0, count - limit)
        return self.library.list(f"object = {quoted(name)}", limit, offset)


def _digest(image: Array) -> bytes:
    """Return what is the same for pictures that are the same to the last number."""
    return sha256(image.tobytes()).digest()


def _objects(rows: Sequence[TouchRow]) -> list[str]:
    """Return what objects touches are of, each once."""
    return [*dict.fromkeys(str(row.object) for row in rows)]


def _counted(rows: Sequence[TouchRow]) -> str:
    return "1 touch" if len(rows) == 1 else f"{len(rows)} touches"


def teachable_name(name: str) -> str:
    """Return the name of an object without blanks at its ends, or explain."""
    tidy = " ".join(name.split())
    if not tidy:
        raise ValueError("The name of an object must not be blank. Give one.")
    tidy = TouchLibrary.checked_name(tidy)
    if len(tidy) > LONGEST_NAME:
        raise ValueError(
            f"The name of an object must have at most {LONGEST_NAME} characters, got "
            f"{len(tidy)}. Shorten it."
        )
    if tidy.casefold() in ("unknown", "nothing", "nothing learnt", "nothing i know"):
        raise ValueError(
            f"The name of an object must not be {tidy!r}, which is what palpate says "
            "of objects it has not learnt."
        )
    return tidy
