"""A library's folder and its SQLite database: tables, transactions and errors.

Everything is in one file, `library.sqlite`, in write-ahead-log mode with
`synchronous=FULL`: a transaction that has ended is on the disk. Readers never wait for
writers; writers wait for one another. What threads of one program want to write while
another writes goes into one transaction next.

Touches and changes are numbered in the order added and none is ever removed. `tally`
holds how many there are and a chain over their digests. After each commit the counts
are written to `library.count` too, without a flush: SQLite ends its log at a damaged
page, which takes back what came after without a word, and this file knows of it.
"""

import hashlib
import json
import os
import sqlite3
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import ExitStack, closing, contextmanager, suppress
from errno import ENOSPC
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

T = TypeVar("T")
# What is to be done in a transaction, and what comes of it.
_Ticket = tuple[Callable[[], Any], Future[Any]]
FILE_NAME, COUNT_NAME = "library.sqlite", "library.count"
FEATURES, DAMAGED = "features", "damaged"
VERSION = 3  # 1 and 2 had images in files of their own
OLD_VERSIONS = (1, 2)  # `TouchLibrary.migrate` reads them
PATIENCE_S = 60.0  # for another program that writes
_PATIENCE_ALONE_S = 2.0  # where the file is opened for this program alone
AT_ONCE = 512  # so many touches stand in one query, and in one task of a worker
_TOGETHER = 32  # so many callers share a transaction
_APPLICATION = 0x70616C70  # "palp"
_AS_IT_STANDS = "ro&immutable=1"  # without files beside it
_STAMP = ("st_mtime_ns", "st_size")
PAGE_BYTES = 8192  # of SQLite; twice its default, since images are long
_MOUNTS = Path("/proc/self/mounts")
_NETWORK = ("nfs", "cifs", "smb", "afs", "ncpfs", "ceph", "lustre", "fuse.sshfs")

_TABLES = """
CREATE TABLE objects (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    merged_into INTEGER REFERENCES objects (id)) STRICT;
CREATE TABLE recordings (
    id INTEGER PRIMARY KEY,
    digest BLOB NOT NULL UNIQUE,
    sensor TEXT, kind TEXT, unit TEXT, pitch_mm REAL, geometry TEXT,
    n_rows INTEGER NOT NULL, n_cols INTEGER NOT NULL, n_channels INTEGER,
    dtype TEXT NOT NULL,
    whole TEXT NOT NULL) STRICT;
CREATE TABLE arrays (digest BLOB PRIMARY KEY, content BLOB NOT NULL) STRICT;
CREATE TABLE layouts (id INTEGER PRIMARY KEY, columns TEXT NOT NULL UNIQUE) STRICT;
CREATE TABLE changes (
    id INTEGER PRIMARY KEY,
    time_s REAL NOT NULL,
    after INTEGER NOT NULL,
    action TEXT NOT NULL,
    content TEXT NOT NULL,
    digest BLOB NOT NULL) STRICT;
CREATE TABLE touches (
    number INTEGER PRIMARY KEY,
    id BLOB NOT NULL UNIQUE,
    label TEXT,
    object INTEGER REFERENCES objects (id),
    category ANY, session ANY, episode ANY, sensor ANY, "order" ANY,
    time_s ANY, force_n ANY, press ANY, frame ANY, source_path ANY,
    extra TEXT,
    layout INTEGER NOT NULL REFERENCES layouts (id),
    recording INTEGER NOT NULL REFERENCES recordings (id),
    added_s REAL NOT NULL,
    image BLOB NOT NULL,
    content BLOB NOT NULL,
    digest BLOB NOT NULL,
    retraction INTEGER REFERENCES changes (id)) STRICT;
CREATE INDEX touches_of_objects ON touches (object, session, episode);
CREATE TABLE images (
    number INTEGER PRIMARY KEY REFERENCES touches (number),
    form TEXT NOT NULL,
    image BLOB NOT NULL,
    more BLOB) STRICT;
CREATE TABLE tally (
    id INTEGER PRIMARY KEY CHECK (id = 1),
    n_touches INTEGER NOT NULL, touches BLOB NOT NULL,
    n_changes INTEGER NOT NULL, changes BLOB NOT NULL) STRICT;
INSERT INTO tally VALUES (1, 0, x'', 0, x'');
CREATE VIEW touch_list AS
    SELECT t.number, lower(hex(t.id)) AS id, o.name AS object, t.category, t.session,
    t.episode, coalesce(t.sensor, r.sensor) AS sensor, t."order", t.time_s, t.force_n,
    t.press, t.frame, t.source_path, t.extra, r.kind, r.unit, r.pitch_mm, r.geometry,
    r.n_rows, r.n_cols, r.n_channels, r.dtype, i.form, length(i.image) AS n_bytes,
    datetime(t.added_s, 'unixepoch') AS added,
    json_extract(c.content, '$.reason') AS retracted_because
    FROM touches t JOIN recordings r ON r.id = t.recording
    JOIN images i ON i.number = t.number
    LEFT JOIN objects given ON given.id = t.object
    LEFT JOIN objects o ON o.id = coalesce(given.merged_into, given.id)
    LEFT JOIN changes c ON c.id = t.retraction
    ORDER BY t.number"""


