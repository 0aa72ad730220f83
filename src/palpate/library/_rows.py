"""The table of touches: one function writes its rows, one reads them and compares.

Every row has a digest of its values, which is compared when it is read; so are the
recording and the layout that it names, and the name that its object has now with the
one it was added by and the changes since.
"""

import json
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._checks import check_option, listed
from .._types import Array
from ._changes import Names
from ._content import (
    CELLS,
    PICTURE,
    Column,
    Image,
    canonical,
    digest_of,
    identity,
    image_digest,
    packed_array,
    unpacked_image,
    unpacked_rows,
    wide_identities,
)
from ._store import (
    AT_ONCE,
    REPAIR,
    DatabaseDamaged,
    LibraryError,
    Store,
    chained,
    from_json,
    placeholders,
)

Numbers = NDArray[np.int64]
LOST = b""  # an array that a repair did not find whole
_IDS_LISTED = 20  # ids of a message that are listed
_BYTES_AT_ONCE = 64 * 2**20  # of images, some MiB in memory
RECORDED = ("sensor", "kind", "unit", "pitch_mm", "geometry")
_SIZES = ("n_rows", "n_cols", "n_channels", "dtype", "whole")
# The name of each touch's object today, after merges.
OBJECT_NAMES = (
    "LEFT JOIN objects given ON given.id = t.object "
    "LEFT JOIN objects o ON o.id = coalesce(given.merged_into, given.id) "
)
FROM = f"FROM touches t JOIN recordings r ON r.id = t.recording {OBJECT_NAMES}"
_LISTED = ", ".join(f't."{name}"' for name in CELLS[1:])
_NAMED = f"FROM touches t {OBJECT_NAMES}"
_WRITTEN = (
    *("number", "id", "label", "object", "layout", "recording", "added_s", "image"),
    *("content", "digest", "extra", *(f'"{name}"' for name in CELLS[1:])),
)
_INSERT = (
    f"INSERT INTO touches ({', '.join(_WRITTEN)}) VALUES {placeholders(len(_WRITTEN))}"
)


class Recording(NamedTuple):
    """A recording: entries that are the same for all of its touches."""

    digest: bytes
    sensor: str | None
    kind: str | None
    unit: str | None
    pitch_mm: float | None
    geometry: str | None
    image_shape: tuple[int, ...]
    dtype: np.dtype[Any]
    whole: dict[str, str]

    def cells(self) -> dict[str, Any]:
        """Return what its row holds."""
        sides = [*self.image_shape, None][:3]  # without channels there is no third
        cells = *self[1:6], *sides, self.dtype.str, canonical(self.whole)
        row = dict(zip((*RECORDED, *_SIZES), cells, strict=True))
        return {**row, "digest": digest_of(cells)}


class StoredTouch(NamedTuple):
    """A touch's row: who it is, where it belongs, and its plain values.

    `name` is the object's present name and `label` the one it was added by; `layout`
    and `recording` are keys; `image` and `content` are the digests of the image and of
    the bytes it is kept as, `digest` that of the row. `cells` stand in the order of
    `CELLS`, the object's present name first.
    """

    number: int
    key: bytes
    label: str | None
    name: str | None
    layout: int
    recording: int
    added_s: float
    image: bytes
    content: bytes
    digest: bytes
    retraction: int | None
    extra: str | None
    cells: tuple[Any, ...]

    @property
    def shown(self) -> str:
        """Its id in messages, or its number where that is altered."""
        is_id = isinstance(self.key, bytes)
        return self.key.hex() if is_id else f"number {self.number}"

    def as_called(self, names: Names) -> "StoredTouch":
        """Return itself with the name that its object had when `names` were read."""
        name = names.now(self.label, self.number)
        return self._replace(name=name, cells=(name, *self.cells[1:]))


class Batch(NamedTuple):
    """Some touches made ready to be stored together, of one layout and recording.

    Numbers, keys of other tables and the digests of `rows` are those that they get.
    `arrays` holds the recording's by digest, None those that are lost.
    """

    layout: list[Column]
    recording: Recording
    arrays: dict[bytes, Array | None]
    rows: list[StoredTouch]
    images: list[Image]

    def picked(self, places: Sequence[int]) -> "Batch":
        return self._replace(
            rows=[self.rows[i] for i in places], images=[self.images[i] for i in places]
        )


