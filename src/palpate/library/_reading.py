"""Reading touches back: their rows, images and columns; features made of them.

Features are computed once and kept beside the library. That is a cache and nothing
more: it lies in `features/`, one folder per encoder and version, of which the newest
are kept, and may be deleted at any time. Each file holds the ids of some touches and
their features; a damaged one is computed again.
"""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cached_property, partial
from math import prod
from pathlib import Path
from types import MappingProxyType
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._durable import replacing
from .._parallel import results_of
from .._types import FORMER, LAYOUT, Array, Floats, Indices
from ..touches import Labelled, Touches
from ._changes import Names
from ._content import (
    CELLS,
    PICTURE,
    Column,
    Image,
    column_array,
    image_digest,
    unpacked_array,
)
from ._rows import (
    LOST,
    Numbers,
    StoredImage,
    StoredTouch,
    Tables,
    n_at_once,
    plain_values,
    rows_at,
    stored_images,
    wide_values,
)
from ._store import FEATURES, LibraryError, room_for

IN_MEMORY = 256 * 2**20  # bytes of images; more are mapped to a file
NO_LIMIT = 2**62  # SQLite counts with 63 bits
_TASKS_PER_FILE = 16  # of features, written when they are done
_ENCODERS_KEPT = 16  # folders of features: more than the folds of an evaluation
_ID = "S16"  # a last byte of zero is no matter among equals
Encode = Callable[[Touches], Floats]


