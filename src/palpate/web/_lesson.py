"""A lesson: touches of one object, and whether they differ.

What they say nothing of is places that were never touched.
"""

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from .._types import Array, Floats
from ..recognition import no_contact_of
from ..touches import Touches
from ._images import Names

# 1 less the cosine of two changes. Recorded touches moved by a hundredth of the picture
# and made a fifth harder differ by 0.03 to 0.06 from themselves; two touches of a box,
# a shoe or a bottle by 0.3 to 0.5 at the median, of a ball or a soft toy by 0.06.
_ALIKE, _SIDE, _MAPPED = 0.03, 24, 60
_RECENT = 12  # touches of a lesson that tell what a middling one is


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

    Those in `silent` show no contact: they are stored and do not count.
    """

    name: str
    wanted: int
    ids: list[str] = field(default_factory=list)
    variety: Variety = field(default_factory=Variety)
    silent: set[str] = field(default_factory=set)
    _recent: list[Array] = field(default_factory=list)

    def add(self, key: str, image: Array, baseline: Array | None, noise: float) -> None:
        """Take in a stored touch; `noise` (sensor's unit) is that of one taxel."""
        self.ids.append(key)
        self.variety.add(image, baseline, noise)

    def drop(self, key: str) -> None:
        """Leave a stored touch out."""
        number = self.ids.index(key)
        self.ids.pop(number)
        self.silent.discard(key)
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
        return sum(key not in self.silent for key in self.ids)

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
            "done": self.done,
            "stored": len(self.ids),
            "no_contact": [
                n for n, key in enumerate(self.ids, 1) if key in self.silent
            ],
            "n_new": self.variety.n_new,
            "map": self.variety.map(),
            "prompt": self.prompt,
        }
