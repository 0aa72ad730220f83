"""`TouchLibrary`: touches in a folder, none of them ever lost."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Self

import numpy as np

from .._durable import flush_folder
from .._types import Array
from ..touches import Touches
from . import _adding, _reading
from ._adding import ObjectRow, SensorDescription, TouchRow, condition, numbers_of
from ._changes import checked_name, chosen_ids, known_object, make_change
from ._checking import CheckReport, check_library
from ._entering import enter_lost_rows
from ._exchange import export_touches
from ._files import adopt
from ._reading import IN_MEMORY, Selection, read_array, read_images, read_touches
from ._repairing import RepairReport, repair_library
from ._rows import FROM, Numbers, read_one, read_rows, without_damaged
from ._store import FILE_NAME, IMAGES, LibraryError, Store, holds_files, is_unicode
from ._where import objects_asked

MAX_BYTES = 64 * 2**30
Sensors = list[SensorDescription]
Ids = list[str]  # inside the class, `list` is a method


class TouchLibrary:
    """Touches in a folder: durable, searchable, growing.

    A SQLite database holds what is known of every touch; the images are plain
    `.npy` files named after their content. When `add` has returned, its touches
    survive a killed program and a power cut. Several programs of one machine may
    read and write at once; one library object may be shared by threads.

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

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        adopted = adopt(self.folder / IMAGES)
        self._store = Store(self.folder)
        try:
            enter_lost_rows(self._store, adopted)
        except BaseException:
            self._store.close()
            raise

    @classmethod
    def open(cls, folder: str | Path, create: bool = False) -> Self:
        """Open the library in `folder`; `create` makes one where there is none.

        Raises
        ------
        LibraryError
            There is none, it is damaged, or a newer palpate made it.
        """
        place = Path(folder)
        # Where there are files the database came first: without one it was lost.
        if create and not holds_files(place):
            try:
                place.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise LibraryError(
                    f"{place} must be a folder that can be made, got: {error.strerror}."
                ) from error
            Store(place, create=True).close()  # several programs may try at once
            flush_folder(place)
            flush_folder(place.parent)
        return cls(place)

    @staticmethod
    def is_library(folder: str | Path) -> bool:
        """Tell whether `folder` holds a library, even one whose database is lost."""
        return (Path(folder) / FILE_NAME).is_file() or holds_files(Path(folder))

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
        known = {n: np.full(len(touches), v) for n, v in each.items() if v is not None}
        known |= {n: np.array(v) for n, v in whole.items() if v is not None}
        labelled = touches.with_columns(**known) if known else touches
        return _adding.add_touches(self._store, labelled, sensor, progress)

    def objects(self) -> list[ObjectRow]:
        """Return all objects with touches, sorted by name."""
        return _adding.list_objects(self._store)

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
        store, some = self._store, [-1 if limit is None else limit, offset]
        if where is None and damaged == "raise":  # rows not shown do not matter
            sql, values = condition(store, None, "unseen", retracted=retracted)
            query = f"SELECT number FROM touches t WHERE {sql} ORDER BY number"
            found = store.rows(f"{query} LIMIT ? OFFSET ?", some)
            page = bool(found) and len(found) == limit
            ends = (found[-1][0], found[0][0] if offset else 1) if page else ()
            without_damaged(store, damaged, *ends)
        else:
            sql, values = condition(store, where, damaged, retracted=retracted)
        tail = f"WHERE {sql} ORDER BY t.number LIMIT ? OFFSET ?"
        rows = read_rows(store, TouchRow._fields, tail, [*values, *some])
        return [TouchRow._make((*known, bool(gone), why)) for *known, gone, why in rows]

    def refuse_unknown(self, where: str | None) -> None:
        """Refuse a filter `object = NAME` of a name that no object has, or had."""
        for name in objects_asked(where or ""):
            known_object(self._store, name)

    def count(self, where: str | None = None) -> int:
        """Return how many touches meet a filter."""
        sql, values = condition(self._store, where)
        return self._store.count(f"SELECT count(*) {FROM} WHERE {sql}", values)

    def image(self, id: str) -> Array:
        """Return the image of one touch, (n_rows, n_cols[, n_channels])."""
        return np.asarray(read_images(self.folder, [read_one(self._store, id)])[0])

    def no_contact(self, session: str | int | None = None) -> Array | None:
        """Return the latest no-contact image of a session (of all), or None.

        One that is missing or altered is passed over with a warning.
        """
        without_damaged(self._store, "raise")
        chosen = "" if session is None else "AND t.session IS ? "
        rows = self._store.rows(
            "SELECT json_extract(r.whole, '$.no_contact') AS name FROM touches t "
            f"JOIN recordings r ON r.id = t.recording WHERE name IS NOT NULL {chosen}"
            "GROUP BY name ORDER BY max(t.number) DESC",
            [] if session is None else [session],
        )
        images = (read_array(self._store, "no_contact", row[0]) for row in rows)
        return next((image for image in images if image is not None), None)

    def sensors(self) -> Sensors:
        """Return the sensors that took the touches, in the order first met."""
        without_damaged(self._store, "raise", 0)
        rows = self._store.rows(
            "SELECT sensor, kind, unit, pitch_mm, geometry FROM recordings "
            "WHERE sensor IS NOT NULL ORDER BY id"
        )
        return list(dict.fromkeys(SensorDescription(*row) for row in rows))

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
            or a warning says how many are left out. Whether one with a damaged row
            meets the filter cannot be known, so any in the library counts.

        Raises
        ------
        LibraryError
            None is found, they differ in size, type or geometry, or a row or an image
            is missing or altered; the message names the touches and the fix.

        Notes
        -----
        Columns that only some touches have are NaN or empty for the others. Entries
        of the whole set that differ between recordings (mostly the no-contact
        image) are left out; see `no_contact`. So are, with a warning, those whose
        file is missing or altered.
        """
        numbers = self._numbers(where, damaged)
        return read_touches(self._store, numbers, max_bytes, in_memory)

    def select(self, where: str | None = None, *, damaged: str = "raise") -> Selection:
        """Return touches as a source that reads images only as they are needed.

        `ObjectRecogniser.fit` and `add_object` take it in place of `Touches`; `damaged`
        is as for `touches`.
        """
        return Selection(self._store, self._numbers(where, damaged))

    def _numbers(self, where: str | None, damaged: str) -> Numbers:
        numbers = numbers_of(self._store, where, damaged)
        skip = damaged == "skip"
        return _reading.with_images(self._store, numbers) if skip else numbers

    def export(self, path: str | Path, where: str | None = None) -> int:
        """Write touches in another form and return how many there are.

        Parameters
        ----------
        path : path
            `.npz` is a touch archive, `.parquet` a Parquet file, and a new folder a
            LeRobotDataset (format v3.0).
        where : str, optional
            A filter such as "object = mug and force_n > 0.5".
        """
        return export_touches(self._store, numbers_of(self._store, where), Path(path))

    def rename_object(self, old: str, new: str) -> None:
        """Give an object another name; the old one is free afterwards."""
        _, now = known_object(self._store, old)
        make_change(self._store, action="rename", old=now, new=checked_name(new))

    def merge_objects(self, source: str, into: str) -> None:
        """Make two objects one; touches added as `source` go there as well."""
        _, source = known_object(self._store, source)
        _, into = known_object(self._store, into)
        make_change(self._store, action="merge", source=source, into=into)

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
        known = {"ids": chosen, "object": object, "reason": reason}
        return make_change(self._store, action="retract", **known)

    def restore(
        self, ids: str | Iterable[str] | None = None, *, object: str | None = None
    ) -> int:
        """Take retracted touches back in; return how many it concerned."""
        chosen = chosen_ids(self._store, ids, object, "IS NOT NULL")
        return make_change(self._store, action="restore", ids=chosen, object=object)

    def stats(self) -> _adding.Stats:
        """Return how much the library holds."""
        return _adding.stats_of(self._store)

    def check(self, *, progress: bool | None = None) -> CheckReport:
        """Read everything and compare it with its checksums; see `check_library`."""
        return check_library(self.folder, progress=progress)

    def repair(self, *, progress: bool | None = None) -> RepairReport:
        """Set aside what is damaged and recover what is not; see `repair_library`."""
        return repair_library(self.folder, progress=progress)