def common_kind(
    tables: Tables, keys: Sequence[int]
) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Return the shape and type of all images of recordings, or what is mixed."""
    recordings = [tables.recording(key) for key in dict.fromkeys(keys)]
    kinds = sorted({(r.image_shape, r.dtype.str) for r in recordings})
    if not kinds:
        raise LibraryError(
            "The selection must hold at least one touch, got none. "
            "See `TouchLibrary.list`, and widen the filter."
        )
    if len(kinds) > 1:
        listed = "; ".join(f"{' x '.join(map(str, s))} {dtype}" for s, dtype in kinds)
        mixed = len({len(shape) for shape, _ in kinds}) > 1
        condition = "n_channels is null" if mixed else f"n_rows = {kinds[0][0][0]}"
        raise LibraryError(
            f"Touches must have one image size and type, got {listed}. Choose one with "
            f'a filter (`where`), for example "sensor = NAME" or "{condition}".'
        )
    for name in ("channels", "pads"):
        if len({_entries(r.whole).get(name) for r in recordings}) > 1:
            raise LibraryError(
                f"Touches must have the same {name}, got several. Choose those of one "
                'sensor or session with a filter, for example "sensor = NAME".'
            )
    return recordings[0].image_shape, recordings[0].dtype


def newest_no_contact(tables: Tables, recordings: Iterable[int]) -> Array | None:
    """Return the first no-contact image of recordings, the newest first, or None.

    One that is missing or altered is passed over with a warning.
    """
    for key in recordings:
        digest = tables.recording(key).whole.get("no_contact")
        if digest is not None:
            image = read_array(tables, "no_contact", digest)
            if image is not None:
                return image
    return None


class Selection(Labelled):
    """Touches of a library without their images, in the order added.

    Made by `TouchLibrary.select`; the library must stay open. What is added later is
    not in it, and objects that are renamed later keep their names in it.
    """

    def __init__(
        self,
        tables: Tables,
        numbers: Numbers,
        called: Names | None = None,
        rest: Array | None = None,
    ) -> None:
        self.tables, self.numbers = tables, numbers
        self._called, self._rest = called or tables.names(), rest
        sql = "SELECT DISTINCT recording, layout FROM touches WHERE number IN (?)"
        rows = tables.store.among(sql, numbers.tolist())
        self._recordings = list(dict.fromkeys(row[0] for row in rows))
        self._layouts = {key: tables.layout(key) for key in {row[1] for row in rows}}
        self.kind = common_kind(tables, self._recordings)

    def __len__(self) -> int:
        return len(self.numbers)

    def __repr__(self) -> str:
        return f"<Selection: {len(self)} touches of {str(self.tables.store.folder)!r}>"

    def __getitem__(self, rows: ArrayLike) -> Selection:
        """Pick touches by their places, which must rise; no image is read."""
        chosen = self.numbers[self._rising(rows, len(self))]
        return Selection(self.tables, chosen, self._called, self._rest)

    @cached_property
    def columns(self) -> Mapping[str, Array]:
        """Columns of short values, one row per touch."""
        return MappingProxyType(self.read_columns())

    @property
    def touch_id(self) -> NDArray[np.str_]:
        """Id of each touch, shape (n_touches,): 32 hexadecimal digits."""
        return np.array([key.hex() for key in self._cells("id")])

    @property
    def no_contact(self) -> Array | None:
        """The newest no-contact image of these touches, or None."""
        if self._rest is not None:
            return self._rest
        newest_first = dict.fromkeys(reversed(self.recordings()))
        return newest_no_contact(self.tables, newest_first)

    def resting_at(self, frame: Array) -> Selection:
        """Return these touches as if the sensor had rested at a frame in all of them.

        Images are floats: each less the no-contact image of its recording, where that
        has one of this size, and more the `frame`. Where all rest there it is `self`.
        """
        moved = Selection(self.tables, self.numbers, self._called, np.asarray(frame))
        return moved if any(move.any() for move in moved._moves.values()) else self

    @cached_property
    def _moves(self) -> dict[int, Floats]:
        """What brings the images of a recording to the frame they are to rest at."""
        if (rest := self._rest) is None:
            return {}
        moves, by_digest = {}, dict[str | None, Floats | None]()
        for key in self._recordings:
            digest = _entries(self.tables.recording(key).whole).get("no_contact")
            if digest not in by_digest:
                own_rest = newest_no_contact(self.tables, [key])
                by_digest[digest] = self._move(rest, own_rest)
            if (move := by_digest[digest]) is not None:
                moves[key] = move
        return moves

    def recordings(self) -> list[int]:
        """Return the key of each touch's recording."""
        return self._cells("recording")

    def _cells(self, column: str) -> list[Any]:
        sql = f"SELECT {column} FROM touches WHERE number IN (?) ORDER BY number"
        return [row[0] for row in self.tables.store.among(sql, self.numbers.tolist())]

    def channels(self) -> tuple[str, ...] | None:
        """Return the names of the images' channels, or None without such an axis."""
        entries = _entries(self.tables.recording(self._recordings[0]).whole)
        if "channels" not in entries:
            return None
        return tuple(stored_array(self.tables, entries["channels"]).tolist())

    def files(self) -> list[bytes | None]:
        """Return the picture that each image came as, None where it did not."""
        images = (stored.image for stored in self.stored())
        return [
            image.data if image and image.form == PICTURE else None for image in images
        ]

    def has_pictures(self) -> bool:
        """Tell whether any of the images came as a picture."""
        sql = f"SELECT 1 FROM images WHERE form = '{PICTURE}' AND number IN (?)"
        return bool(self.tables.store.among(sql, self.numbers.tolist()))

    def stored(self) -> Iterator[StoredImage]:
        """Return the images as they are stored."""
        for rows in rows_at(self.tables, self.numbers, called=self._called):
            yield from stored_images(self.tables, rows)

    def touches(
        self,
        rows: ArrayLike | None = None,
        *,
        max_bytes: int = NO_LIMIT,
        in_memory: int = IN_MEMORY,
        of: Selection | None = None,
    ) -> Touches:
        """Read all of the touches, or some, given by their places in the selection.

        Places must rise; each is read once. Large images are in a mapped file. With
        those `of` which these are a part, columns are as for `read_columns`.
        """
        picked = self if rows is None else self[rows]
        size, dtype = picked.kind
        shape = (len(picked), *size)
        n_bytes = prod(shape) * dtype.itemsize
        if n_bytes > max_bytes:
            raise LibraryError(
                f"Images of {len(picked)} touches must take at most {max_bytes} bytes, "
                f"got {n_bytes}. Choose fewer with a filter, or raise max_bytes."
            )
        if n_bytes > in_memory:
            folder = self.tables.store.folder
            is_writable = os.access(folder, os.W_OK)
            scratch = folder if is_writable else Path(tempfile.gettempdir())
            with (
                room_for("images", scratch, "Free space, or choose fewer by a filter."),
                tempfile.TemporaryFile(dir=scratch) as file,  # the mapping keeps it
            ):
                _take_room(file.fileno(), n_bytes)
                images: Array = np.memmap(file, dtype=dtype, mode="w+", shape=shape)
        else:
            images = np.empty(shape, dtype)
        columns, whole = picked.read_columns(images, of), picked.whole
        if self._rest is not None:
            images = images.astype(_moved_kind(images.dtype))
            whole["no_contact"] = self._rest
            keys = np.array(picked.recordings())
            for key, move in self._moves.items():
                images[keys == key] += move.astype(images.dtype)
        return Touches._parted(images, columns, whole)

    def parts(self) -> Iterator[Touches]:
        """Yield touches as they were added, of one recording and the same columns.

        They come some at a time, pictures with their files.
        """
        step = n_at_once(*self.kind)
        for start in range(0, len(self), step):
            chunk = self[np.arange(start, min(start + step, len(self)))]
            kinds = [*zip(chunk.recordings(), chunk._cells("layout"), strict=True)]
            for kind in dict.fromkeys(kinds):
                part = chunk[[i for i, each in enumerate(kinds) if each == kind]]
                files = [file for file in part.files() if file is not None]
                kept = files if len(files) == len(part) else None
                yield part.touches()._with_files(kept)

    def read_columns(
        self, images: Array | None = None, of: Selection | None = None
    ) -> dict[str, Array]:
        """Return columns and fill `images`; without these, short columns alone.

        With those `of` which these are a part, the columns that all of them have, in
        the types that they have there.
        """
        layouts = (self if of is None else of)._layouts
        columns = _columns_of(layouts)
        if images is None:
            columns = {n: c for n, c in columns.items() if _is_short(n, c)}
        beside = any(column.wide for alike in columns.values() for column in alike)
        parts: dict[str, list[Array]] = {name: [] for name in columns}
        done = 0
        for rows in rows_at(self.tables, self.numbers, called=self._called):
            values = plain_values(rows)
            if images is not None:
                self._read_images(images[done : done + len(rows)], rows, values)
                done += len(rows)
            elif beside:
                stored = stored_images(self.tables, rows)
                for value, image in zip(values, stored, strict=True):
                    value |= wide_values(self.tables, image)
            for name, alike in columns.items():
                cells = [value.get(name) for value in values]
                parts[name].append(column_array(alike, cells))
        joined = {name: _joined(arrays) for name, arrays in parts.items()}
        lacking = set() if of is None else _lacking(layouts) & joined.keys()
        if "category" in lacking:  # of some alone it is none
            lacking.remove("category")
            del joined["category"]
        for name in lacking:
            blank = column_array(columns[name], [None])
            joined[name] = _joined([joined[name], blank])[:-1]
        return _labelled(joined)

    def _read_images(
        self, images: Array, rows: list[StoredTouch], values: list[dict[str, Any]]
    ) -> None:
        """Fill `images`, and add what rows have in wide columns to their `values`."""
        for place, stored in enumerate(stored_images(self.tables, rows)):
            images[place] = stored.unpacked()
            values[place] |= wide_values(self.tables, stored)

    @property
    def whole(self) -> dict[str, Array]:
        """What is the same for all touches, by name; see `Touches`.

        Of arrays that are lost or altered it warns.
        """
        recordings = [self.tables.recording(key) for key in self._recordings]
        geometries = {recording.geometry for recording in recordings}
        names = sorted(geometry for geometry in geometries if geometry is not None)
        if len(names) > 1:
            raise LibraryError(
                f"Touches must have one geometry, got {', '.join(names)}. Choose one "
                'with a filter, for example "geometry = array".'
            )
        entries = [_entries(recording.whole) for recording in recordings]
        first = entries[0].items()
        same = {n: h for n, h in first if all(e.get(n) == h for e in entries)}
        read = {n: read_array(self.tables, n, h) for n, h in same.items()}
        whole = {n: array for n, array in read.items() if array is not None}
        if "pads" not in whole:  # names of pads that are lost name nothing
            whole.pop("pad_names", None)
        shape, _ = self.kind
        if len(shape) == 3 and "channels" not in whole:  # their numbers, once lost
            whole["channels"] = np.arange(shape[2]).astype(np.str_)
        if len(geometries) == 1 and None not in geometries:
            whole["geometry"] = np.array(geometries.pop())
        return whole

    def features(self, key: str, encode: Encode) -> Floats:
        """Return features of all touches, (n_touches, n_features).

        New touches are encoded some 512 at a time through joblib, so that
        `joblib.parallel_config` decides where. Workers get the stored bytes of images,
        not the library.

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
        if self._rest is not None:
            key += "rested"
        cache = self.tables.store.folder / FEATURES / key
        ids = np.array(self._cells("id"), _ID)
        cached_ids, cached = _cached(cache)
        kept = np.isin(ids, cached_ids)
        if kept.all():
            return cached[np.searchsorted(cached_ids, ids)]
        new = self._encode_new(cache, encode, np.flatnonzero(~kept), ids[~kept])
        if len(cached) and cached.shape[1] != new.shape[1]:  # of another encoding
            return self.features(key, encode)
        features = np.empty((len(ids), new.shape[1]))
        features[~kept] = new
        if kept.any():
            features[kept] = cached[np.searchsorted(cached_ids, ids[kept])]
        return features

    def _encode_new(
        self, cache: Path, encode: Encode, rows: Indices, ids: Array
    ) -> Floats:
        """Return new features; what is done is kept now and then, should this stop."""
        layout = {n: a for n, a in self.whole.items() if n in LAYOUT}
        moves = None if self._rest is None else self._moves
        encode_some = partial(_encoded, encode, layout, moves)
        new = self[rows]
        step = n_at_once(*new.kind)

        def stored(number: int) -> list[list[StoredImage]]:
            stop = min((number + 1) * step, len(new))
            return [list(new[np.arange(number * step, stop)].stored())]

        parts = results_of(encode_some, -(-len(new) // step), stored)
        waiting: list[Floats] = []
        written: list[Floats] = []
        n_kept = n_done = 0
        for number, part in enumerate(parts, start=1):
            waiting.append(part)
            n_done += len(part)
            if number % _TASKS_PER_FILE == 0 or n_done == len(ids):
                written.append(np.concatenate(waiting))
                _keep(cache, ids[n_kept:n_done], written[-1])
                waiting, n_kept = [], n_done
        return np.concatenate(written)


def _take_room(handle: int, n_bytes: int) -> None:
    """Take room for a mapping, which ends the program where the disk fills later."""
    try:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(handle, 0, n_bytes)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # of the file system
            raise


def sound_numbers(tables: Tables, numbers: Numbers) -> Numbers:
    """Return the touches whose rows and images are whole; tell of those left out."""
    rows = [row for part in rows_at(tables, numbers, "skip") for row in part]
    whole = [row.number for row in rows if whole_image(tables, row)]
    if len(whole) < len(rows):
        warnings.warn(
            f"{len(rows) - len(whole)} touches are left out: their images in "
            f"{tables.store.path} are missing or altered.",
            stacklevel=4,
        )
    return np.array(whole, dtype=np.int64)


def whole_image(tables: Tables, row: StoredTouch) -> Image | None:
    """Return the image of a touch, None where it or a wide column cannot be read."""
    try:
        [stored] = stored_images(tables, [row])  # its page may be damaged too
        stored.unpacked()
        wide_values(tables, stored)
    except LibraryError:
        return None
    return stored.image


def _entries(whole: dict[str, str]) -> dict[str, str]:
    """Return the digests of arrays by what they hold, some under former names."""
    return {FORMER.get(n, n): digest for n, digest in whole.items()}


def read_array(tables: Tables, entry: str, digest: str) -> Array | None:
    """Return an array of whole recordings, or warn and return None where it is lost."""
    try:
        return stored_array(tables, digest)
    except LibraryError as error:
        warnings.warn(
            f"{error} Touches are read without their {entry}, {digest[:12]}; adding "
            "them again brings it back. `check_library` lists them.",
            stacklevel=2,
        )
        return None


def stored_array(tables: Tables, digest: str) -> Array:
    """Return an array of whole recordings by its digest, which is compared."""
    sql = "SELECT content FROM arrays WHERE digest = ?"
    row = tables.store.first_row(sql, [bytes.fromhex(digest)])
    got = "none"
    if row is not None and row[0] != LOST:
        got = "altered bytes"
        with suppress(LibraryError):
            array = unpacked_array(row[0])
            if image_digest(array).hex() == digest:
                return array
    raise LibraryError(
        f"{tables.store.path} must hold array {digest[:12]} as it was added, got {got}."
    )


def _columns_of(layouts: dict[int, list[Column]]) -> dict[str, list[Column]]:
    """Return all forms of each column; those of unlike shapes or kinds are refused."""
    columns: dict[str, list[Column]] = {}
    forms = dict.fromkeys(column for layout in layouts.values() for column in layout)
    for column in forms:
        columns.setdefault(column.name, []).append(column)
    for name, alike in columns.items():
        kinds = {np.dtype(column.dtype).kind for column in alike}
        mixed = len(kinds) > 1 and kinds & {*"Mm"} and "U" not in kinds
        if mixed or len({column.shape for column in alike}) > 1:
            listed = " and ".join(f"{c.shape} of {c.dtype}" for c in alike)
            raise LibraryError(
                f"Column {name!r} must have one shape a row, and be of times or of "
                f"other values, got {listed}. Choose touches with a filter."
            )
    return columns


def _is_short(name: str, alike: list[Column]) -> bool:
    """Tell whether a column is of short values; those of dates and bytes are no cells.

    They stand beside the row, and are read with it where palpate knows the column.
    """
    is_known = name in CELLS and not any(column.shape for column in alike)
    return all(not c.wide or (is_known and c.dtype[1] in "MmS") for c in alike)


def _lacking(layouts: dict[int, list[Column]]) -> set[str]:
    """Return the names of columns that only some touches have."""
    names = [{column.name for column in layout} for layout in layouts.values()]
    every_name = names[0].union(*names)
    return every_name - every_name.intersection(*names)


def _joined(arrays: list[Array]) -> Array:
    if len({array.dtype.kind == "U" for array in arrays}) > 1:
        arrays = [array.astype(np.str_) for array in arrays]
    return np.concatenate(arrays)


def _labelled(columns: dict[str, Array]) -> dict[str, Array]:
    """Refuse touches of which only some have an object."""
    for name in ("object", "category"):
        lacking = name in columns and (columns[name] == "").any()
        if lacking and name == "object" and (columns[name] != "").any():
            raise LibraryError(
                "Either all touches must have an object or none, got "
                f"{int((columns[name] == '').sum())} without. Leave those out with "
                'the filter "object is not null".'
            )
        if lacking:
            del columns[name]
    return columns


def _cached(cache: Path) -> tuple[Array, Floats]:
    """Return all ids in the cache, sorted, and their features."""
    ids, features = [np.empty(0, _ID)], []
    for path in sorted(cache.glob("*.npz")):
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as kept:
                ids_in, values = kept["ids"], kept["x"]
            if ids_in.dtype != _ID or len(values) != len(ids_in) or values.ndim != 2:
                raise ValueError("no features")
        except (
            *(OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile),
            RuntimeError,  # zipfile, of a flag or a method that a bit has changed
        ):
            path.unlink(missing_ok=True)
            continue
        ids.append(ids_in)
        features.append(values)
    if len({values.shape[1] for values in features}) > 1:  # one is of another encoding
        for path in cache.glob("*.npz"):
            path.unlink(missing_ok=True)
        return ids[0], np.empty((0, 0))
    joined_ids = np.concatenate(ids)
    order = np.argsort(joined_ids, kind="stable")
    joined = np.concatenate(features) if features else np.empty((0, 0))
    return joined_ids[order], joined[order]


def _keep(cache: Path, ids: Array, features: Floats) -> None:
    """Add features to the cache, or warn where there is no room or no leave."""
    try:
        if not cache.exists():  # each lesson has another encoder
            cache.mkdir(parents=True, exist_ok=True)
            others = sorted(cache.parent.iterdir(), key=lambda p: p.stat().st_mtime)
            for oldest in others[:-_ENCODERS_KEPT]:
                shutil.rmtree(oldest, ignore_errors=True)
        with replacing(cache / f"{uuid4().hex}.npz") as file:
            np.savez(file, ids=ids, x=features)
    except OSError as error:
        warnings.warn(
            f"{cache.parent} must be a folder with room to keep features in, got: "
            f"{error.strerror or error}. Nothing is lost: they will be made again.",
            stacklevel=2,
        )


def _encoded(
    encode: Encode,
    layout: dict[str, Array],
    moves: dict[int, Floats] | None,
    stored: list[StoredImage],
) -> Floats:
    """Encode some touches; runs wherever joblib sends it, without the database."""
    dtype = stored[0].dtype if moves is None else _moved_kind(stored[0].dtype)
    images = np.empty((len(stored), *stored[0].shape), dtype)
    for place, image in enumerate(stored):
        images[place] = image.unpacked()
        if moves and image.row.recording in moves:
            images[place] += moves[image.row.recording].astype(dtype)
    return np.asarray(encode(Touches(images, **layout)), dtype=np.float64)


def _moved_kind(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Return what images are held in that were moved to another frame: floats."""
    return np.result_type(dtype, np.float32)
