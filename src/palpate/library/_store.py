"""A library's folder and its database: tables, safe transactions, seals and errors.

Write-ahead logging with `synchronous=FULL`: once a transaction has ended, it is on
the disk. The exception is rows of added touches, whose files are on the disk before
(`_entering.py`). Readers never wait for writers; writers wait for one another.

Every row has a seal, a digest of all its values, kept beside them. Triggers of each
connection seal a row when it is written, and refuse to change one whose seal is broken,
so that no damage is sealed as truth. No row is ever removed but the last: keys count
from 1 without gaps, so that a row that vanished is noticed too. A library made before
rows had seals gets them when it is first written to.
"""

import hashlib
import json
import marshal
import os
import sqlite3
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from .._durable import flush_all

SEALED = {
    "objects": ("id", "name", "category", "merged_into"),
    "recordings": (
        *("id", "digest", "sensor", "kind", "unit", "pitch_mm", "geometry"),
        *("n_rows", "n_cols", "dtype", "whole"),
    ),
    "layouts": ("id", "columns"),
    "files": ("id", "name", "n_touches", "offset"),
    "changes": ("id", "name", "time_s", "action", "content"),
    "touches": (
        *("number", "id", "object", "category", "session", "episode", "sensor"),
        *('"order"', "time_s", "force_n", "press", "frame", "source_path", "extra"),
        *("layout", "recording", "file", "place", "image", "added_s", "retraction"),
    ),
}
_LASTING = ("recordings", "layouts")  # their rows never change: keys are kept
FILE_NAME = "library.sqlite"
IMAGES, ARRAYS, CHANGES, FEATURES = "images", "arrays", "changes", "features"
VERSION = 2  # from 2 on, rows have seals
PATIENCE_S = 60.0
AT_ONCE = 512  # so many touches stand in one query, and in one task of a worker
_ROWS_AT_ONCE = 4096
_APPLICATION = 0x70616C70  # "palp"

_TABLES = """
CREATE TABLE objects (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    category TEXT,
    merged_into INTEGER REFERENCES objects (id));
CREATE TABLE recordings (
    id INTEGER PRIMARY KEY,
    digest BLOB NOT NULL UNIQUE,
    sensor TEXT, kind TEXT, unit TEXT, pitch_mm REAL, geometry TEXT,
    n_rows INTEGER NOT NULL, n_cols INTEGER NOT NULL, dtype TEXT NOT NULL,
    whole TEXT NOT NULL);
CREATE TABLE layouts (id INTEGER PRIMARY KEY, columns TEXT NOT NULL UNIQUE);
CREATE TABLE files (
    id INTEGER PRIMARY KEY,
    name BLOB NOT NULL UNIQUE,
    n_touches INTEGER NOT NULL,
    offset INTEGER NOT NULL);
CREATE TABLE changes (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    time_s REAL NOT NULL,
    action TEXT NOT NULL,
    content TEXT NOT NULL);
CREATE TABLE touches (
    number INTEGER PRIMARY KEY,
    id BLOB NOT NULL UNIQUE,
    object INTEGER REFERENCES objects (id),
    category TEXT, session, episode, sensor, "order", time_s REAL, force_n REAL,
    press, frame, source_path TEXT,
    extra TEXT,
    layout INTEGER NOT NULL REFERENCES layouts (id),
    recording INTEGER NOT NULL REFERENCES recordings (id),
    file INTEGER NOT NULL REFERENCES files (id),
    place INTEGER NOT NULL,
    image BLOB NOT NULL,
    added_s REAL NOT NULL,
    retraction INTEGER REFERENCES changes (id))"""


def seal(*values: Any) -> bytes:
    """Return the digest of a row: of its values and their types.

    Version 2 of marshal's format depends on values alone; it takes a tenth of the time
    of `repr`.
    """
    return hashlib.blake2b(marshal.dumps(values, 2), digest_size=8).digest()


