"""Features of stored touches: computed once, kept beside the library.

A cache and nothing more: it lies in `features/`, one folder per encoder and version,
and may be deleted at any time. Each file holds the ids of some touches and their
features under the name of its content; a damaged one is computed again.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..touches import Touches
from ._database import Database
from ._errors import LibraryError
from ._files import packed, publish, read_file
from ._query import AT_ONCE
from ._reading import Place, Shape, common_shape, images_at, places_of

FEATURES = "features"
TASKS_PER_FILE = 16
Floats = NDArray[np.float64]
Encode = Callable[[Touches], Floats]


def stored_features(
    database: Database,
    folder: Path,
    numbers: NDArray[np.int64],
    key: str,
    encode: Encode,
) -> Floats:
    """Return features of touches, (n_touches, n_features), encoding what is new.

    New touches are encoded `AT_ONCE` at a time through joblib, so that
    `joblib.parallel_config` decides where. Workers read the images themselves: the
    folder must be found under the same path wherever they run.
    """
    if not key.isalnum():
        raise ValueError(f"key must be letters and digits, got {key!r}.")
    place = folder / FEATURES / key
    ids = _ids(database, numbers)
    known_ids, known = _cached(place)
    missing = np.flatnonzero(~np.isin(ids, known_ids))
    if len(missing):
        new = numbers[missing]
        _encode_new(database, folder, place, new, ids[missing], encode)
        known_ids, known = _cached(place)
    found = np.searchsorted(known_ids, ids)
    features: Floats = known[found]
    return features


def touch_ids(database: Database, numbers: NDArray[np.int64]) -> NDArray[np.str_]:
    """Return the ids of touches as `add` returned them, (n_touches,)."""
    return np.array([key.tobytes().hex() for key in _ids(database, numbers)])


def _ids(database: Database, numbers: NDArray[np.int64]) -> NDArray:
    """Return the ids of touches as 16-byte values that sort."""
    known: list[bytes] = []
    for start in range(0, len(numbers), AT_ONCE):
        piece = numbers[start : start + AT_ONCE].tolist()
        marks = ", ".join("?" * len(piece))
        sql = f"SELECT id FROM touches WHERE number IN ({marks}) ORDER BY number"
        known += [row[0] for row in database.rows(sql, piece)]
    return _sortable(np.frombuffer(b"".join(known), dtype=np.uint8).reshape(-1, 16))


def _cached(place: Path) -> tuple[NDArray, Floats]:
    """Return all ids in the cache, sorted, and their features."""
    ids, features = [_sortable(np.empty((0, 16), np.uint8))], []
    for path in sorted(place.glob("*/*.npy")):
        try:
            some_ids, some = read_file(place, path.stem)
        except (LibraryError, ValueError):
            path.unlink(missing_ok=True)
            continue
        ids.append(_sortable(some_ids))
        features.append(some)
    every = np.concatenate(ids)
    order = np.argsort(every, kind="stable")
    joined = np.concatenate(features) if features else np.empty((0, 0))
    return every[order], joined[order]


def _encode_new(
    database: Database,
    folder: Path,
    place: Path,
    numbers: NDArray[np.int64],
    ids: NDArray,
    encode: Encode,
) -> None:
    from joblib import Parallel, delayed

    shape = common_shape(database, numbers)
    starts = range(0, len(numbers), AT_ONCE)
    parts = Parallel(return_as="generator")(
        delayed(_encoded)(
            folder,
            places_of(database, numbers[s : s + AT_ONCE].tolist()),
            shape,
            encode,
        )
        for s in starts
    )
    waiting: list[Floats] = []
    first = 0
    for number, part in enumerate(parts, start=1):
        waiting.append(part)
        if len(waiting) == TASKS_PER_FILE or number == len(starts):
            first = _put(place, ids, waiting, first)
            waiting = []


def _encoded(folder: Path, places: list[Place], shape: Shape, encode: Encode) -> Floats:
    """Encode some touches; runs wherever joblib sends it, without the database."""
    images = images_at(folder, places, shape)
    return np.asarray(encode(Touches(images)), dtype=np.float64)


def _put(place: Path, ids: NDArray, parts: Sequence[Floats], first: int) -> int:
    features = np.concatenate(parts)
    last = first + len(features)
    plain = np.ascontiguousarray(ids[first:last]).view(np.uint8).reshape(-1, 16)
    try:
        place.mkdir(parents=True, exist_ok=True)
        publish(place, packed([plain, features]))
    except OSError as error:
        raise LibraryError(
            f"{place} must have room for features, got: {error.strerror or error}. "
            "Free space; touches are not affected."
        ) from error
    return last


def _sortable(ids: NDArray[np.uint8]) -> NDArray:
    """See 16 bytes as one text; a last byte of zero is no matter among equals."""
    return np.ascontiguousarray(ids).view("S16").ravel()
