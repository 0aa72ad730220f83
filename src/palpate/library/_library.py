"""`TouchLibrary`: touches in a SQLite database, none of them ever lost."""

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Self

import numpy as np

from .._checks import check_count, check_option
from .._durable import flush_folder
from .._types import Array
from ..touches import Touches
from . import _adding
from ._adding import ObjectRow, SensorDescription, TouchRow, condition
from ._changes import (
    Change,
    checked_name,
    chosen_ids,
    history,
    make_change,
    object_row,
)
from ._content import CELLS, id_bytes
from ._exchange import export_touches
from ._migrating import MigrationReport, migrate_library
from ._reading import (
    IN_MEMORY,
    NO_LIMIT,
    Selection,
    newest_no_contact,
    sound_numbers,
)
from ._rows import (
    FROM,
    Numbers,
    StoredTouch,
    Tables,
    rows_at,
    stored_images,
)
from ._store import (
    COUNT_NAME,
    FILE_NAME,
    LibraryError,
    Store,
    Tally,
    is_unicode,
    make_folder,
    warn_of_network,
)
from ._upkeep import (
    CheckReport,
    RepairReport,
    backup_library,
    check_library,
    check_store,
    repair_library,
)
from ._where import objects_named

MAX_BYTES = 64 * 2**30  # of all images read at once; larger is refused
Sensors = list[SensorDescription]
Ids = list[str]  # inside the class, `list` is a method
Changes = list[Change]


