"""Renaming, merging and retracting: every change is recorded, nothing is erased.

A change is written to a small file of its own before it enters the database, so
that a lost database can be rebuilt with all changes in their order.
"""

import hashlib
import json
import secrets
import time
import unicodedata
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from .._durable import write_text
from ._rows import id_bytes, read_rows
from ._sheet import canonical
from ._store import CHANGES, LibraryError, Store, is_unicode, room_for


def make_change(store: Store, **content: Any) -> int:
    """Record a change and carry it out; return how many rows it concerned."""
    now = time.time()
    name = f"{int(now * 1e6):017d}-{secrets.token_hex(4)}"
    content["time_s"] = now
    content["digest"] = _digest(content)
    try:
        with store.writing():
            n_changed = apply_change(store, name, content)
            if n_changed:
                _write_change(store, name, content)
            else:
                store.run("DELETE FROM changes WHERE name = ?", [name])
    except LibraryError:
        with suppress(OSError):
            _path(store, name).unlink()
        raise
    return n_changed


def apply_change(store: Store, name: str, content: dict[str, Any]) -> int:
    """Carry out a change inside a transaction; return how many rows it concerned."""
    change = enter_change(store, name, content)
    return _ACTIONS[content["action"]](store, change, content)


def enter_change(store: Store, name: str, content: dict[str, Any]) -> int:
    """Enter a change inside a transaction without carrying it out; return its key."""
    known = {n: content[n] for n in ("time_s", "action")}
    values = {"name": name, **known, "content": canonical(_brief(content))}
    return store.insert("changes", values)


def read_change(path: Path) -> dict[str, Any]:
    """Return the change in a file; OSError or ValueError where it is none."""
    content = json.loads(path.read_text("utf-8"))
    if not isinstance(content, dict) or str(content.get("action")) not in _ACTIONS:
        raise ValueError("no change")
    if not isinstance(content.get("time_s"), float):
        raise ValueError("a change without a time")
    if content.get("digest", _digest(content)) != _digest(content):
        raise ValueError("altered content")
    return content


def change_files(store: Store) -> dict[str, Path]:
    """Return the files of all changes by name."""
    return {path.stem: path for path in sorted((store.folder / CHANGES).glob("*.json"))}


def known_changes(store: Store) -> dict[str, dict[str, Any]]:
    """Return what the database keeps of each change, by name."""
    rows = store.rows("SELECT name, content FROM changes ORDER BY id")
    return {name: json.loads(text) for name, text in rows}


def file_fault(store: Store, name: str, brief: dict[str, Any]) -> str | None:
    """Return what is wrong with the file of a change that the database knows."""
    try:
        content = read_change(_path(store, name))
    except OSError as error:
        return str(error.strerror or error)
    except ValueError:
        return "altered content"
    return None if _brief(content) == brief else "altered content"


def write_again(store: Store, name: str) -> None:
    """Write the file of a change anew, as far as the database still knows it.

    Of a retraction these are the touches that it still leaves out, of a restoration all
    that are in: carried out in their order, all changes end where they did.
    """
    brief = known_changes(store)[name]
    content = {n: v for n, v in brief.items() if n != "digest"}
    if brief["action"] in ("retract", "restore"):
        left_out_by = name if brief["action"] == "retract" else None
        rows = read_rows(store, ("id",), "WHERE c.name IS ?", [left_out_by])
        content["ids"] = [row[0] for row in rows]
    content["digest"] = _digest(content)
    with store.writing():
        text = canonical(_brief(content))
        store.run("UPDATE changes SET content = ? WHERE name = ?", [text, name])
        _write_change(store, name, content)


def renamings(store: Store) -> list[tuple[str, str]]:
    """Return the old and the new name of every rename and merge, newest first."""
    rows = store.rows(
        "SELECT content FROM changes WHERE action IN ('rename', 'merge') "
        "ORDER BY id DESC"
    )
    known = [json.loads(row[0]) for row in rows]
    return [(c.get("old", c.get("source")), c.get("new", c.get("into"))) for c in known]


def find_object(store: Store, name: str | None) -> tuple[int, str] | None:
    """Return key and present name of an object, of the one it was merged into."""
    row = store.one(
        "SELECT o.id, o.name FROM objects given "
        "JOIN objects o ON o.id = coalesce(given.merged_into, given.id) "
        "WHERE given.name = ?",
        [name],
    )
    return None if row is None else (int(row[0]), str(row[1]))


