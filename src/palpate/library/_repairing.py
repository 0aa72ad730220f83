"""Make a damaged library whole as far as its files allow; nothing is deleted."""

import secrets
import time
from contextlib import closing, suppress
from pathlib import Path
from typing import NamedTuple

from .._durable import PARTIAL, flush_folder
from . import _changes as changes
from . import _checking as checking
from . import _rows, _store
from ._entering import enter_all, enter_lost_rows, set_aside, sheet_in
from ._files import Sheet, adopt, file_path, publish
from ._reading import is_whole, read_images
from ._rows import MISSING, SET_ASIDE, StoredTouch, layouts, move_rows, recordings
from ._store import IMAGES, SEALED, DatabaseDamaged, DatabaseUnavailable, Store

_STALE_S = 86_400.0
_LOGS = ("-wal", "-shm", "-journal")
_KEYS = ("object", "layout", "recording", "file", "retraction")
# What the old database knows, by names and digests: keys may be others, and its
# indexes damaged.
_CARRY = """
INSERT OR IGNORE INTO objects (name, category) SELECT name, category
    FROM old.objects NOT INDEXED;
UPDATE objects SET merged_into = (
    SELECT n.id FROM old.objects g JOIN old.objects r ON r.id = g.merged_into
    JOIN main.objects n ON n.name = r.name WHERE g.name = objects.name)
    WHERE merged_into IS NULL;
INSERT OR IGNORE INTO recordings ({recordings}) SELECT {recordings}
    FROM old.recordings NOT INDEXED;
INSERT OR IGNORE INTO layouts (columns) SELECT columns FROM old.layouts NOT INDEXED;
INSERT OR IGNORE INTO files (name, n_touches, offset)
    SELECT name, n_touches, offset FROM old.files NOT INDEXED;
INSERT OR IGNORE INTO touches ({touches}, object, layout, recording, file, retraction)
    SELECT {touches},
    (SELECT n.id FROM objects n JOIN old.objects o USING (name) WHERE o.id = t.object),
    (SELECT n.id FROM layouts n JOIN old.layouts o USING (columns)
        WHERE o.id = t.layout),
    (SELECT n.id FROM recordings n JOIN old.recordings o USING (digest)
        WHERE o.id = t.recording),
    (SELECT n.id FROM files n JOIN old.files o USING (name) WHERE o.id = t.file),
    (SELECT n.id FROM changes n JOIN old.changes o USING (name)
        WHERE o.id = t.retraction)
    FROM old.touches t WHERE number NOT IN ({damaged}) ORDER BY number
"""


class RepairReport(NamedTuple):
    """What a repair did.

    `rebuilt` tells whether the database was made anew from the files; `n_recovered`
    counts touches that it did not know (any more), `n_set_aside` those retracted
    since their image is gone, `n_restored` those whose image is back; `n_changes`
    counts changes carried out or written anew, `n_left_out` arrays of whole
    recordings (no-contact images) that are gone, `n_unacknowledged` changes set aside
    that a killed writer never told anyone of, since later ones are known.
    """

    rebuilt: bool
    n_recovered: int
    n_set_aside: int
    n_restored: int
    n_changes: int
    n_left_out: int
    n_unacknowledged: int


def repair_library(folder: str | Path, *, progress: bool | None = None) -> RepairReport:
    """Make a damaged library whole as far as its files allow; nothing is deleted.

    A database that is damaged or lost is made anew from the image files, which carry
    all labels, and from the recorded changes; the old one is set aside when the new
    one is complete. Changes that a sound database lacks are carried out, unless it
    knows later ones: those were never acknowledged, and are set aside. Touches
    whose image is missing or altered are retracted with that reason, and come back
    when it does or when they are added again. Nobody else may be writing meanwhile.

    Parameters
    ----------
    folder : path
        The library.
    progress : bool, optional
        As for `check_library`.

    Raises
    ------
    LibraryError
        A newer palpate made the library, there is none, or the disk is full or not
        to be read: then the library is left as it was.
    """
    folder = Path(folder)
    adopted = adopt(folder / IMAGES)
    gained = _make_anew(folder) if _is_damaged(folder) else None
    with closing(Store(folder)) as store:
        n_recovered, n_changes = gained or enter_all(store, anew=False)
        n_mended, n_aside = _mend_changes(store)
        n_changes += n_mended
        lost, found = _lost_and_found(store, progress)
        if lost:
            changes.make_change(store, action="retract", ids=lost, reason=MISSING)
        if found:
            changes.make_change(store, action="restore", ids=found)
        n_left_out = _leave_out_arrays(store)
        enter_lost_rows(store, adopted)
        # Partial files that no living writer can be writing.
        for path in folder.rglob(f"{PARTIAL}*"):
            with suppress(OSError):
                if time.time() - path.stat().st_mtime > _STALE_S:
                    path.unlink()
    counts = n_recovered, len(lost), len(found), n_changes, n_left_out, n_aside
    return RepairReport(gained is not None, *counts)


def _is_damaged(folder: Path) -> bool:
    """Tell whether the database is damaged; a failing disk is no damage."""
    try:
        with closing(Store(folder)) as store:
            found = checking.database_problems(store) or checking.row_problems(store)
            return bool(found)
    except (_store.NewerLibrary, DatabaseUnavailable):
        raise
    except _store.LibraryError as error:
        if not isinstance(error, DatabaseDamaged) and not _store.holds_files(folder):
            raise
        return True


