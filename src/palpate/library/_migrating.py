"""Libraries of format 1 and 2, of palpate 0.2 and older, made into one of today.

Those kept images in `.npy` files named by the SHA-256 of their bytes, several touches
in one file, and each change in a JSON file; a SQLite database knew where each was. The
old folder is only read. Ids, order, times, names and retractions stay as they are.
"""

import hashlib
import io
import json
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from itertools import groupby
from math import prod
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib import format as npy

from .._durable import flush_folder
from .._parallel import Progress
from .._types import Array
from ._changes import Change
from ._content import (
    CELLS,
    MAX_HEADER,
    Column,
    identity,
    image_digest,
    packed_rows,
    packs_well,
    stored_image,
    wide_identities,
)
from ._rows import OBJECT_NAMES, RECORDED, Batch, Recording, new_rows
from ._store import (
    FILE_NAME,
    OLD_VERSIONS,
    LibraryError,
    Store,
    make_folder,
    refuse_used,
)
from ._upkeep import enter_all

_BEGUN = ".migrating.sqlite"
_AT_ONCE = 256  # touches in one transaction
_ROWS = (
    "SELECT t.number, t.id, given.name AS label, "
    + ", ".join(f't."{name}"' for name in CELLS[1:])
    + ", t.extra, l.columns, t.recording, f.name AS file, f.offset, t.place, t.image, "
    "t.added_s FROM touches t JOIN layouts l ON l.id = t.layout "
    "JOIN files f ON f.id = t.file LEFT JOIN objects given ON given.id = t.object "
    "WHERE t.number > ? ORDER BY t.number LIMIT ?"
)
_IDS = "SELECT number, id FROM touches ORDER BY number"
_COMMON = ("columns", "recording", "file", "added_s")  # to touches of one batch
# What both formats say of each touch, to be compared at the end.
_STATE = (
    "SELECT t.number, t.id, o.name, json_extract(c.content, '$.reason') FROM touches t "
    f"{OBJECT_NAMES} LEFT JOIN changes c ON c.id = t.retraction ORDER BY t.number"
)


class MigrationReport(NamedTuple):
    """The result of a migration: how much is in the new library, and what is not.

    `lost` are ids of touches whose image is missing or altered in the old library,
    `lost_arrays` names what whole recordings have lost likewise, such as "no_contact";
    `n_unknown_files` counts files of images that its database does not know.
    """

    n_touches: int
    n_changes: int
    lost: list[str]
    n_unknown_files: int
    lost_arrays: list[str]


def migrate_library(old: Path, new: Path, progress: bool | None) -> MigrationReport:
    """Make a library of today of an old one; see `TouchLibrary.migrate`."""
    begun = new / _BEGUN
    if not begun.is_file() or (new / FILE_NAME).exists():  # a library was made there
        refuse_used(new)
    with (
        _explained(old),
        tempfile.TemporaryDirectory() as scratch,
        closing(_OldLibrary(old, scratch)) as source,
    ):
        make_folder(new)
        with closing(Store(new, create=True, name=_BEGUN)) as store:
            source.refuse_others(store)
            with Progress(source.n_touches, "Migrating", progress) as bar:
                source.enter_rest(store, bar)
            source.compare(store)
            tally = store.tally()
            store.rows("PRAGMA wal_checkpoint(TRUNCATE)")
        begun.replace(new / FILE_NAME)
        for left in new.glob(f"{_BEGUN}-*"):
            left.unlink()
        flush_folder(new)
        counts = tally.n_touches, tally.n_changes
        n_unknown, arrays = source.n_unknown_files(), sorted(source.lost_arrays)
        return MigrationReport(*counts, source.lost, n_unknown, arrays)


@contextmanager
def _explained(folder: Path) -> Iterator[None]:
    """Turn what cells hold that nobody wrote into one sentence."""
    try:
        yield
    except LibraryError:
        raise
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise _unsound(folder, repr(error)) from error


def _unsound(folder: Path, got: object) -> LibraryError:
    return LibraryError(
        f"{folder} must be a sound library, got: {got}. Repair it with the palpate "
        "that made it: `repair_library`."
    )


