"""Touches chosen from a library, read piece by piece, and their features.

Features are computed once and kept beside the library. That is a cache and nothing
more: it lies in `features/`, one folder per encoder and version, and may be deleted
at any time. Each file holds the ids of some touches and their features under the name
of its content; a damaged one is computed again.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._types import Array, Floats
from ..touches import FORMER, Touches
from ._array_files import packed, publish, read_file
from ._reading import common_kind, read_columns, read_images, read_touches, read_whole
from ._rows import Numbers, StoredTouch, rows_at
from ._store import FEATURES, LibraryError, Store, room_for

_TASKS_PER_FILE = 16
_ID = "S16"  # a last byte of zero is no matter among equals
Encode = Callable[[Touches], Floats]


class Selection:
    """Touches of a library without their images, in the order added.

    Made by `TouchLibrary.select`; the library must stay open. What is added later is
    not in it.

    Attributes
    ----------
    columns : dict of ndarray
        Columns of short values, one row per touch.
    """

    def __init__(self, store: Store, numbers: Numbers) -> None:
        self._store, self._numbers = store, numbers
        common_kind(store, numbers)
        self.columns = read_columns(store, numbers)

    def __len__(self) -> int:
        return len(self._numbers)

    def __repr__(self) -> str:
        return f"<Selection: {len(self)} touches of {str(self._store.folder)!r}>"

    @property
    def object(self) -> NDArray[np.str_] | None:
        """Label of each touch, shape (n_touches,), or None."""
        return self.columns.get("object")

    @property
    def category(self) -> NDArray[np.str_] | None:
        """Category of each touch, shape (n_touches,), or None."""
        return self.columns.get("category")

    @property
    def order(self) -> Array | None:
        """Position of each touch in its recording, shape (n_touches,), or None."""
        return self.columns.get("order")

    @property
    def session(self) -> Array | None:
        """Session of each touch, shape (n_touches,), or None."""
        return self.columns.get("session")

    @property
    def subject(self) -> Array | None:
        """Person or unit of each touch, shape (n_touches,), or None."""
        return self.columns.get("subject")

    @property
    def touch_id(self) -> NDArray[np.str_]:
        """Id of each touch, shape (n_touches,): 32 hexadecimal digits."""
        return np.array([key.hex() for key in self._ids()])

    @property
    def whole(self) -> dict[str, Array]:
        """What describes all of the touches alike, by name; see `Touches`."""
        return read_whole(self._store, self._numbers)

    def __getitem__(self, rows: ArrayLike) -> Selection:
        """Pick touches by their places, which must rise; no image is read."""
        return Selection(self._store, self._picked(rows))

    def touches(self, rows: ArrayLike) -> Touches:
        """Read some of the touches, given by their places in the selection.

        Places must rise; each is read once.
        """
        return read_touches(self._store, self._picked(rows))

    def features(self, key: str, encode: Encode) -> Floats:
        """Return features of all touches, (n_touches, n_features).

        New touches are encoded 512 at a time through joblib, so that
        `joblib.parallel_config` decides where. Workers read the images themselves:
        the folder must be found under the same path wherever they run.

        Parameters
        ----------
        key : str
            Letters and digits that stand for the encoder and all it has learnt;
            features under one key are computed once and then read.
        encode : callable
            Makes features (n, n_features) of `Touches`; called for what is new.
        """
        if not key.isalnum():
            raise ValueError(f"key must be letters and digits, got {key!r}.")
        cache = self._store.folder / FEATURES / key
        ids = np.array(self._ids(), _ID)
        known_ids, known = _cached(cache)
        missing = np.flatnonzero(~np.isin(ids, known_ids))
        if len(missing):
            numbers = self._numbers[missing]
            layout = {n: a for n, a in self.whole.items() if n in FORMER.values()}
            encode_some = partial(_encoded, self._store.folder, encode, layout)
            _encode_new(self._store, cache, numbers, ids[missing], encode_some)
            known_ids, known = _cached(cache)
        features: Floats = known[np.searchsorted(known_ids, ids)]
        return features

    def _ids(self) -> list[bytes]:
        sql = "SELECT id FROM touches WHERE number IN (?) ORDER BY number"
        return [row[0] for row in self._store.among(sql, self._numbers.tolist())]

    def _picked(self, rows: ArrayLike) -> Numbers:
        places = np.asarray(rows)
        if places.ndim != 1 or (len(places) > 1 and (np.diff(places) <= 0).any()):
            raise LibraryError(
                "rows must be places in the selection that rise, got others. "
                "Sort them and drop those that come twice."
            )
        picked: Numbers = self._numbers[places]
        return picked


def _cached(cache: Path) -> tuple[Array, Floats]:
    """Return all ids in the cache, sorted, and their features."""
    ids, features = [np.empty(0, _ID)], []
    for path in sorted(cache.glob("*/*.npy")):
        try:
            some_ids, some = read_file(cache, path.stem)
        except (LibraryError, ValueError):
            path.unlink(missing_ok=True)
            continue
        ids.append(np.ascontiguousarray(some_ids).view(_ID).ravel())
        features.append(some)
    every = np.concatenate(ids)
    order = np.argsort(every, kind="stable")
    joined = np.concatenate(features) if features else np.empty((0, 0))
    return every[order], joined[order]


def _encode_new(
    store: Store,
    cache: Path,
    numbers: Numbers,
    ids: Array,
    encode: Callable[[list[StoredTouch]], Floats],
) -> None:
    """Encode touches; what is done is kept now and then, should this be stopped."""
    from joblib import Parallel, delayed

    parts = Parallel(return_as="generator")(
        delayed(encode)(rows) for rows in rows_at(store, numbers)
    )
    waiting: list[Floats] = []
    n_kept = n_done = 0
    for number, part in enumerate(parts, start=1):
        waiting.append(part)
        n_done += len(part)
        if number % _TASKS_PER_FILE == 0 or n_done == len(ids):
            plain = ids[n_kept:n_done].view(np.uint8).reshape(-1, 16)
            content = packed([plain, np.concatenate(waiting)])
            with room_for("features", cache, "Free space; touches are not affected."):
                cache.mkdir(parents=True, exist_ok=True)
                publish(cache, content)
            waiting, n_kept = [], n_done


def _encoded(
    folder: Path, encode: Encode, layout: dict[str, Array], rows: list[StoredTouch]
) -> Floats:
    """Encode some touches; runs wherever joblib sends it, without the database."""
    touches = Touches(read_images(folder, rows), **layout)
    return np.asarray(encode(touches), dtype=np.float64)