class LibraryError(ValueError):
    """A library cannot do what was asked; the message names what and the fix."""


class DatabaseDamaged(LibraryError):
    """The database is empty, cut or overwritten: a repair keeps what can be read."""


class DatabaseUnavailable(LibraryError):
    """The disk is full, fails or is read-only; the library itself may be sound."""


class DatabaseBusy(DatabaseUnavailable):
    """Another program has kept the database to itself for too long."""


class OtherVersion(LibraryError):
    """A newer palpate made the library, or an older one: then it can be migrated."""


class Tally(NamedTuple):
    """Numbers of touches and changes, and the chains over their digests."""

    n_touches: int
    touches: bytes
    n_changes: int
    changes: bytes


class Store:
    """The connection to a library's database, shared by the threads of a program.

    `create` makes the tables where there are none; `name` is another database while a
    new one is made; `alone` keeps all other connections out, or is refused.
    """

    def __init__(
        self,
        folder: Path,
        *,
        create: bool = False,
        name: str = FILE_NAME,
        alone: bool = False,
    ) -> None:
        self.folder, self.path = folder, folder / name
        self._log = folder / f"{name}-wal"
        self._lock = threading.RLock()
        # Of threads that write: who waits, and is one of them at work?
        self._waiting: deque[_Ticket] = deque()
        self._turn, self._busy = threading.Condition(), False
        self._explained = _Explained(self.path)
        self._count: int | None = None
        # Of the database once it is open: its inode; of one opened as it stands, when
        # it was written to and its size.
        self._inode: tuple[int, ...] = ()
        self._stands: tuple[int, ...] = ()
        self.is_alone = alone  # locks out even a second connection of this program
        is_there = self.path.is_file() and self.path.stat().st_size > 0
        if create and name == FILE_NAME and not is_there and self._counts():
            raise LibraryError(
                f"{folder} must have its {FILE_NAME}, which held touches and is gone. "
                f"Put it or a backup back, or remove {COUNT_NAME} to begin anew."
            )
        if not create and not self.path.is_file():
            raise LibraryError(
                f"{folder} must be a library of touches, got no {name} in it. Make one "
                "with `TouchLibrary.add`."
            )
        mode = "rwc"
        if is_there and not alone and not os.access(self.path, os.W_OK):
            # Files that this user left beside the database would keep its owner out.
            if not self._log.exists():
                self.is_alone, mode = True, _AS_IT_STANDS
        elif create and not is_there:
            with suppress(OSError):  # SQLite leaves leave for a group out
                self.path.touch()
        try:
            self._open(create, mode=mode, locking="EXCLUSIVE" if alone else "NORMAL")
        except DatabaseUnavailable as error:
            if create or alone or isinstance(error, DatabaseBusy):
                raise
            self._open_alone(error)
        # So many touches and changes are missing, until a repair accepts that.
        self._deficit = (0, 0)
        try:
            if name == FILE_NAME:
                self._deficit = self.n_lost()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the connection; closing twice does nothing."""
        with self._lock:
            self._connection.close()
            if self._count is not None:
                os.close(self._count)
                self._count = None

    def rows(self, sql: str, values: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        try:
            with self._lock, self._explained:
                return self._connection.execute(sql, values).fetchall()
        finally:
            self._check_stands()

    def _check_stands(self) -> None:
        """Refuse what was read as it stands, unlocked, of a file that changed since."""
        if self._stands and self._stands != _status(self.path, *_STAMP):
            raise DatabaseUnavailable(
                f"{self.path} must stay as it is while somebody reads it who may not "
                "write to it, but it was written to. Open the library again."
            )

    def first_row(self, sql: str, values: Sequence[Any] = ()) -> tuple[Any, ...] | None:
        return next(iter(self.rows(sql, values)), None)

    @contextmanager
    def moment(self) -> Iterator[None]:
        """Let all that is read be of one moment, whatever other programs write."""
        with self._lock:
            self.rows("BEGIN")
            try:
                yield
            finally:
                if self._connection.in_transaction:
                    self.rows("ROLLBACK")

    def count(self, sql: str, values: Sequence[Any] = ()) -> int:
        return int(self.rows(sql, values)[0][0] or 0)

    def among(self, sql: str, keys: Sequence[Any]) -> list[tuple[Any, ...]]:
        """Return rows of a query whose `IN (?)` stands for any number of keys."""
        rows = []
        for start in range(0, len(keys), AT_ONCE):
            piece = keys[start : start + AT_ONCE]
            rows += self.rows(
                sql.replace("IN (?)", f"IN {placeholders(len(piece))}"), piece
            )
        return rows

    def tally(self) -> Tally:
        row = self.first_row("SELECT n_touches, touches, n_changes, changes FROM tally")
        if row is None or [*map(type, row)] != [int, bytes, int, bytes]:
            raise DatabaseDamaged(
                f"{self.path} must be a sound database, got no count of its touches. "
                f"{REPAIR}"
            )
        return Tally(*row)

    def write(self, job: Callable[[], T]) -> T:
        """Run `job` in a transaction; when this returns, all of it is on the disk.

        Jobs of other threads that wait meanwhile run in one transaction next; one
        that fails takes back what it did alone.
        """
        outcome: Future[T] = Future()
        ticket = job, outcome
        with self._turn:
            self._waiting.append(ticket)
            try:
                self._turn.wait_for(lambda: outcome.done() or not self._busy)
            except BaseException:  # an interrupt: nobody is to do it later
                with suppress(ValueError):
                    self._waiting.remove(ticket)
                raise
            if outcome.done():  # another thread has committed it
                return outcome.result()
            self._busy = True
        try:
            while not outcome.done():
                self._commit_waiting(ticket)
        finally:
            with self._turn:
                self._busy = False
                self._turn.notify_all()
        return outcome.result()

    def run(self, sql: str, values: Sequence[Any] = ()) -> int:
        """Run one statement within a job and return how many rows it changed."""
        with self._explained:
            return self._connection.execute(sql, values).rowcount

    def run_many(self, sql: str, values: Sequence[Sequence[Any]]) -> int:
        """Run one statement per entry of `values` within a job."""
        with self._explained:
            return self._connection.executemany(sql, values).rowcount

    def get_or_insert(self, table: str, values: dict[str, Any], unique: str) -> int:
        """Return the key of a row that never changes; it is entered where it lacks."""
        row = self.first_row(
            f"SELECT rowid FROM {table} WHERE {unique} = ?", [values[unique]]
        )
        return self.insert(table, values) if row is None else int(row[0])

    def insert(self, table: str, values: dict[str, Any]) -> int:
        """Insert one row within a job and return its key."""
        cells = f"({', '.join(values)}) VALUES {placeholders(len(values))}"
        sql = f"INSERT INTO {table} {cells}"
        with self._explained:
            return int(self._connection.execute(sql, [*values.values()]).lastrowid or 0)

    def enter(self, tally: Tally) -> None:
        """Set the counts and the chains within a job."""
        self.run(
            "UPDATE tally SET n_touches = ?, touches = ?, n_changes = ?, changes = ?",
            tally,
        )

    def backup(self, target: Path, advance: Callable[[int, int], None]) -> None:
        """Copy the database to the new file `target`, while others write."""
        place = f"{self.path.absolute().as_uri()}?mode=ro"
        with ExitStack() as stack:
            stack.callback(self._check_stands)
            stack.enter_context(self._explained)
            copy = stack.enter_context(closing(sqlite3.connect(target)))
            source = self._connection
            if self.is_alone:
                stack.enter_context(self._lock)
            else:
                source = sqlite3.connect(place, uri=True, isolation_level=None)
                stack.enter_context(closing(source))
            # In one transaction: else it would begin anew whenever others write.
            source.execute("BEGIN")
            stack.callback(source.execute, "COMMIT")
            source.execute("SELECT 1 FROM tally").fetchall()
            try:
                source.backup(
                    copy,
                    pages=1024,
                    progress=lambda _, left, total: advance(left, total),
                )
            except sqlite3.OperationalError as error:
                if error.sqlite_errorname == "SQLITE_FULL":  # where the copy goes
                    raise OSError(ENOSPC, str(error)) from error
                raise

    def n_lost(self) -> tuple[int, int]:
        """Return how many touches and changes fewer there are than there once were."""
        n_touches, n_changes = self._counts() or (0, 0)  # others may add meanwhile
        now = self.tally()
        return max(0, n_touches - now.n_touches), max(0, n_changes - now.n_changes)

    def lost(self) -> str:
        """Return how many touches and changes are gone and why; empty if none is."""
        n_touches, n_changes = self.n_lost()
        if not (n_touches or n_changes):
            return ""
        return (
            f"{self.folder} once held {n_touches} more touches and {n_changes} more "
            "changes: its log was damaged, a disk lost what it had acknowledged, or an "
            f"older {FILE_NAME} took its place."
        )

    def _counts(self) -> tuple[int, int] | None:
        """Return the counts that were noted last, None where there were no touches."""
        try:
            counts = (self.folder / COUNT_NAME).read_text("ascii").split()
            n_touches, n_changes = int(counts[0]), int(counts[1])
        except (OSError, ValueError, IndexError):
            return None
        return (n_touches, n_changes) if n_touches else None

    def accept(self) -> None:
        """Take the counts as they are for right."""
        self._deficit = (0, 0)
        self.note_count()

    def note_count(self) -> None:
        """Write the counts beside the database, for whoever opens it next."""
        if self.path.name != FILE_NAME:
            return
        tally = self.tally()
        counts = (
            tally.n_touches + self._deficit[0],
            tally.n_changes + self._deficit[1],
        )
        with suppress(OSError):  # a witness more, nothing that is needed
            if self._count is None:
                path = self.folder / COUNT_NAME
                self._count = os.open(path, os.O_WRONLY | os.O_CREAT, 0o666)
            line = "{:20d} {:20d}\n".format(*counts)
            os.pwrite(self._count, line.encode(), 0)

    def _commit_waiting(self, ours: _Ticket) -> None:
        """Run the jobs that wait, in one transaction; each knows its outcome then."""
        tickets: list[_Ticket] = []
        answers: list[tuple[Future[Any], Any]] = []
        try:
            while self._waiting and len(tickets) < _TOGETHER:
                tickets.append(self._waiting[0])
                self._waiting.popleft()
            with self._lock, self._transaction():
                for ticket in tickets:
                    answers += self._run_ticket(*ticket)
        except Exception as error:
            answers.clear()
            for _, outcome in tickets:
                if not outcome.done():
                    outcome.set_exception(error)
        except BaseException:  # an interrupt concerns the job of this thread alone
            again = [t for t in tickets if t is not ours and t not in self._waiting]
            undone = [ticket for ticket in again if not ticket[1].done()]
            self._waiting.extendleft(reversed(undone))
            raise
        for outcome, answer in answers:
            outcome.set_result(answer)
        with suppress(LibraryError):
            self.note_count()

    def _run_ticket(
        self, job: Callable[[], T], outcome: Future[T]
    ) -> list[tuple[Future[T], T]]:
        """Return the answer, to be told after the commit; a failure is told at once."""
        answers = []
        self.run("SAVEPOINT job")
        try:
            answers.append((outcome, job()))
        except Exception as error:
            if not self._connection.in_transaction:  # a full disk ends all of it
                raise
            self.run("ROLLBACK TO job")
            outcome.set_exception(error)
        self.run("RELEASE job")
        return answers

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with self._explained:
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                self._refuse_moved()
                yield
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise

    def _refuse_moved(self) -> None:
        """Refuse to write what nobody would find: SQLite looks only without a WAL."""
        if not self._inode or _status(self.path, "st_ino") == self._inode:
            return
        raise LibraryError(
            f"{self.path} must be the file that was opened, but it was removed or "
            "replaced since. Put it back, or open the library again."
        )

    def _open(
        self, create: bool, *, mode: str = "rwc", locking: str = "NORMAL"
    ) -> None:
        place = f"{self.path.absolute().as_uri()}?mode={mode}"
        self._stands = _status(self.path, *_STAMP) if mode == _AS_IT_STANDS else ()
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
            self._inode = _status(self.path, "st_ino")
        except BaseException:
            self._connection.close()
            raise

    def _open_alone(self, error: DatabaseUnavailable) -> None:
        """Open where there is no room, or no leave, for the shared index of the log.

        A connection that locks out all others keeps it in its own memory. A database
        that may not be written to is read as it stands, when nothing is left in its
        log.
        """
        self.is_alone = True
        try:
            self._open(False, mode="rw", locking="EXCLUSIVE")
        except DatabaseUnavailable:
            if self._log.is_file() and self._log.stat().st_size:
                raise error from None
            try:
                self._open(False, mode=_AS_IT_STANDS)
            except DatabaseUnavailable:
                raise error from None

    def _prepare(self, create: bool, locking: str) -> None:
        # A flipped bit in a text must not hide its row: its digest tells of it.
        self._connection.text_factory = lambda text: text.decode(
            errors="backslashreplace"
        )
        with self._explained:
            run = self._connection.execute
            patience_s = _PATIENCE_ALONE_S if self.is_alone else PATIENCE_S
            run(f"PRAGMA busy_timeout = {int(patience_s * 1000)}")
            run(f"PRAGMA locking_mode = {locking}")
            run("PRAGMA synchronous = FULL")
            run("PRAGMA foreign_keys = ON")
            run("PRAGMA trusted_schema = OFF")
            run("PRAGMA cell_size_check = ON")
            run("PRAGMA temp_store = MEMORY")
            if create and self.count("PRAGMA user_version") == 0:
                self._create()
            version = self.count("PRAGMA user_version")
            application = self.count("PRAGMA application_id")
        if application == _APPLICATION and version > VERSION:
            raise OtherVersion(
                f"{self.path} has library format {version}, this palpate reads "
                f"{VERSION}. Update palpate."
            )
        if application == _APPLICATION and version in OLD_VERSIONS:
            raise OtherVersion(
                f"{self.folder} is a library of format {version}, and {VERSION} is "
                f"today's. `TouchLibrary.migrate({self.folder}, NEW)` makes one of "
                "today of it; the old one stays as it is."
            )
        if version != VERSION or application != _APPLICATION:
            raise DatabaseDamaged(
                f"{self.path} must be the database of a library of touches, got "
                "another one, or an empty file. Give another folder, or put a backup "
                "in its place."
            )

    def _create(self) -> None:
        self._connection.execute(f"PRAGMA page_size = {PAGE_BYTES}")
        self._write_ahead()
        with self._transaction():
            # Where there are some, another process was faster, or it is another
            # database.
            if not self.first_row("SELECT 1 FROM sqlite_master"):
                for statement in _TABLES.split(";"):
                    self.run(statement)
                self.run(f"PRAGMA application_id = {_APPLICATION}")
                self.run(f"PRAGMA user_version = {VERSION}")

    def _write_ahead(self) -> None:
        """Turn to write-ahead logging; SQLite does not wait where others do so too."""
        until_s = time.monotonic() + PATIENCE_S
        while True:
            try:
                self._connection.execute("PRAGMA journal_mode = WAL")
                return
            except sqlite3.OperationalError:
                if time.monotonic() > until_s:
                    raise
                time.sleep(0.01)


def _status(path: Path, *names: str) -> tuple[int, ...]:
    """Return what the disk says of a file, such as `st_ino`; nothing of none."""
    with suppress(OSError):
        status = path.stat()
        return tuple(getattr(status, name) for name in names)
    return ()


def chained(chain: bytes, digests: Sequence[bytes]) -> bytes:
    """Return the chain of digests, goes on from `chain`, with some more of them."""
    for digest in digests:
        chain = hashlib.sha256(chain + digest).digest()
    return chain


def placeholders(n_values: int) -> str:
    return f"({', '.join('?' * n_values)})"


def is_unicode(text: str) -> bool:
    return not any("\ud800" <= letter <= "\udfff" for letter in text)


def from_json(text: str) -> Any:
    """Return what stands in a cell as JSON, or say that the database is damaged."""
    try:
        return json.loads(text)
    except (TypeError, ValueError, RecursionError) as error:
        raise DatabaseDamaged(
            f"A cell of the database must be JSON, got {str(text)[:80]!r}. {REPAIR}"
        ) from error


def warn_of_network(folder: Path) -> None:
    """Warn where a folder lies on a network file system, whose locks SQLite doubts."""
    try:
        mounts = [line.split()[1:3] for line in _MOUNTS.read_text().splitlines()]
        place = folder.resolve()
    except (OSError, IndexError):
        return
    spelt = [(path.replace("\\040", " "), kind) for path, kind in mounts]
    holding = [mount for mount in spelt if place.is_relative_to(mount[0])]
    kind = max(holding, key=lambda mount: len(mount[0]), default=("", ""))[1]
    if kind.startswith(_NETWORK):
        warnings.warn(
            f"{folder} lies on a network file system ({kind}), where SQLite's locks "
            "cannot be trusted: let one machine alone use the library, or keep it on a "
            "disk of that machine and `TouchLibrary.export` it for others.",
            stacklevel=4,
        )


def make_folder(place: Path) -> None:
    """Make the folder of a library where there is none, or explain."""
    try:
        place.mkdir(parents=True, exist_ok=True)
        is_ours = any((place / name).is_file() for name in (FILE_NAME, COUNT_NAME))
        others = () if is_ours else sorted(each.name for each in place.iterdir())
    except FileExistsError:
        raise LibraryError(
            f"{place} must be a folder, got a file. Give the library another name."
        ) from None
    except OSError as error:
        raise LibraryError(
            f"{place} must be a folder that can be made, got: {error.strerror}."
        ) from error
    # Hidden files, those of a library that is being made or lost, and the model that a
    # page begins with may lie there.
    ours = FEATURES, DAMAGED, "model.palpate"
    for other in others:
        if other not in ours and not other.startswith((".", "library.", "page.")):
            raise LibraryError(
                f"{place} must be a new or empty folder, or a library, got {other} in "
                "it. Give the library a folder of its own."
            )


def refuse_used(folder: Path) -> None:
    """Refuse a folder that is not new or empty."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        got = "files in it" if folder.is_dir() else "a file"
        raise LibraryError(
            f"{folder} must be a new or empty folder, got {got}. Give another one."
        )


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