def triggers() -> Iterator[str]:
    """Yield what makes a connection seal the rows that it writes."""
    for table, columns in SEALED.items():
        key, listed = columns[0], ", ".join(columns)
        old = ", ".join(f"old.{name}" for name in columns)
        start = "CREATE TEMP TRIGGER IF NOT EXISTS"
        again = (
            f"UPDATE {table} SET seal = seal_of({listed}) WHERE {key} = new.{key}; END"
        )
        yield f"{start} enter_{table} AFTER INSERT ON main.{table} BEGIN {again}"
        yield (
            f"{start} change_{table} AFTER UPDATE OF {listed} ON main.{table} "
            f"BEGIN {again}"
        )
        yield (
            f"{start} keep_{table} BEFORE UPDATE OF {listed} ON main.{table} "
            f"WHEN old.seal IS NOT seal_of({old}) "
            f"BEGIN SELECT RAISE(ABORT, 'a damaged row of {table}'); END"
        )


class LibraryError(ValueError):
    """A library cannot do what was asked; the message names what and the fix."""


class DatabaseDamaged(LibraryError):
    """The database is lost, empty, cut or overwritten: a repair makes it anew."""


class Unreadable(LibraryError):
    """A file of images or arrays is gone, or the disk fails."""


class DatabaseUnavailable(LibraryError):
    """The disk is full, fails or is read-only; the library itself may be sound."""


class DatabaseBusy(DatabaseUnavailable):
    """Another program has kept the database to itself for too long."""


class NewerLibrary(LibraryError):
    """A newer palpate made the library."""