class TouchLibrary:
    """Touches in a folder: durable, searchable, growing.

    One SQLite database holds images and what is known of every touch. When `add` has
    returned, its touches survive a killed program and, on a disk that flushes when it
    says so, a power cut. Several programs of one machine may read and write at once;
    one library object may be shared by threads.

    Parameters
    ----------
    folder : path
        The library; `open` makes a new one.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from palpate import Touches
    >>> from palpate.library import TouchLibrary
    >>> touches = Touches(np.ones((2, 4, 4)), object=["cup", "pen"])
    >>> with TouchLibrary.open(tempfile.mkdtemp(), create=True) as library:
    ...     ids = library.add(touches, episode="first")
    ...     [row.name for row in library.objects()]
    ['cup', 'pen']
    """

    checked_name = staticmethod(checked_name)

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self._store = Store(self.folder)
        self._tables = Tables(self._store)
        self._counted: tuple[Tally, list[ObjectRow]] | None = None
        warn_of_network(self.folder)
        if lost := self._store.lost():
            warnings.warn(
                f"{lost} Add them again, or put a backup back; "
                "`TouchLibrary.repair_folder` accepts it as it is.",
                stacklevel=3,
            )

    @classmethod
    def open(cls, folder: str | Path, create: bool = False) -> Self:
        """Open the library in `folder`; `create` makes one where there is none.

        Raises
        ------
        LibraryError
            There is none, it is damaged, or a newer palpate made it.
        """
        place = Path(folder)
        if create:
            make_folder(place)
            is_new = not (place / FILE_NAME).is_file()
            Store(place, create=True).close()  # several programs may try at once
            if is_new:
                flush_folder(place)
                flush_folder(place.parent)
        return cls(place)

    @staticmethod
    def is_library(folder: str | Path) -> bool:
        """Tell whether `folder` holds a library, even one whose database is lost."""
        return any((Path(folder) / name).is_file() for name in (FILE_NAME, COUNT_NAME))

    @staticmethod
    def migrate(
        old: str | Path, new: str | Path, *, progress: bool | None = None
    ) -> MigrationReport:
        """Make a library of today of one of format 1 or 2, which stays as it is.

        One that was stopped goes on where it was when it is called again.

        Parameters
        ----------
        old, new : path
            The old library, and a new or empty folder.
        progress : bool, optional
            Show a bar on standard error when it takes over two seconds; by default
            where that is a terminal.

        Raises
        ------
        LibraryError
            `old` is no such library, `new` is not empty, or the disk is full.
        """
        return migrate_library(Path(old), Path(new), progress)

    @staticmethod
    def repair_folder(
        folder: str | Path, *, progress: bool | None = None
    ) -> RepairReport:
        """Make a new database of what is whole in a damaged one; nothing is deleted.

        Touches keep their ids and their order. The damaged database goes to `damaged/`
        in the library when the new one is complete. Touches that are lost can be added
        again. Nobody else may be writing meanwhile.

        Parameters
        ----------
        folder : path
            The library, which need not open.
        progress : bool, optional
            As for `check_library`.

        Raises
        ------
        LibraryError
            There is no library, another palpate made it, nothing of it can be read, or
            the disk is full or not to be read: then the library is left as it was.
        """
        return repair_library(Path(folder), progress)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.folder,)

    def __len__(self) -> int:
        """Return the number of touches that are not retracted."""
        return self.count()

    def __repr__(self) -> str:
        return f"TouchLibrary({str(self.folder)!r})"

    def close(self) -> None:
        """Close the library; it can be opened again."""
        self._store.close()

    def add(
        self,
        touches: Touches,
        *,
        episode: str | None = None,
        session: str | None = None,
        sensor: SensorDescription | None = None,
        progress: bool | None = None,
    ) -> Ids:
        """Store touches; when this returns, they are on the disk.

        Parameters
        ----------
        touches : Touches
            One or many. Their columns and whole-set entries are kept.
        episode, session : str, optional
            Given to all of them in place of the column of that name.
        sensor : SensorDescription, optional
            What took them; its name becomes their column `sensor`, its pitch and
            unit their `set_pitch_mm` and `set_unit`.
        progress : bool, optional
            Show a bar on standard error when it takes over two seconds; by default
            where that is a terminal.

        Returns
        -------
        ids : list of str
            One per touch, the same whenever the same touch is added: it follows
            from the image, object, session, episode, sensor, order, time, place and
            force. A touch that is in the library already (even retracted) is not
            stored again.

        Raises
        ------
        LibraryError
            The disk is full or the folder cannot be written to; the message says
            how many touches are stored. Or the sensor gave images with other channels
            before; nothing is stored then.
        """
        if not isinstance(touches, Touches):
            raise TypeError(
                f"touches must be Touches, got {type(touches).__name__}. "
                "Write Touches(images, object=labels)."
            )
        each: dict[str, Any] = {"episode": episode, "session": session}
        whole: dict[str, Any] = {}
        if sensor is not None:
            each["sensor"] = sensor.checked().name
            whole = {"set_pitch_mm": sensor.pitch_mm, "set_unit": sensor.unit}
            whole["geometry"] = None if touches.geometry else sensor.geometry
        new = {n: np.full(len(touches), v) for n, v in each.items() if v is not None}
        new |= {n: np.array(v) for n, v in whole.items() if v is not None}
        labelled = touches.with_columns(**new) if new else touches
        return _adding.add_touches(self._store, labelled, sensor, progress)

    def objects(self) -> list[ObjectRow]:
        """Return all objects with touches, sorted by name."""
        tally = self._store.tally()  # whatever was changed since has changed it
        if self._counted is None or self._counted[0] != tally:
            self._counted = tally, _adding.list_objects(self._store)
        return [*self._counted[1]]

    def list(
        self,
        where: str | None = None,
        limit: int | None = 100,
        offset: int = 0,
        *,
        retracted: bool = False,
        damaged: str = "raise",
    ) -> list[TouchRow]:
        """Return what is known of touches, in the order added, without images.

        Parameters
        ----------
        where : str, optional
            A filter such as "object = mug and force_n > 0.5".
        limit, offset : int
            So many rows (None is all) after so many others.
        retracted : bool, default=False
            Show retracted touches too.
        damaged : {"raise", "skip"}
            As for `touches`.
        """
        sql, values = condition(self._tables, where, retracted=retracted)
        named = {"limit": -1 if limit is None else limit, "offset": offset}
        bounds: dict[str, int] = {"at_least": -NO_LIMIT, "at_most": NO_LIMIT}
        page = [check_count(name, n, **bounds) for name, n in named.items()]
        chosen = self._store.rows(
            f"SELECT t.number {FROM} WHERE {sql} ORDER BY t.number LIMIT ? OFFSET ?",
            [*values, *page],
        )
        numbers = [row[0] for row in chosen]
        reasons = dict(
            self._store.rows(
                "SELECT id, json_extract(content, '$.reason') FROM changes "
                "WHERE action = 'retract'"
            )
        )
        parts = rows_at(self._tables, numbers, damaged)
        return [self._listed(row, reasons) for part in parts for row in part]

    def _listed(self, row: StoredTouch, reasons: dict[int, str]) -> TouchRow:
        recording = self._tables.recording(row.recording)
        cells = dict(zip(CELLS, row.cells, strict=True))
        sensor = cells["sensor"]
        n_rows, n_cols, *n_channels = recording.image_shape
        return TouchRow(
            row.key.hex(),
            cells["object"],
            cells["category"],
            cells["session"],
            cells["episode"],
            recording.sensor if sensor is None else sensor,
            cells["order"],
            cells["time_s"],
            cells["force_n"],
            n_rows,
            n_cols,
            n_channels[0] if n_channels else None,
            recording.dtype.str,
            row.added_s,
            row.retraction is not None,
            reasons.get(row.retraction or 0),
        )

    def refuse_unknown(self, where: str | None) -> None:
        """Refuse a filter `object = NAME` of a name that no object has, or had."""
        for name in objects_named(where or ""):
            object_row(self._store, name)

    def count(self, where: str | None = None) -> int:
        """Return how many touches meet a filter."""
        sql, values = condition(self._tables, where)
        return self._store.count(f"SELECT count(*) {FROM} WHERE {sql}", values)

    def image(self, id: str) -> Array:
        """Return the image of one touch, (n_rows, n_cols[, n_channels])."""
        sql = "SELECT number FROM touches WHERE id = ?"
        number = self._store.first_row(sql, [id_bytes(id)])
        if number is None:
            raise LibraryError(
                f"id must be that of a touch in the library, got {id!r}. "
                "See `TouchLibrary.list`."
            )
        [rows] = rows_at(self._tables, number)
        [stored] = stored_images(self._tables, rows)
        return stored.unpacked()

    def no_contact(self, session: str | int | None = None) -> Array | None:
        """Return the latest no-contact image of a session (of all), or None.

        One that is missing or altered is passed over with a warning; those of touches
        that are retracted do not count.
        """
        number = np.asarray(session).item()  # of numpy, as a column of touches has it
        chosen = "" if session is None else " AND session IS ?"
        rows = self._store.rows(
            f"SELECT recording FROM touches WHERE retraction IS NULL{chosen} "
            "GROUP BY recording ORDER BY max(number) DESC",
            [] if session is None else [number],
        )
        return newest_no_contact(self._tables, (key for (key,) in rows))

    def sensors(self) -> Sensors:
        """Return the sensors that took the touches, in the order first met."""
        keys = self._store.rows("SELECT id FROM recordings ORDER BY id")
        recordings = [self._tables.recording(key) for (key,) in keys]
        described = [
            SensorDescription(r.sensor, r.kind, r.unit, r.pitch_mm, r.geometry)
            for r in recordings
            if r.sensor is not None
        ]
        return [*dict.fromkeys(described)]

    def touches(
        self,
        where: str | None = None,
        *,
        max_bytes: int = MAX_BYTES,
        in_memory: int = IN_MEMORY,
        damaged: str = "raise",
    ) -> Touches:
        """Return touches that are not retracted, in the order added.

        Parameters
        ----------
        where : str, optional
            A filter such as "object = mug and force_n > 0.5".
        max_bytes : int, default=64 GiB
            Most bytes that the images may take.
        in_memory : int, default=256 MiB
            Images that take more bytes are mapped to a temporary file rather than
            held in memory.
        damaged : {"raise", "skip"}
            What becomes of touches whose row or image is damaged: all are refused,
            or a warning says how many are left out.

        Raises
        ------
        LibraryError
            None is found, they differ in size, type or geometry, or a row or an image
            is missing or altered; the message names the touches and the fix.

        Notes
        -----
        Columns that only some touches have are NaN, NaT or empty for the others.
        Entries of the whole set that differ between recordings (mostly the no-contact
        image) are left out; see `no_contact`. So are, with a warning, those whose
        file is missing or altered.
        """
        picked = Selection(self._tables, self._numbers(where, damaged))
        return picked.touches(max_bytes=max_bytes, in_memory=in_memory)

    def select(self, where: str | None = None, *, damaged: str = "raise") -> Selection:
        """Return touches as a source that reads images only as they are needed.

        `ObjectRecogniser.fit` and `add_object` take it in place of `Touches`; `damaged`
        is as for `touches`.
        """
        selection = Selection(self._tables, self._numbers(where, damaged))
        _ = selection.columns  # refused here, where the filter can be mended
        return selection

    def _numbers(self, where: str | None, damaged: str = "raise") -> Numbers:
        """Return the numbers of the touches that meet a filter, in the order added."""
        sql, values = condition(self._tables, where)
        query = f"SELECT t.number {FROM} WHERE {sql} ORDER BY t.number"
        rows = self._store.rows(query, values)
        numbers = np.fromiter((row[0] for row in rows), dtype=np.int64, count=len(rows))
        check_option("damaged", damaged, ("raise", "skip"))
        return sound_numbers(self._tables, numbers) if damaged == "skip" else numbers

    def export(
        self, path: str | Path, where: str | None = None, *, by: str | None = None
    ) -> int:
        """Write touches in another form and return how many there are.

        Parameters
        ----------
        path : path
            `.npz` is a touch archive, `.parquet` a Parquet file, and a new folder a
            LeRobotDataset (format v3.0). Parquet may go to a store that fsspec knows
            (`s3://bucket/some.parquet`).
        where : str, optional
            A filter such as "object = mug and force_n > 0.5".
        by : {"object", "category", "session", "episode", "sensor"}, optional
            Of Parquet, write a folder with one file for each value of this column.
        """
        return export_touches(self._tables, self._numbers(where), path, by)

    def rename_object(self, old: str, new: str) -> None:
        """Give an object another name; the old one is free afterwards."""
        make_change(self._store, "rename", old=old, new=checked_name(new))

    def merge_objects(self, source: str, into: str) -> None:
        """Make two objects one; touches added as `source` go there as well."""
        make_change(self._store, "merge", source=source, into=into)

    def retract(
        self,
        ids: str | Iterable[str] | None = None,
        *,
        object: str | None = None,
        reason: str,
    ) -> int:
        """Leave touches, or all of an object, out from now on; nothing is erased.

        Returns
        -------
        n_retracted : int
            How many touches it concerned.
        """
        if not isinstance(reason, str) or not reason.strip() or not is_unicode(reason):
            raise ValueError(f"reason must be a text, got {reason!r}. Say why.")
        chosen = chosen_ids(self._store, ids, object, "IS NULL")
        content = {"ids": chosen, "object": object, "reason": reason}
        return make_change(self._store, "retract", **content)

    def restore(
        self, ids: str | Iterable[str] | None = None, *, object: str | None = None
    ) -> int:
        """Take retracted touches back in; return how many it concerned."""
        chosen = chosen_ids(self._store, ids, object, "IS NOT NULL")
        return make_change(self._store, "restore", ids=chosen, object=object)

    def history(self) -> Changes:
        """Return every rename, merge, retraction and restoration, in their order."""
        return history(self._store)

    def stats(self) -> _adding.Stats:
        """Return how much the library holds."""
        return _adding.stats_of(self._store)

    def check(self, *, progress: bool | None = None) -> CheckReport:
        """Read everything and compare it with its digests; see `check_library`."""
        if self._store.is_alone:
            return check_store(self._store, progress)
        return check_library(self.folder, progress=progress)  # others go on meanwhile

    def repair(self, *, progress: bool | None = None) -> RepairReport:
        """Keep what is whole and set the damaged file aside; see `repair_folder`."""
        self.close()
        try:
            return repair_library(self.folder, progress)
        finally:
            self._store = Store(self.folder)
            self._tables = Tables(self._store)

    def backup(self, folder: str | Path, *, progress: bool | None = None) -> int:
        """Copy the library to a new folder while it is used; return the touches there.

        It is a library itself. `features/` is not copied: it is made again.

        Raises
        ------
        LibraryError
            `folder` is not new or empty, or the disk is full; nothing is left then.
        """
        return backup_library(self._store, Path(folder), progress=progress)