# What keeps a sound database from being used.
_UNUSABLE = {
    *("SQLITE_FULL", "SQLITE_IOERR", "SQLITE_CANTOPEN", "SQLITE_READONLY"),
    "SQLITE_NOMEM",
}
_FREE = (
    "Free space on the disk, check that the folder, the file, and its -wal and -shm "
    "may be written to, and try again; what was acknowledged is kept."
)
REPAIR = (
    "It is damaged; `TouchLibrary.repair_folder` keeps what can be read, and the "
    "damaged file as well."
)
_WAIT = "Another program has been writing for a minute; wait, or end it."
_CHECK = "Check that the folder may be written to, and call `check_library`."


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
            raise _explanation(self.path, error) from error
        if isinstance(error, UnicodeDecodeError):  # in what SQLite quotes
            raise DatabaseDamaged(
                f"{self.path} must be a sound database, got: {error}. {REPAIR}"
            ) from error
        if isinstance(error, UnicodeEncodeError):
            raise LibraryError(
                f"Texts must be such as UTF-8 can hold, got {error.object[:80]!r}. "
                "Leave out what no program can print."
            ) from error


def _explanation(path: Path, error: sqlite3.Error) -> LibraryError:
    """Return what SQLite stumbled over as one sentence with the fix."""
    name = "_".join(getattr(error, "sqlite_errorname", "").split("_")[:2])
    start = f"{path} must be a sound database, got: {error}. "
    unusable = f"{path} must be readable and writable, got: {error}. "
    lacks = str(error).startswith(("no such table", "no such column"))
    if lacks or name in ("SQLITE_CORRUPT", "SQLITE_NOTADB"):
        return DatabaseDamaged(start + REPAIR)
    if name in ("SQLITE_BUSY", "SQLITE_LOCKED", "SQLITE_PROTOCOL"):
        return DatabaseBusy(unusable + _WAIT)
    if name in _UNUSABLE:
        return DatabaseUnavailable(unusable + _FREE)
    if "closed" in str(error):
        return LibraryError(f"{start}The library was closed; open it again.")
    return LibraryError(start + _CHECK)