class Store:
    """The folder of a library and the connection to its database.

    One thread uses the connection at a time. `create` makes the tables where there
    are none; `name` is another database while a repair makes it anew. `sealed` tells
    whether its rows have seals, `has_log` whether it keeps a write-ahead log.
    """

    sealed = False

    def __init__(
        self, folder: Path, *, create: bool = False, name: str = FILE_NAME
    ) -> None:
        self.folder, self.path = folder, folder / name
        self.images, self.arrays = folder / IMAGES, folder / ARRAYS
        self._lock = threading.RLock()
        self._seen: dict[str, tuple[int, list[int]]] = {}
        self._lasting: dict[tuple[str, Any], int] = {}
        self._explained = _Explained(self.path)
        # Of threads that add touches: files to write to, who waits, is one at work?
        self.slots: list[Path] = []
        self.turn, self.leads = threading.Condition(), False
        self.waiting: dict[Any, Any] = {}
        # Marks, kept locked; is each commit flushed; was the last one not?
        self.marks: dict[Path, BinaryIO] = {}
        self._flushes, self._unflushed = True, False
        if not create and not self.path.is_file():
            start = f"{folder} must be a library of touches, got "
            if not holds_files(folder):
                raise LibraryError(
                    f"{start}no {name} in it. Make one with `palpate library add`."
                )
            raise DatabaseDamaged(
                f"{start}its files without {name}. Put that back, or make it anew from "
                "the files with `palpate library check --repair`."
            )
        try:
            self._open(create)
        except DatabaseUnavailable as error:
            if create or isinstance(error, DatabaseBusy):
                raise
            self._open_alone(error)

    def close(self) -> None:
        """Close the connection; closing twice does nothing."""
        with self._lock:
            with suppress(LibraryError, OSError):  # marks stay then, as they must
                if self._unflushed:
                    self.flush_log()
                if os.getpid() == self._explained.process:
                    for mark in self.marks:
                        mark.unlink(missing_ok=True)
            self._connection.close()
            while self.marks:
                self.marks.popitem()[1].close()
            while self.slots:
                self.slots.pop().unlink(missing_ok=True)

    def flush_log(self) -> None:
        """Put all rows that any program has committed on the disk."""
        with suppress(FileNotFoundError):  # its rows have gone to the database
            flush_all(self.path.with_name(f"{self.path.name}-wal"))

    def rows(self, sql: str, values: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        with self._lock, self._explained:
            return self._connection.execute(sql, values).fetchall()

    def one(self, sql: str, values: Sequence[Any] = ()) -> tuple[Any, ...] | None:
        return next(iter(self.rows(sql, values)), None)

    def count(self, sql: str, values: Sequence[Any] = ()) -> int:
        return int(self.rows(sql, values)[0][0])

    def among(self, sql: str, keys: Sequence[Any]) -> list[tuple[Any, ...]]:
        """Return rows of a query whose `IN (?)` stands for any number of keys."""
        found = []
        for start in range(0, len(keys), AT_ONCE):
            piece = keys[start : start + AT_ONCE]
            many = sql.replace("IN (?)", f"IN {holders(len(piece))}")
            found += self.rows(many, piece)
        return found

    def key_of(self, table: str, column: str, value: Any) -> int | None:
        """Return the key of the row with a unique value; its index may be damaged."""
        known = self._lasting.get((table, value))
        if known is not None:
            return known
        key = SEALED[table][0]
        found = self.one(
            f"SELECT {key}, (SELECT {column} FROM {table} AS there NOT INDEXED "
            f"WHERE there.{key} = listed.{key}) FROM {table} AS listed "
            f"WHERE {column} = ?",
            [value],
        )
        if found is None:
            return None
        if found[1] != value:
            raise self._rows_missing(table)
        if table in _LASTING:
            self._lasting[table, value] = int(found[0])
        return int(found[0])

    def broken(self, table: str, last: int | None = None, first: int = 1) -> list[int]:
        """Return the keys of rows whose seal is broken, from `first` up to `last`.

        From the first row on, each is read once in the life of the store. Missing rows
        raise `DatabaseDamaged`.
        """
        with self._lock:
            seen, found = self._seen.get(table, (0, []))
            part = first > seen + 1
            if part:
                seen, found = first - 1, []
            key, columns = SEALED[table][0], ", ".join(SEALED[table])
            [(n_rows, end)] = self.rows(
                f"SELECT (SELECT count(*) FROM {table} "
                f"INDEXED BY sqlite_autoindex_{table}_1), max({key}) FROM {table}"
            )
            if n_rows != (end or 0):
                raise self._rows_missing(table)
            end = n_rows if last is None else min(last, n_rows)
            while seen < end:
                rows = self.rows(
                    f"SELECT {columns}, seal FROM {table} NOT INDEXED "
                    f"WHERE {key} > ? AND {key} <= ? ORDER BY {key}",
                    [seen, min(seen + _ROWS_AT_ONCE, end)],
                )
                keys = range(seen + 1, seen + 1 + len(rows))
                if not rows or [row[0] for row in rows] != [*keys]:
                    raise self._rows_missing(table)
                found += [row[0] for row in rows if seal(*row[:-1]) != row[-1]]
                seen += len(rows)
                if not part:
                    self._seen[table] = seen, found
            return found

    def _rows_missing(self, table: str) -> "DatabaseDamaged":
        start = f"{self.path} must be a sound database, got missing rows of {table}. "
        return DatabaseDamaged(start + _REBUILD)

    def run(self, sql: str, values: Sequence[Any] = ()) -> int:
        """Run one statement inside `writing` and return how many rows it changed."""
        return self._connection.execute(sql, values).rowcount

    def run_many(self, sql: str, values: Sequence[Sequence[Any]]) -> int:
        """Run one statement per entry of `values` inside `writing`."""
        return self._connection.executemany(sql, values).rowcount

    def insert(self, table: str, values: dict[str, Any]) -> int:
        """Insert one row inside `writing` and return its key."""
        sql = f"INSERT INTO {table} ({', '.join(values)}) VALUES {holders(len(values))}"
        return int(self._connection.execute(sql, [*values.values()]).lastrowid or 0)

    @contextmanager
    def writing(self, *, flushed: bool = True) -> Iterator[None]:
        """Run a transaction; when the block has ended, all of it is on the disk.

        With `flushed=False` it is committed, and reaches the disk with the next flushed
        one or when the store is closed. The caller must be able to enter its rows again
        after a power cut.
        """
        with self._lock:
            if not self.sealed:
                with self._transaction():
                    self._seal_rows()
                self._watch()
            if flushed != self._flushes:
                self.rows(f"PRAGMA synchronous = {'FULL' if flushed else 'NORMAL'}")
                self._flushes = flushed
            with self._transaction():
                yield
            self._unflushed = not flushed

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with self._explained:
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._connection.execute("COMMIT")
            except BaseException:
                self._lasting.clear()  # it may know rows that are taken back
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise

    def _open(
        self, create: bool, *, mode: str = "rwc", locking: str = "NORMAL"
    ) -> None:
        place = f"{self.path.absolute().as_uri()}?mode={mode}"
        with self._explained:
            self._connection = sqlite3.connect(
                place,
                uri=True,
                timeout=PATIENCE_S,
                isolation_level=None,
                check_same_thread=False,
            )
        try:
            self._prepare(create, locking)
        except BaseException:
            self._connection.close()
            raise

    def _open_alone(self, error: DatabaseUnavailable) -> None:
        """Open where there is no room, or no leave, for the shared index of the log.

        A connection that locks out all others keeps it in its own memory. A database
        that may not be written to is read as it stands, when nothing is left in its
        log.
        """
        log = self.path.with_name(f"{self.path.name}-wal")
        try:
            self._open(False, mode="rw", locking="EXCLUSIVE")
        except DatabaseUnavailable:
            if log.is_file() and log.stat().st_size:
                raise error from None
            try:
                self._open(False, mode="ro&immutable=1")
            except DatabaseUnavailable:
                raise error from None

    def _prepare(self, create: bool, locking: str) -> None:
        with self._explained:
            run = self._connection.execute
            run(f"PRAGMA busy_timeout = {int(PATIENCE_S * 1000)}")
            run(f"PRAGMA locking_mode = {locking}")
            run("PRAGMA synchronous = FULL")
            run("PRAGMA foreign_keys = ON")
            run("PRAGMA trusted_schema = OFF")
            run("PRAGMA temp_store = MEMORY")
            self._connection.create_function("seal_of", -1, seal, deterministic=True)
            if self.count("PRAGMA user_version") == 0 and create:
                run("PRAGMA journal_mode = WAL")
                with self._transaction():
                    # Where there are some, another process was faster, or it is
                    # another database.
                    if not self.one("SELECT 1 FROM sqlite_master"):
                        for statement in _TABLES.split(";"):
                            self.run(statement)
                        self.run(f"PRAGMA application_id = {_APPLICATION}")
                        self._seal_rows()
            version = self.count("PRAGMA user_version")
            application = self.count("PRAGMA application_id")
            self.has_log = self.rows("PRAGMA journal_mode") == [("wal",)]
        if version > VERSION:
            raise NewerLibrary(
                f"{self.path} has library format {version}, this palpate reads up to "
                f"{VERSION}. Update palpate; the images beside it are plain .npy files."
            )
        if version < 1 or application != _APPLICATION:
            raise DatabaseDamaged(
                f"{self.path} must be the database of a library of touches, got "
                "another one, or an empty file. Give another folder, or rebuild it "
                "from its images with `palpate library check --repair`."
            )
        if version == VERSION:
            self._watch()

    def _watch(self) -> None:
        """Seal rows that are written; texts that are none break their seal alone."""
        with self._explained:
            for statement in triggers():
                self._connection.execute(statement)
        self._connection.text_factory = lambda text: text.decode(
            errors="backslashreplace"
        )
        self.sealed = True

    def _seal_rows(self) -> None:
        if self.count("PRAGMA user_version") < VERSION:
            # In a library that was made without.
            self.run("DROP INDEX IF EXISTS touches_of_object")
            for table, columns in SEALED.items():
                self.run(f"ALTER TABLE {table} ADD COLUMN seal BLOB")
                self.run(f"UPDATE {table} SET seal = seal_of({', '.join(columns)})")
            self.run(f"PRAGMA user_version = {VERSION}")


def holders(n_values: int) -> str:
    return f"({', '.join('?' * n_values)})"


def is_unicode(text: str) -> bool:
    return not any("\ud800" <= letter <= "\udfff" for letter in text)


def holds_files(library: Path) -> bool:
    """Tell whether touches or changes have ever been stored in a library."""
    kinds = (f"{IMAGES}/[0-9a-f][0-9a-f]/*.npy", f"{CHANGES}/*-*.json")
    return any(next(library.glob(kind), None) is not None for kind in kinds)


def from_json(text: str) -> Any:
    """Return what stands in a cell as JSON, or say that the database is damaged."""
    try:
        return json.loads(text)
    except ValueError as error:
        raise DatabaseDamaged(
            f"A cell of the database must be JSON, got {text[:80]!r}. {_REBUILD}"
        ) from error


@contextmanager
def room_for(what: str, place: Path, fix: str) -> Iterator[None]:
    """Turn a full or failing disk into one sentence that ends with `fix`."""
    try:
        yield
    except OSError as error:
        raise LibraryError(
            f"{place} must be a place with room for {what}, got: "
            f"{error.strerror or error}. {fix}"
        ) from error


_FIXES = {
    "SQLITE_FULL": "Free space on the disk and go on; what was acknowledged is kept.",
    "SQLITE_IOERR": "Free space on the disk, see that the disk is well, and try again; "
    "what was acknowledged is kept.",
    "SQLITE_CANTOPEN": "Free space on the disk, and check that the folder may be "
    "written to.",
    "SQLITE_READONLY": "Check that the folder and the file may be written to.",
    "SQLITE_NOMEM": "Free memory and try again.",
}
_REBUILD = (
    "It is damaged; `palpate library check --repair` rebuilds it from the image files."
)
_WAIT = "Another program has been writing for a minute; wait, or end it."
_CHECK = "Check that the folder may be written to, and run `palpate library check`."


class _Explained:
    """Turns what SQLite stumbles over inside it into one sentence with the fix."""

    def __init__(self, path: Path) -> None:
        self.path, self.process = path, os.getpid()

    def __enter__(self) -> None:
        if os.getpid() != self.process:
            raise LibraryError(
                f"{self.path} was opened by another process, which has been forked. "
                "Open the library again in this one: TouchLibrary.open(folder)."
            )

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if isinstance(error, sqlite3.Error):
            raise _told(self.path, error) from error
        if isinstance(error, UnicodeDecodeError):  # in what SQLite quotes
            raise DatabaseDamaged(
                f"{self.path} must be a sound database, got: {error}. {_REBUILD}"
            ) from error
        if isinstance(error, UnicodeEncodeError):
            raise LibraryError(
                f"Texts must be such as UTF-8 can hold, got {error.object[:80]!r}. "
                "Leave out what no program can print."
            ) from error


def _told(path: Path, error: sqlite3.Error) -> LibraryError:
    """Return what SQLite stumbled over as one sentence with the fix."""
    full_name = getattr(error, "sqlite_errorname", "")
    name = "_".join(full_name.split("_")[:2])
    start = f"{path} must be a sound database, got: {error}. "
    unusable = f"{path} must be readable and writable, got: {error}. "
    broken_seal = full_name == "SQLITE_CONSTRAINT_TRIGGER"
    if broken_seal or name in ("SQLITE_CORRUPT", "SQLITE_NOTADB"):
        return DatabaseDamaged(start + _REBUILD)
    if name in ("SQLITE_BUSY", "SQLITE_LOCKED", "SQLITE_PROTOCOL"):
        return DatabaseBusy(unusable + _WAIT)
    if name in _FIXES:
        return DatabaseUnavailable(unusable + _FIXES[name])
    if "closed" in str(error):
        return LibraryError(f"{start}The library was closed; open it again.")
    return LibraryError(start + _CHECK)