class Tables:
    """The small tables that rows refer to, each entry compared when first read."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self._recordings: dict[int, Recording] = {}
        self._layouts: dict[int, tuple[str, list[Column]]] = {}
        self._names: tuple[int, Names] | None = None

    def recording(self, key: int) -> Recording:
        if key not in self._recordings:
            columns = ", ".join((*RECORDED, *_SIZES))
            sql = f"SELECT digest, {columns} FROM recordings WHERE id = ?"
            row = self.store.first_row(sql, [key])
            if row is None or digest_of(row[1:]) != row[0]:
                raise self._damaged("recordings", key)
            n_rows, n_cols, n_channels, dtype, whole = row[6:]
            shape = tuple(n for n in (n_rows, n_cols, n_channels) if n is not None)
            fields = (*row[:6], shape, np.dtype(dtype), from_json(whole))
            self._recordings[key] = Recording._make(fields)
        return self._recordings[key]

    def layout(self, key: int) -> list[Column]:
        return self._layout(key)[1]

    def _layout(self, key: int) -> tuple[str, list[Column]]:
        if key not in self._layouts:
            sql = "SELECT columns FROM layouts WHERE id = ?"
            row = self.store.first_row(sql, [key])
            try:
                text = str(row[0]) if row else ""
                self._layouts[key] = text, Column.all_of(text)
            except (ValueError, TypeError) as error:
                raise self._damaged("layouts", key) from error
        return self._layouts[key]

    def names(self) -> Names:
        """Return what objects were called and are called."""
        n_changes = self.store.count("SELECT count(*) FROM changes")
        if self._names is None or self._names[0] != n_changes:
            self._names = n_changes, Names(self.store)
        return self._names[1]

    def is_sound(self, row: StoredTouch, names: Names | None) -> bool:
        """Tell whether a row is as it was written, and so what it refers to.

        With `names`, also whether its object is called what the changes say.
        """
        try:
            recording = self.recording(row.recording).digest
            digest = _row_digest(row, self._layout(row.layout)[0], recording)
        except (DatabaseDamaged, TypeError):
            return False
        if digest != row.digest:
            return False
        return names is None or names.now(row.label, row.number) == row.name

    def _damaged(self, table: str, key: int) -> DatabaseDamaged:
        return DatabaseDamaged(
            f"{self.store.path} must be as it was written, got another row {key} of "
            f"{table}. {REPAIR}"
        )


def rows_at(
    tables: Tables,
    numbers: Sequence[int] | Numbers,
    damaged: str = "raise",
    called: Names | None = None,
) -> Iterator[list[StoredTouch]]:
    """Return the rows of touches by their rising numbers, some at a time.

    Objects have the names `called`, by default those of when it begins: others may
    rename them meanwhile. Rows that are not as they were written are refused, or left
    out and told of.
    """
    check_option("damaged", damaged, ("raise", "skip"))
    called = called or tables.names()
    bad: list[str] = []
    for start in range(0, len(numbers), AT_ONCE):
        piece = [int(number) for number in numbers[start : start + AT_ONCE]]
        where = f"WHERE t.number IN {placeholders(len(piece))} ORDER BY t.number"
        with tables.store.moment():
            names = tables.names()
            rows = stored_touches(tables.store, where, piece)
        sound = [row for row in rows if tables.is_sound(row, names)]
        intact = {row.number for row in sound}
        bad += [_key_of(rows, number) for number in piece if number not in intact]
        if bad and damaged == "raise":
            raise LibraryError(
                f"Rows of touches must be as they were written, got others: "
                f"{listed(bad, _IDS_LISTED)}. `TouchLibrary.repair_folder` keeps the "
                'rest; damaged="skip" leaves them out.'
            )
        yield sound if names is called else [row.as_called(called) for row in sound]
    if bad:
        warnings.warn(
            f"{len(bad)} touches are left out, since their rows in {tables.store.path} "
            f"are damaged: {listed(bad, _IDS_LISTED)}.",
            stacklevel=4,
        )


def stored_touches(
    store: Store, tail: str, values: Sequence[Any] = (), *, named: bool = True
) -> list[StoredTouch]:
    """Return the rows of touches, not compared; `tail` is the query from WHERE on.

    Unless `named`, by the table of touches alone, without present names of objects.
    """
    alone = "NULL", "FROM touches t NOT INDEXED"
    name, source = ("o.name", _NAMED) if named else alone
    rows = store.rows(
        f"SELECT t.number, t.id, t.label, {name}, t.layout, t.recording, t.added_s, "
        f"t.image, t.content, t.digest, t.retraction, t.extra, {_LISTED} {source} "
        f"{tail}",
        values,
    )
    return [StoredTouch._make((*row[:12], (row[3], *row[12:]))) for row in rows]


def _key_of(rows: Sequence[StoredTouch], number: int) -> str:
    return next((r.shown for r in rows if r.number == number), f"number {number}")


class StoredImage(NamedTuple):
    """The image of a touch, None where there is none, as the database keeps it.

    A worker that has no database makes an image of it.
    """

    row: StoredTouch
    image: Image | None
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    def unpacked(self) -> Array:
        """Return the image, compared with its digest, and its file or frames too."""
        stored = self.image
        got = "none"
        if stored is not None:
            got = "altered bytes"
            with suppress(LibraryError):
                image = unpacked_image(stored, self.shape, self.dtype)
                same = stored.form == PICTURE or image_digest(image) == self.row.image
                if same and stored.digest() == self.row.content:
                    return image
        raise LibraryError(
            f"Touch {self.row.key.hex()}: its image must be as it was added, got "
            f"{got}. `TouchLibrary.repair_folder` keeps all others."
        )


def n_at_once(shape: tuple[int, ...], dtype: np.dtype[Any]) -> int:
    """Return how many images of a size and type are held in memory at once."""
    n_bytes = prod(shape) * dtype.itemsize
    return max(1, min(AT_ONCE, _BYTES_AT_ONCE // max(1, n_bytes)))


def stored_images(tables: Tables, rows: Sequence[StoredTouch]) -> Iterator[StoredImage]:
    """Yield the stored images of touches with one size and type."""
    if not rows:
        return
    recording = tables.recording(rows[0].recording)
    step = n_at_once(recording.image_shape, recording.dtype)
    for start in range(0, len(rows), step):
        part = rows[start : start + step]
        sql = "SELECT number, form, image, more FROM images WHERE number IN (?)"
        numbers = [row.number for row in part]
        kept = {n: _image(*rest) for n, *rest in tables.store.among(sql, numbers)}
        for row in part:
            image = kept.get(row.number)
            yield StoredImage(row, image, recording.image_shape, recording.dtype)


def _image(form: Any, data: Any, more: Any) -> Image | None:
    kinds = isinstance(form, str) and isinstance(data, bytes)
    sound = kinds and (more is None or isinstance(more, bytes))
    return Image(form, data, more) if sound else None


def wide_values(tables: Tables, stored: StoredImage) -> dict[str, Array]:
    """Return what a touch has in each wide column."""
    if stored.image is None or stored.image.more is None:
        return {}
    return unpacked_rows(stored.image.more, tables.layout(stored.row.layout))


def plain_values(rows: Sequence[StoredTouch]) -> list[dict[str, Any]]:
    """Return all plain values of each touch by the name of their column."""
    extras = from_json(f"[{','.join(row.extra or '{}' for row in rows)}]")
    return [
        dict(zip(CELLS, row.cells, strict=True)) | extra
        for row, extra in zip(rows, extras, strict=True)
    ]


def new_rows(
    layout: Sequence[Column],
    plain: Sequence[dict[str, Any]],
    digests: Sequence[bytes],
    images: Sequence[Image],
    added_s: float,
) -> list[StoredTouch]:
    """Return rows to be written, of plain values and of the digests of images.

    `write_rows` digests what they are kept as: those stored already need none.
    """
    in_cells = {c.name for c in layout if c.shape == () and c.name in CELLS}
    names: list[Any] = [name if name in in_cells else None for name in CELLS]
    others = [c.name for c in layout if not c.wide and c.name not in in_cells]
    wide = wide_identities(layout, [image.more for image in images])
    rows = []
    for values, digest, part in zip(plain, digests, wide, strict=True):
        cells = tuple(map(values.get, names))
        text = canonical({n: values[n] for n in others}) if others else None
        belongs = 0, identity(digest, values, part), cells[0], None, 0, 0, added_s
        held = digest, b"", b"", None, text, cells
        rows.append(StoredTouch(*belongs, *held))
    return rows


def write_rows(
    store: Store, batch: Batch, numbers: Sequence[int] | None = None
) -> None:
    """Enter touches within a job; their images, layout and recording as well.

    `numbers` are those that they get, else the next ones.
    """
    tally = store.tally()
    last = store.count("SELECT max(number) FROM touches")
    taken = range(last + 1, last + 1 + len(batch.rows)) if numbers is None else numbers
    for digest, array in batch.arrays.items():
        enter_array(store, digest, array)
    layout_text = json.dumps([list(column) for column in batch.layout])
    layout = store.get_or_insert("layouts", {"columns": layout_text}, "columns")
    described = batch.recording.cells()
    recording = store.get_or_insert("recordings", described, "digest")
    labels = {row.label for row in batch.rows if row.label is not None}
    named = [(n, {"name": n}) for n in sorted(labels)]
    objects = {n: store.get_or_insert("objects", row, "name") for n, row in named}
    rows, digests = [], []
    for number, new, image in zip(taken, batch.rows, batch.images, strict=True):
        row = new._replace(content=image.digest())
        digests.append(_row_digest(row, layout_text, described["digest"]))
        belongs = objects.get(row.label or ""), layout, recording, row.added_s
        held = row.image, row.content, digests[-1], row.extra, *row.cells[1:]
        rows.append((number, row.key, row.label, *belongs, *held))
    store.run_many(_INSERT, rows)
    images = zip(taken, batch.images, strict=True)
    store.run_many(
        "INSERT INTO images VALUES (?, ?, ?, ?)", [(n, *image) for n, image in images]
    )
    chain = chained(tally.touches, digests)
    store.enter(tally._replace(n_touches=tally.n_touches + len(rows), touches=chain))


def enter_array(store: Store, digest: bytes, array: Array | None) -> None:
    """Enter an array where it lacks, or its place where it is lost."""
    sql = "SELECT 1 FROM arrays WHERE digest = ? AND content <> ?"
    if not store.first_row(sql, [digest, LOST]):
        content = LOST if array is None else packed_array(array)
        store.run("INSERT OR REPLACE INTO arrays VALUES (?, ?)", [digest, content])


def _row_digest(row: StoredTouch, layout: str, recording: bytes) -> bytes:
    identity = row.key, row.label, *row.cells[1:], row.extra, row.added_s
    return digest_of((*identity, row.image, row.content, layout, recording))
