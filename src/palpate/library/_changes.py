"""Renaming, merging and retracting: every change is recorded, nothing is erased.

A change is written to a small file of its own before it enters the database, so
that a lost database can be rebuilt with all changes in their order.
"""

import hashlib
import json
import os
import secrets
import time
import unicodedata
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from ._database import Database
from ._errors import LibraryError
from ._files import CHANGES, PARTIAL, flush_folder
from ._sheet import canonical


def make_change(database: Database, folder: Path, content: dict[str, Any]) -> int:
    """Record a change and carry it out; return how many rows it concerned."""
    now = time.time()
    name = f"{int(now * 1e6):017d}-{secrets.token_hex(4)}"
    content = {**content, "time_s": now}
    content["digest"] = _digest(content)
    path = _path(folder, name)
    try:
        with database.writing():
            n_changed = apply_change(database, name, content)
            if n_changed:
                write_change(folder, name, content)
            else:
                database.run("DELETE FROM changes WHERE name = ?", [name])
    except LibraryError:
        with suppress(OSError):
            path.unlink()
        raise
    return n_changed


def apply_change(database: Database, name: str, content: dict[str, Any]) -> int:
    """Carry out a change inside a transaction; return how many rows it concerned."""
    change = enter_change(database, name, content)
    return _ACTIONS[content["action"]](database, change, content)


def enter_change(database: Database, name: str, content: dict[str, Any]) -> int:
    """Enter a change inside a transaction without carrying it out; return its key."""
    return database.added(
        "INSERT INTO changes (name, time_s, action, content) VALUES (?, ?, ?, ?)",
        [name, content["time_s"], content["action"], canonical(_brief(content))],
    )


def read_change(path: Path) -> dict[str, Any]:
    """Return the change in a file.

    Raises
    ------
    OSError, ValueError
        The file is missing, is none, or is not as it was written.
    """
    content = json.loads(path.read_text("utf-8"))
    if not isinstance(content, dict) or str(content.get("action")) not in _ACTIONS:
        raise ValueError("no change")
    if not isinstance(content.get("time_s"), float):
        raise ValueError("a change without a time")
    if content.get("digest", _digest(content)) != _digest(content):
        raise ValueError("altered content")
    return content


def change_files(folder: Path) -> dict[str, Path]:
    """Return the files of all changes by name."""
    return {path.stem: path for path in sorted((folder / CHANGES).glob("*.json"))}


def known_changes(database: Database) -> dict[str, dict[str, Any]]:
    """Return what the database keeps of each change, by name."""
    rows = database.rows("SELECT name, content FROM changes ORDER BY id")
    return {name: json.loads(text) for name, text in rows}


def file_fault(folder: Path, name: str, brief: dict[str, Any]) -> str | None:
    """Return what is wrong with the file of a change that the database knows."""
    try:
        content = read_change(_path(folder, name))
    except OSError as error:
        return str(error.strerror or error)
    except ValueError:
        return "altered content"
    return None if _brief(content) == brief else "altered content"


def change_again(
    database: Database, name: str, brief: dict[str, Any]
) -> dict[str, Any]:
    """Return a change whose file is gone, as far as the database still tells.

    Of a retraction these are the touches that it still leaves out, of a restoration
    all that are in: carried out in their order, all changes end where they did.
    """
    content = {n: v for n, v in brief.items() if n != "digest"}
    found = {
        "retract": "c.name = ?",
        "restore": "t.retraction IS NULL AND ? IS NOT NULL",
    }.get(brief["action"])
    if found is not None:
        rows = database.rows(
            "SELECT lower(hex(t.id)) FROM touches t "
            f"LEFT JOIN changes c ON c.id = t.retraction WHERE {found}",
            [name],
        )
        content["ids"] = [row[0] for row in rows]
    return {**content, "digest": _digest(content)}


def write_again(database: Database, folder: Path, name: str) -> None:
    """Write the file of a change anew from what the database tells of it."""
    content = change_again(database, name, known_changes(database)[name])
    with database.writing():
        brief = canonical(_brief(content))
        database.run("UPDATE changes SET content = ? WHERE name = ?", [brief, name])
        write_change(folder, name, content)


def renamings(database: Database) -> list[tuple[str, str]]:
    """Return the old and the new name of every rename and merge, newest first."""
    rows = database.rows(
        "SELECT content FROM changes WHERE action IN ('rename', 'merge') "
        "ORDER BY id DESC"
    )
    told = [json.loads(row[0]) for row in rows]
    return [(t.get("old", t.get("source")), t.get("new", t.get("into"))) for t in told]


