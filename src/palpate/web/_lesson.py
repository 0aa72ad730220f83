"""What is taught: a lesson, and what was done with touches, kept to be undone later.

A lesson is touches of one object, and whether they differ; they say nothing of places
that were never touched. The journal is a text file of one JSON object a line in the
library's folder. A line is written after the library has done what it says; one that is
lost, or torn by a power cut, costs that undo and nothing else, so nothing waits for the
disk.
"""

import json
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from .._checks import check_count
from .._types import Array, Floats
from ..recognition import no_contact_of
from ..touches import Touches
from ._images import Names

# 1 less the cosine of two changes. Recorded touches moved by a hundredth of the picture
# and made a fifth harder differ by 0.03 to 0.06 from themselves; two touches of a box,
# a shoe or a bottle by 0.3 to 0.5 at the median, of a ball or a soft toy by 0.06.
_ALIKE, _SIDE, _MAPPED = 0.03, 24, 60
_SHOWN = 12  # touches of a lesson whose pictures the page shows
_RECENT = 12  # touches of a lesson that tell what a middling one is
MOST_ACTIONS = 1000
_SITTING_S = 3600.0  # a sitting ends where the page was not used for longer
_LONGEST_BYTES = 2**22  # of the file's end that is read


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
        # Of opposite touches one alone lies up to 2 from the middle of the others.
        places /= max(1.0, float(np.abs(places).max()))
        return [
            {"number": start + k + 1, "x": x, "y": y, "like": self.like[start + k]}
            for k, (x, y) in enumerate(places.tolist())
        ]


@dataclass(eq=False)
class Lesson:
    """One object being taught: touches wanted, and the ids of those stored so far.

    Those in `no_contact_ids` show no contact: they are stored and do not count.
    """

    name: str
    wanted: int
    ids: list[str] = field(default_factory=list)
    variety: Variety = field(default_factory=Variety)
    no_contact_ids: set[str] = field(default_factory=set)
    _recent: list[Array] = field(default_factory=list)

    def add(self, key: str, image: Array, baseline: Array | None, noise: float) -> None:
        """Take in a stored touch; `noise` (sensor's unit) is that of one taxel."""
        self.ids.append(key)
        self.variety.add(image, baseline, noise)

    def drop(self, key: str) -> None:
        """Leave a stored touch out."""
        number = self.ids.index(key)
        self.ids.pop(number)
        self.no_contact_ids.discard(key)
        self.variety.drop(number)

    def shows_contact(
        self,
        image: Array,
        baseline: Array | None,
        geometry: str | None,
        channels: Names,
    ) -> bool:
        """Tell whether a touch shows contact, by those of the lesson before it.

        By what learning leaves out, so that a lesson ends with touches that count.
        """
        if baseline is None:
            return True
        recent = [*self._recent[1 - _RECENT :], image]
        touches = Touches(
            np.stack(recent),
            no_contact=baseline,
            geometry=geometry,
            channels=channels,
        )
        try:
            if no_contact_of(touches)[-1]:
                return False
        except ValueError:  # not to be told: the lesson goes on, and learning says why
            return True
        self._recent = recent
        return True

    @property
    def done(self) -> int:
        """How many touches count."""
        return sum(key not in self.no_contact_ids for key in self.ids)

    @property
    def _like(self) -> list[int | None]:
        """Of the touches that count, which earlier ones they are like."""
        like = zip(self.ids, self.variety.like, strict=False)
        return [first for key, first in like if key not in self.no_contact_ids]

    @property
    def prompt(self) -> str:
        """What to do where the last two touches showed nothing new, else empty."""
        like = self._like
        same = len(like) > 2 and None not in like[-2:]
        return "The last two touches are like earlier ones: touch it elsewhere." * same

    @property
    def verdict(self) -> str:
        """What to do where most touches are alike, else empty."""
        n_touches, n_like = len(self._like), len(self._like) - self._like.count(None)
        return (n_touches > 3 and 2 * n_like > n_touches) * (
            f"Of {n_touches} touches of {self.name} {n_like} are like others: ten more "
            "touches of it, elsewhere, unless it is the same all over."
        )

    def to_dict(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "wanted": self.wanted,
            "done": self.done,
            "stored": len(self.ids),
            "newest": self.ids[-_SHOWN:],
            "no_contact": [
                n for n, key in enumerate(self.ids, 1) if key in self.no_contact_ids
            ],
            "n_new": self.variety.n_new,
            "map": self.variety.map(),
            "prompt": self.prompt,
        }


@dataclass(frozen=True)
class Action:
    """Touches "taught", "removed" or "moved" from `object`, as `copies`, `to` one.

    Some may have been of `others`.
    """

    kind: str
    object: str
    ids: list[str]
    copies: list[str] = field(default_factory=list)
    to: str = ""
    others: list[str] = field(default_factory=list)