def known_object(store: Store, name: str) -> tuple[int, str]:
    """Return key and present name of an object, or say that there is none."""
    is_name = isinstance(name, str) and is_unicode(name)
    found = find_object(store, name) if is_name else None
    if found is None:
        known = [r[0] for r in store.rows("SELECT name FROM objects ORDER BY name")]
        listed = ", ".join(map(repr, known[:20])) + ", ..." * (len(known) > 20)
        raise LibraryError(
            f"object must be one in the library ({listed or 'it has none'}), got "
            f"{name!r}."
        )
    return found


def chosen_ids(
    store: Store, ids: str | Iterable[str] | None, name: str | None, state: str
) -> list[str]:
    """Return the ids of given touches, or of an object's touches in this state."""
    if (ids is None) == (name is None):
        raise ValueError("Give either ids or object, got both or neither.")
    if name is not None:
        rows = store.rows(
            "SELECT lower(hex(t.id)) FROM touches t "
            "JOIN objects o ON o.id = t.object "
            f"WHERE coalesce(o.merged_into, o.id) = ? AND t.retraction {state}",
            known_object(store, name)[:1],
        )
        return [row[0] for row in rows]
    given = [ids] if isinstance(ids, str) else list(ids or [])
    for key in given:
        if store.one("SELECT 1 FROM touches WHERE id = ?", [id_bytes(key)]) is None:
            raise LibraryError(
                f"ids must be of touches in the library, got {key!r}. "
                "See `palpate library list`."
            )
    return given


def _rename(store: Store, change: int, content: dict[str, Any]) -> int:
    old, new = content["old"], _checked_name(content["new"])
    key, _ = known_object(store, old)
    if store.one("SELECT id FROM objects WHERE name = ?", [new]):
        raise LibraryError(
            f"The new name must not be taken, got {new!r}. To make two objects one, "
            f"merge {old!r} into it."
        )
    return store.run("UPDATE objects SET name = ? WHERE id = ?", [new, key])


def _merge(store: Store, change: int, content: dict[str, Any]) -> int:
    source, _ = known_object(store, content["source"])
    into, _ = known_object(store, content["into"])
    if source == into:
        raise LibraryError(
            f"Objects to merge must be two, got {content['source']!r} and "
            f"{content['into']!r}, which are one."
        )
    return store.run(
        "UPDATE objects SET merged_into = ? WHERE id = ? OR merged_into = ?",
        [into, source, source],
    )


def _leave_out(store: Store, change: int | None, ids: list[str]) -> int:
    """Retract touches by a change; take retracted ones back in where it is None."""
    return store.run_many(
        "UPDATE touches SET retraction = ? WHERE id = ? AND (retraction IS NULL) = ?",
        [(change, bytes.fromhex(key), change is not None) for key in ids],
    )


_ACTIONS: dict[str, Callable[[Store, int, dict[str, Any]], int]] = {
    "rename": _rename,
    "merge": _merge,
    "retract": lambda store, change, content: _leave_out(store, change, content["ids"]),
    "restore": lambda store, change, content: _leave_out(store, None, content["ids"]),
    # Arrays of whole recordings are lost: only noted, reading still tries them.
    "leave_out": lambda store, change, content: len(content["arrays"]),
}


def _checked_name(name: object) -> str:
    """Return a new name of an object, or say what is wrong with it."""
    if not isinstance(name, str) or not name.strip():
        raise LibraryError(f"The new name must be a text, got {name!r}. Give one.")
    if any(unicodedata.category(letter) in ("Cc", "Cs") for letter in name):
        raise LibraryError(
            "The new name must be of letters that can be printed, got "
            f"{name!r}. Leave out line breaks and control characters."
        )
    return name


def _brief(content: dict[str, Any]) -> dict[str, Any]:
    """Return what the database keeps of a change: not its list of ids."""
    return {n: v for n, v in content.items() if n != "ids"}


def _digest(content: dict[str, Any]) -> str:
    plain = {n: v for n, v in content.items() if n != "digest"}
    return hashlib.sha256(canonical(plain).encode()).hexdigest()


def _path(store: Store, name: str) -> Path:
    return store.folder / CHANGES / f"{name}.json"


def _write_change(store: Store, name: str, content: dict[str, Any]) -> None:
    """Put the file of a change in place; afterwards it is on the disk."""
    path = _path(store, name)
    fix = "Nothing was changed; free space and try again."
    with room_for("the change", path.parent, fix):
        path.parent.mkdir(exist_ok=True)
        write_text(path, canonical(content))