def _make_anew(folder: Path) -> tuple[int, int]:
    """Make the database from the files, and only then set the old one aside."""
    path = folder / _store.FILE_NAME
    partial = folder / f"{PARTIAL}{secrets.token_hex(8)}.sqlite"
    try:
        with closing(Store(folder, create=True, name=partial.name)) as store:
            gained = enter_all(store, anew=True)
            _carry_over(store, path)
            store.rows("PRAGMA main.wal_checkpoint(TRUNCATE)")
        set_aside(folder, *_with_logs(path))
        partial.replace(path)
        flush_folder(folder)
    except (OSError, DatabaseUnavailable) as error:
        raise _store.LibraryError(
            f"{folder} must have room for a new database, got: {error} The old one is "
            "left as it was; free space and repair again."
        ) from error
    finally:
        for left in _with_logs(partial):
            with suppress(OSError):
                left.unlink()
    return gained


def _with_logs(path: Path) -> list[Path]:
    """Return the files of a database, its logs first: none may meet another one."""
    return [*(path.with_name(f"{path.name}{log}") for log in _LOGS), path]


def _carry_over(store: Store, path: Path) -> None:
    """Take in what an old database alone still knows: touches without a sound file."""
    plain = [n for n in SEALED["touches"][1:] if n not in _KEYS]
    try:
        with closing(Store(path.parent)) as old:
            if not old.sealed or any(old.broken(t) for t in SEALED if t != "touches"):
                return
            damaged = ", ".join(map(str, old.broken("touches")))
        store.rows("ATTACH ? AS old", [str(path)])
        touches, recorded = ", ".join(plain), ", ".join(SEALED["recordings"][1:])
        names = {"damaged": damaged, "touches": touches, "recordings": recorded}
        with store.writing():
            for statement in _CARRY.format(**names).split(";"):
                store.run(statement)
    except DatabaseUnavailable:
        raise
    except _store.LibraryError:
        return


def _mend_changes(store: Store) -> tuple[int, int]:
    """Write damaged files of changes anew, set aside those that are not known.

    Return how many there are of each, of the latter those that are changes at all.
    """
    known, files = changes.known_changes(store), changes.change_files(store)
    bad = [name for name in known if changes.file_fault(store, name, known[name])]
    set_aside(store.folder, *(files[n] for n in bad if n in files))
    for name in bad:
        changes.write_again(store, name)
    unknown = [path for name, path in files.items() if name not in known]
    n_changes = 0
    for path in unknown:
        with suppress(OSError, ValueError):
            n_changes += bool(changes.read_change(path))
    set_aside(store.folder, *unknown)
    return len(bad), n_changes


def _lost_and_found(store: Store, progress: bool | None) -> tuple[list[str], list[str]]:
    """Return touches whose image is gone, and those set aside whose image is back."""
    lost: list[str] = []
    found: list[str] = []
    for key, name in checking.image_files(store, "Reading files", progress):
        for problem in checking.image_problem(store, key, name):
            lost += problem.touches
            _write_sheets_again(store, key, name)
        rows = checking.touches_in(store, key, f"t.retraction IN ({SET_ASIDE})")
        if rows and sheet_in(store, name) is not None:
            found += [row.key.hex() for row in rows]
    return lost, found


def _write_sheets_again(store: Store, file: int, name: str) -> None:
    """Write touches whose images are whole, in a file that is not, to new files."""
    rows = checking.touches_in(store, file, "1")
    names, described, forms = changes.Names(store), recordings(store), layouts(store)
    mended = False
    groups: dict[tuple[int, int, float], list[tuple[StoredTouch, str | None]]] = {}
    for row in (row for row in rows if is_whole(store, row)):
        [(recording, added_s, label)] = store.rows(
            "SELECT t.recording, t.added_s, given.name FROM touches t "
            "LEFT JOIN objects given ON given.id = t.object WHERE t.id = ?",
            [row.key],
        )
        same = groups.setdefault((row.layout, recording, added_s), [])
        same.append((row, names.before(label, added_s)))
    for (layout, recording, added_s), pairs in groups.items():
        touches, labels = [row for row, _ in pairs], [label for _, label in pairs]
        values = _rows.plain_values(touches)
        cells = {c.name: [v.get(c.name) for v in values] for c in forms[layout]}
        sheet = Sheet(
            forms[layout],
            cells | ({"object": labels} if "object" in cells else {}),
            {},
            read_images(store.folder, touches),
            described[recording],
            added_s,
            [row.key for row in touches],
            [row.digest for row in touches],
        )
        with _store.room_for("touches", store.folder, "Free space and repair again."):
            new = publish(store.images, *sheet.packed())
        with store.writing():
            move_rows(store, sheet, new)
        mended = mended or new == name
    if not mended:
        set_aside(store.folder, file_path(store.images, name))


def _leave_out_arrays(store: Store) -> int:
    """Set altered arrays aside and note them, so that the rest is read without them."""
    bad = checking.array_problems(store)
    set_aside(store.folder, *(store.folder / problem.path for problem in bad))
    known = checking.left_out(store)
    names = [n for problem in bad if (n := Path(problem.path).stem) not in known]
    if names:
        changes.make_change(store, action="leave_out", arrays=names)
    return len(names)