class _OldLibrary:
    """An old library: a copy of its database, and its files."""

    def __init__(self, folder: Path, scratch: str) -> None:
        self.folder, self.lost = folder, list[str]()
        self.lost_arrays: set[str] = set()
        self._last: tuple[str, list[Array]] = "", []
        copy = Path(scratch) / FILE_NAME
        for ending in ("", "-wal"):  # opening it in its place would change it
            with suppress(FileNotFoundError):
                source = folder / f"{FILE_NAME}{ending}"
                shutil.copyfile(source, copy.with_name(f"{FILE_NAME}{ending}"))
        if not copy.is_file():
            raise LibraryError(
                f"{folder} must be an old library of touches, got no {FILE_NAME} in it."
            )
        self._database = sqlite3.connect(copy)
        self._database.row_factory = sqlite3.Row
        self._database.text_factory = lambda text: text.decode(errors="replace")
        try:
            self._read()
        except BaseException:
            self.close()
            raise

    def _read(self) -> None:
        [(version,)] = self._rows("PRAGMA user_version")
        if version not in OLD_VERSIONS:
            raise LibraryError(
                f"{self.folder} must be a library of format 1 or 2, got format "
                f"{version}. One of today needs no migration."
            )
        [(self.n_touches,)] = self._rows("SELECT count(*) FROM touches")
        self._changes = [*self._read_changes()]
        self._recordings = self._read_recordings()

    def close(self) -> None:
        self._database.close()

    def refuse_others(self, store: Store) -> None:
        """Refuse to go on with a migration of another library."""
        entered = store.rows(_IDS)
        ids = {row["number"]: row["id"] for row in self._rows(_IDS)}
        if any(ids.get(number) != key for number, key in entered):
            raise LibraryError(
                f"{store.folder} must be where the migration of {self.folder} was "
                "begun, got touches of another library. Give another folder."
            )

    def enter_rest(self, store: Store, bar: Progress) -> None:
        """Enter touches and changes in their order, but for those in `store`."""
        number = store.count("SELECT max(number) FROM touches")
        waiting = iter(self._changes)
        for (time_s,) in store.rows("SELECT time_s FROM changes ORDER BY id"):
            next((c for c in waiting if c.time_s == time_s), None)  # clocks may go back
        enter_all(store, self._touches_after(number, bar), waiting)

    def _touches_after(
        self, number: int, bar: Progress
    ) -> Iterator[tuple[list[int], Batch]]:
        """Yield neighbouring touches of one layout, recording, file and time."""
        while rows := self._rows(_ROWS, [number, _AT_ONCE]):
            number = rows[-1]["number"]
            for _, alike in groupby(rows, itemgetter(*_COMMON)):
                together = [row for row in alike if self._has_image(row)]
                if together:
                    yield [row["number"] for row in together], self._batch(together)
            bar.advance(len(rows))

    def compare(self, store: Store) -> None:
        """Refuse a new library that says other things than the old one."""
        lost = {bytes.fromhex(key) for key in self.lost}
        before = [tuple(row) for row in self._rows(_STATE) if row["id"] not in lost]
        if before != store.rows(_STATE):
            pairs = zip(before, store.rows(_STATE), strict=False)
            odd = next((row[1].hex() for row, now in pairs if row != now), "the last")
            raise LibraryError(
                f"{self.folder} must be one whose changes explain its touches, got "
                f"another name or retraction of touch {odd}. Look at it with "
                "`check_library` of the palpate that made it."
            )

    def n_unknown_files(self) -> int:
        listed = {name.hex() for (name,) in self._rows("SELECT name FROM files")}
        return sum(p.stem not in listed for p in self.folder.glob("images/*/*.npy"))

    def _rows(self, sql: str, values: Sequence[Any] = ()) -> list[sqlite3.Row]:
        try:
            return self._database.execute(sql, values).fetchall()
        except sqlite3.Error as error:
            raise _unsound(self.folder, error) from error

    def _read_changes(self) -> Iterator[Change]:
        """Yield the changes; lists of touches stand in files, or follow from rows."""
        rows = self._rows("SELECT id, added_s FROM touches ORDER BY number")
        added_s = np.array([row["added_s"] for row in rows])
        numbers = {row["id"].hex(): n for n, row in enumerate(rows, start=1)}
        rows = self._rows(
            "SELECT id, name, time_s, action, content FROM changes ORDER BY id"
        )
        for key, name, time_s, action, text in rows:
            content = json.loads(text)
            if action == "leave_out":  # arrays that were lost: reading tells of them
                continue
            if action in ("retract", "restore"):
                content["ids"] = self._ids(key, name, action)
            for note in ("time_s", "after", "digest", "action"):
                content.pop(note, None)
            # It came after the touches that it names, wherever the clock was.
            named = [numbers.get(key, 0) for key in content.get("ids", ())]
            before = np.flatnonzero(added_s < time_s) + 1  # numbers count from 1
            after = max([0, *before[-1:].tolist(), *named])
            yield Change(time_s, action, content, after)

    def _ids(self, key: int, name: str, action: str) -> list[str]:
        with suppress(OSError, ValueError, KeyError):
            path = self.folder / "changes" / f"{name}.json"
            return [str(i) for i in json.loads(path.read_text("utf-8"))["ids"]]
        if action == "restore":
            return []
        sql = "SELECT lower(hex(id)) FROM touches WHERE retraction = ?"
        return [row[0] for row in self._rows(sql, [key])]

    def _read_recordings(self) -> dict[int, Recording]:
        recordings = {}
        for row in self._rows("SELECT * FROM recordings"):
            # The type of images with channels began with their number: "(3,)|u1".
            channels, _, kind = row["dtype"].rpartition(")")
            n_channels = [int(channels.strip("(,"))] if channels else []
            shape = row["n_rows"], row["n_cols"], *n_channels
            described = [row[name] for name in RECORDED]
            fields = b"", *described, shape, np.dtype(kind), json.loads(row["whole"])
            recordings[row["id"]] = Recording._make(fields)
        return recordings

    def _has_image(self, row: sqlite3.Row) -> bool:
        try:
            self._image(row)
            self._wide(row)
        except (OSError, ValueError, KeyError):
            self.lost.append(row["id"].hex())
            return False
        return True

    def _batch(self, rows: list[sqlite3.Row]) -> Batch:
        layout = Column.all_of(rows[0]["columns"])
        recording = self._recordings[rows[0]["recording"]]
        arrays: dict[bytes, Array | None] = {}
        keys = {}
        for entry, name in recording.whole.items():
            try:
                [array] = self._arrays("arrays", name)[:1]
            except (OSError, ValueError):
                self.lost_arrays.add(entry)
                continue
            keys[entry] = image_digest(array).hex()
            arrays[image_digest(array)] = array
        packs = packs_well(self._image(rows[0]))
        plain, images = [], []
        for row in rows:
            more = packed_rows(self._wide(row), 0)
            images.append(stored_image(self._image(row), None, more, packs=packs))
            values = {**_values(row), "object": self._label(row, layout, more)}
            plain.append({c.name: values.get(c.name) for c in layout if not c.wide})
        digests = [row["image"] for row in rows]
        new = new_rows(layout, plain, digests, images, rows[0]["added_s"])
        touches = [n._replace(key=row["id"]) for n, row in zip(new, rows, strict=True)]
        return Batch(layout, recording._replace(whole=keys), arrays, touches, images)

    def _label(
        self, row: sqlite3.Row, layout: list[Column], more: bytes | None
    ) -> str | None:
        """Return the name from which the id follows, else that by times of changes."""
        by_time: str | None = row["label"]
        names = [by_time]
        for change in reversed(self._changes):
            if change.action == "rename" and change.content["new"] in names:
                if change.content["new"] == by_time and change.after >= row["number"]:
                    by_time = change.content["old"]
                names.append(change.content["old"])
        cells, [wide] = _values(row), wide_identities(layout, [more])
        for label in dict.fromkeys([by_time, *names]):
            if identity(row["image"], {**cells, "object": label}, wide) == row["id"]:
                return label
        return by_time

    def _image(self, row: sqlite3.Row) -> Array:
        """Return the image of a row, compared with its digest."""
        recording = self._recordings[row["recording"]]
        shape, dtype = recording.image_shape, recording.dtype
        n_bytes = prod(shape) * dtype.itemsize
        with self._path("images", row["file"].hex()).open("rb") as file:
            file.seek(row["offset"] + row["place"] * n_bytes)
            image = np.frombuffer(file.read(n_bytes), dtype).reshape(shape)
        if image_digest(image) != row["image"]:
            raise ValueError("altered values")
        return image

    def _wide(self, row: sqlite3.Row) -> dict[str, Array]:
        """Return a row's values of wide columns, as arrays of one row."""
        layout, place = Column.all_of(row["columns"]), row["place"]
        names = [column.name for column in layout if column.wide]
        if not names:
            return {}
        _, *blocks, _ = self._arrays("images", row["file"].hex())
        return {
            name: block[place : place + 1]
            for name, block in zip(names, blocks, strict=True)
        }

    def _arrays(self, kind: str, name: str) -> list[Array]:
        """Return all arrays of a file, which must be what its name says."""
        if self._last[0] == name:
            return self._last[1]
        content = self._path(kind, name).read_bytes()
        if hashlib.sha256(content).hexdigest() != name:
            raise ValueError("altered content")
        stream, arrays = io.BytesIO(content), []
        while stream.tell() < len(content):
            arrays.append(npy.read_array(stream, max_header_size=MAX_HEADER))
        self._last = name, arrays
        return arrays

    def _path(self, kind: str, name: str) -> Path:
        return self.folder / kind / name[:2] / f"{name}.npy"


def _values(row: sqlite3.Row) -> dict[str, Any]:
    """Return the plain values of a touch but for its object."""
    extra: dict[str, Any] = json.loads(row["extra"] or "{}")
    return {name: row[name] for name in CELLS[1:]} | extra