class Journal:
    """Actions that can be undone, the newest last, and the lesson under way.

    `interrupted` is the lesson that was under way when the file was written last (of
    its touches the ids alone), until one begins or it is ended. `changed` are the
    objects whose touches are others than when the model learnt last, `renamed` those
    to be learnt under another name, or forgotten: "", in order. `session` is that of
    the touches stored last, with the name of their sensor; `no_contact_ids` are those
    of touches taught here that show no contact. `moving` are the touches, and the
    object, of a move that was begun.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.actions: list[Action] = []
        self.changed: set[str] = set()
        self.renamed: list[tuple[str, str]] = []
        self.session: tuple[str, str] | None = None
        self.n_lessons = 0
        self.no_contact_ids: set[str] = set()
        self.moving: tuple[list[str], str] | None = None
        self._lesson: Lesson | None = None
        for line in self._lines():
            wrong = ValueError, TypeError, KeyError, AttributeError, RecursionError
            with suppress(*wrong):
                _check(content := json.loads(line))
                self._take(content)
        self.interrupted: Lesson | None = self._lesson

    @property
    def last(self) -> Action | None:
        """The newest action that can be undone."""
        return self.actions[-1] if self.actions else None

    def add(self, action: Action, *, posted: bool = False) -> None:
        """Keep an action; what was `posted` is none of the lesson under way."""
        self._write({"action": dict(vars(action)), "posted": posted})

    def begin_move(self, ids: Sequence[str], to: str) -> None:
        """Note touches that are about to be copied `to` an object; none: it is over."""
        self._write({"moving": {"ids": [*ids], "to": to}})

    def pop(self) -> None:
        """Forget the newest action: it is undone."""
        self._write({"undone": True})

    def add_no_contact(self, key: str) -> None:
        """Note that a touch of the lesson shows no contact."""
        self._write({"no_contact": key})

    def store_in(self, session: str, sensor: str) -> None:
        """Note which session touches are stored in from now on."""
        if self.session != (session, sensor):
            self._write({"session": [session, sensor]})

    def goes_on(self, sensor: str) -> str | None:
        """Return the session of this sitting, which a restart does not end."""
        try:
            rested_s = time.time() - self.path.stat().st_mtime
        except OSError:
            return None
        long_ago = abs(rested_s) > _SITTING_S  # below 0 where the clock went back
        if self.session is None or self.session[1] != sensor or long_ago:
            return None
        return self.session[0]

    def learnt(self) -> None:
        """Note which objects are still others than what was learnt."""
        self._write({"changed": sorted(self.changed), "renamed": self.renamed})

    def begin_lesson(self, name: str, wanted: int, ids: Sequence[str] = ()) -> None:
        """Note that a lesson begins, with the touches that it has already."""
        self._write({"lesson": {"name": name, "wanted": wanted, "ids": [*ids]}})
        self.interrupted = None

    def end_lesson(self) -> None:
        """Note that there is no lesson any more."""
        if self._lesson is not None or self.interrupted is not None:
            self._write({"lesson": None})
        self.interrupted = None

    def _take(self, line: dict[str, Any]) -> None:
        if "moving" in line:
            ids, to = line["moving"]["ids"], line["moving"]["to"]
            self.moving = (ids, to) if ids else None
        elif "action" in line:
            action = Action(**line["action"])
            self.moving = None
            self.actions = [*self.actions[1 - MOST_ACTIONS :], action]
            self._change(action)
            in_lesson = action.kind == "taught" and not line.get("posted")
            if self._lesson is not None and in_lesson:
                self._lesson.ids += action.ids
            else:
                self._drop(action)
        elif "undone" in line and self.actions:
            undone = self.actions.pop()
            self._change(undone)
            self._drop(undone)
            if undone.kind == "taught":
                self.no_contact_ids -= {*undone.ids}
        elif "changed" in line:
            renamed = [(str(old), str(new)) for old, new in line.get("renamed", ())]
            self.changed = {str(name) for name in line["changed"]}
            self.renamed = renamed
        elif "no_contact" in line:
            self.no_contact_ids.add(str(line["no_contact"]))
            if self._lesson is not None:
                self._lesson.no_contact_ids.add(str(line["no_contact"]))
        elif "session" in line:
            session, sensor = line["session"]
            self.session = str(session), str(sensor)
        elif "lesson" in line:
            lesson = line["lesson"]
            if lesson is not None:
                wanted = check_count("wanted", lesson["wanted"])
                lesson = Lesson(lesson["name"], wanted, lesson["ids"])
            self._lesson = lesson
            self.n_lessons += lesson is not None

    def _change(self, action: Action) -> None:
        self.changed |= {action.object, action.to, *action.others} - {""}

    def _drop(self, action: Action) -> None:
        if self._lesson is not None:
            gone = set(action.ids)
            self._lesson.ids = [key for key in self._lesson.ids if key not in gone]

    def _lines(self) -> list[str]:
        try:
            with self.path.open("rb") as file:
                size = file.seek(0, 2)
                file.seek(max(0, size - _LONGEST_BYTES))
                return file.read().decode("utf-8", "replace").splitlines()
        except OSError:
            return []

    def _write(self, line: dict[str, Any]) -> None:
        self._take(line)
        # The touch is stored already: a disk without room only costs the undo.
        with suppress(OSError), self.path.open("ab+") as file:
            file.seek(max(0, file.seek(0, 2) - 1))
            torn = file.read() not in (b"", b"\n")
            file.write(b"\n" * torn + json.dumps(line).encode() + b"\n")


def _check(content: dict[str, Any]) -> None:
    """Refuse a line of a journal whose names are no texts, or ids no list of them."""
    for name, value in content.items():
        if isinstance(value, dict):
            _check(value)
        elif name in ("kind", "object", "to", "name", "ids", "copies", "others"):
            texts = value if name in ("ids", "copies", "others") else [value]
            if type(texts) is not list or {*map(type, texts)} - {str}:
                raise TypeError(f"A journal must hold texts as {name}, got {value!r}.")