def object_key(database: Database, name: str) -> int:
    """Return the key of an object, that of the one it was merged into."""
    row = None
    if isinstance(name, str) and is_unicode(name):
        row = database.one(
            "SELECT coalesce(merged_into, id) FROM objects WHERE name = ?", [name]
        )
    if row is None:
        known = [r[0] for r in database.rows("SELECT name FROM objects ORDER BY name")]
        listed = ", ".join(map(repr, known[:20])) + ", ..." * (len(known) > 20)
        raise LibraryError(
            f"object must be one in the library ({listed or 'it has none'}), got "
            f"{name!r}."
        )
    return int(row[0])


def current_name(database: Database, name: str) -> str:
    """Return what an object is called now, that of the one it was merged into."""
    key = object_key(database, name)
    row = database.one("SELECT name FROM objects WHERE id = ?", [key])
    return name if row is None else str(row[0])


def _rename(database: Database, change: int, content: dict[str, Any]) -> int:
    old, new = content["old"], checked_name(content["new"])
    key = object_key(database, old)
    if database.one("SELECT id FROM objects WHERE name = ?", [new]):
        raise LibraryError(
            f"The new name must not be taken, got {new!r}. To make two objects one, "
            f"merge {old!r} into it."
        )
    return database.run("UPDATE objects SET name = ? WHERE id = ?", [new, key])


def _merge(database: Database, change: int, content: dict[str, Any]) -> int:
    source = object_key(database, content["source"])
    into = object_key(database, content["into"])
    if source == into:
        raise LibraryError(
            f"Objects to merge must be two, got {content['source']!r} and "
            f"{content['into']!r}, which are one."
        )
    return database.run(
        "UPDATE objects SET merged_into = ? WHERE id = ? OR merged_into = ?",
        [into, source, source],
    )


def _retract(database: Database, change: int, content: dict[str, Any]) -> int:
    return _mark(database, content["ids"], "retraction IS NULL", change)


def _restore(database: Database, change: int, content: dict[str, Any]) -> int:
    return _mark(database, content["ids"], "retraction IS NOT NULL", None)


def _mark(
    database: Database, ids: Sequence[str], before: str, retraction: int | None
) -> int:
    return database.run_many(
        f"UPDATE touches SET retraction = ? WHERE id = ? AND {before}",
        [(retraction, bytes.fromhex(key)) for key in ids],
    )


def _leave_out(database: Database, change: int, content: dict[str, Any]) -> int:
    """Note that arrays of whole recordings are lost; reading still tries them."""
    return len(content["arrays"])


_ACTIONS: dict[str, Callable[[Database, int, dict[str, Any]], int]] = {
    "rename": _rename,
    "merge": _merge,
    "retract": _retract,
    "restore": _restore,
    "leave_out": _leave_out,
}


def checked_name(name: object) -> str:
    """Return a new name of an object, or say what is wrong with it."""
    if not isinstance(name, str) or not name.strip():
        raise LibraryError(f"The new name must be a text, got {name!r}. Give one.")
    if any(unicodedata.category(letter) in ("Cc", "Cs") for letter in name):
        raise LibraryError(
            "The new name must be of letters that can be printed, got "
            f"{name!r}. Leave out line breaks and control characters."
        )
    return name


def is_unicode(text: str) -> bool:
    """Tell whether UTF-8, and so the database, can hold a text."""
    return not any(unicodedata.category(letter) == "Cs" for letter in text)


def _brief(content: dict[str, Any]) -> dict[str, Any]:
    """Return what the database keeps of a change: not its list of ids."""
    return {n: v for n, v in content.items() if n != "ids"}


def _digest(content: dict[str, Any]) -> str:
    plain = {n: v for n, v in content.items() if n != "digest"}
    return hashlib.sha256(canonical(plain).encode()).hexdigest()


def _path(folder: Path, name: str) -> Path:
    return folder / CHANGES / f"{name}.json"


def write_change(folder: Path, name: str, content: dict[str, Any]) -> None:
    """Put the file of a change in place; afterwards it is on the disk."""
    path = _path(folder, name)
    partial = path.with_name(f"{PARTIAL}{secrets.token_hex(8)}")
    try:
        path.parent.mkdir(exist_ok=True)
        with partial.open("xb") as file:
            file.write(canonical(content).encode())
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
        flush_folder(path.parent)
    except OSError as error:
        raise LibraryError(
            f"{path.parent} must have room for the change, got: "
            f"{error.strerror or error}. Nothing was changed; free space and try again."
        ) from error
    finally:
        with suppress(OSError):
            partial.unlink()
