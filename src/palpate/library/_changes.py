"""Renaming, merging and retracting: every change is recorded, nothing is erased.

A change is written to a small file of its own before it enters the database, so
that a lost database can be rebuilt with all changes in their order.
"""

import json
import os
import secrets
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from ._database import Database
from ._errors import LibraryError
from ._files import PARTIAL, flush_folder
from ._sheet import canonical

CHANGES = "changes"


def make_change(database: Database, folder: Path, content: dict[str, Any]) -> int:
    """Record a change and carry it out; return how many rows it concerned."""
    now = time.time()
    name = f"{int(now * 1e6):017d}-{secrets.token_hex(4)}"
    content = {**content, "time_s": now}
    with database.writing():
        n_changed = apply_change(database, name, content)
        if n_changed:
            _write(folder / CHANGES / f"{name}.json", canonical(content))
    return n_changed


def apply_change(database: Database, name: str, content: dict[str, Any]) -> int:
    """Carry out a change inside a transaction; return how many rows it concerned."""
    carry_out = {
        "rename": _rename,
        "merge": _merge,
        "retract": _retract,
        "restore": _restore,
    }[content["action"]]
    change = database.added(
        "INSERT INTO changes (name, time_s, action, content) VALUES (?, ?, ?, ?)",
        [name, content["time_s"], content["action"], _brief(content)],
    )
    n_changed = carry_out(database, change, content)
    if not n_changed:
        database.run("DELETE FROM changes WHERE id = ?", [change])
    return n_changed


def read_change(path: Path) -> dict[str, Any]:
    """Return the change in a file.

    Raises
    ------
    ValueError
        The file is none.
    """
    content = json.loads(path.read_text("utf-8"))
    if not isinstance(content, dict) or "action" not in content:
        raise ValueError(f"{path} is no change")
    return content


def object_key(database: Database, name: str) -> int:
    """Return the key of an object, that of the one it was merged into."""
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


def _rename(database: Database, change: int, content: dict[str, Any]) -> int:
    old, new = content["old"], content["new"]
    if not isinstance(new, str) or not new.strip():
        raise LibraryError(f"The new name must be a text, got {new!r}.")
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


def _brief(content: dict[str, Any]) -> str:
    """Return what the database keeps of a change: not its list of ids."""
    return canonical({n: v for n, v in content.items() if n != "ids"})


def _write(path: Path, text: str) -> None:
    partial = path.with_name(f"{PARTIAL}{secrets.token_hex(8)}")
    try:
        path.parent.mkdir(exist_ok=True)
        with partial.open("xb") as file:
            file.write(text.encode())
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
