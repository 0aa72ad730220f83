"""Renaming, merging and retracting: every change is recorded, nothing is erased.

A change is written to a small file of its own before it enters the database, so
that a lost database can be rebuilt with all changes in their order.
"""

import hashlib
import json
import secrets
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from .._checks import did_you_mean, one_spelling
from .._durable import write_text
from ._files import canonical
from ._rows import id_bytes, read_rows
from ._store import CHANGES, LibraryError, Store, from_json, is_unicode, room_for

_LAST = "SELECT name FROM changes ORDER BY id DESC LIMIT 1"


def make_change(store: Store, **content: Any) -> int:
    """Record a change and carry it out; return how many rows it concerned."""
    name = ""
    try:
        with store.writing():
            now = max(time.time(), next_time(store, "touches", "added_s"))
            now = content["time_s"] = max(now, next_time(store))
            content["after"] = (store.one(_LAST) or [None])[0]
            name = f"{int(now * 1e6):017d}-{secrets.token_hex(4)}"
            content["digest"] = _digest(content)
            n_changed = apply_change(store, name, content)
            if n_changed:
                _write_change(store, name, content)
            else:
                store.run("DELETE FROM changes WHERE name = ?", [name])
    except LibraryError:
        with suppress(OSError):  # without a name there is no such file
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


def readable_changes(files: dict[str, Path]) -> dict[str, dict[str, Any]]:
    found = {}
    for name, path in files.items():
        with suppress(OSError, ValueError):
            found[name] = read_change(path)
    return found


def change_files(store: Store) -> dict[str, Path]:
    return {path.stem: path for path in sorted((store.folder / CHANGES).glob("*.json"))}


def known_changes(store: Store) -> dict[str, dict[str, Any]]:
    """Return what the database keeps of each change, by name."""
    rows = store.rows("SELECT name, content FROM changes ORDER BY id")
    return {name: from_json(text) for name, text in rows}


def told_changes(contents: dict[str, dict[str, Any]]) -> set[str]:
    """Return the changes that somebody was told of, or may have been: the last one.

    Each names the one it came `after`. One that no later one leads to was written by
    a killed writer and never entered a database.
    """
    names = sorted(contents, key=lambda name: contents[name]["time_s"])
    told = set()
    while names:
        told.add(name := names.pop())
        after = contents[name].get("after", "")  # older files do not say
        while names and (after is None or after in names[:-1]):
            names.pop()
    return told


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


def next_time(store: Store, table: str = "changes", column: str = "time_s") -> float:
    """Return the earliest time that comes after what was entered last."""
    last = store.one(f"SELECT {column} FROM {table} ORDER BY rowid DESC LIMIT 1")
    return last[0] + 2e-6 if last else 0.0


class Names:
    """What objects were called and are called, from all changes of names."""

    def __init__(self, store: Store) -> None:
        rows = store.rows(
            "SELECT time_s, action, content FROM changes "
            "WHERE action IN ('rename', 'merge') ORDER BY id"
        )
        self.known = [
            (time_s, action, c.get("old", c.get("source")), c.get("new", c.get("into")))
            for time_s, action, text in rows
            for c in [from_json(text)]
        ]

    def now(
        self, label: str | None, since_s: float, *, merged: bool = True
    ) -> str | None:
        """Return what an object is called that had this name at a time.

        With `merged=False` merges are not followed: the name of the object itself, even
        if it was merged into another.
        """
        for time_s, action, old, new in self.known:
            if not merged and action == "merge":
                continue
            if old == label and (time_s > since_s or action == "merge"):
                label, since_s = new, time_s  # a merged name stays with its object
        return label

    def before(self, name: str | None, time_s: float) -> str | None:
        """Return what an object, not what it was merged into, was called at a time."""
        for changed_s, action, old, new in reversed(self.known):
            if action == "rename" and changed_s > time_s and new == name:
                name = old
        return name


def retract_again(store: Store, after: int) -> None:
    """Leave out touches with numbers `after` this one as known changes say."""
    rows = store.rows("SELECT lower(hex(id)) FROM touches WHERE number > ?", [after])
    if not (new := {row[0] for row in rows}):
        return
    for key, name, action in store.rows(
        "SELECT id, name, action FROM changes WHERE action IN ('retract', 'restore') "
        "ORDER BY id"
    ):
        ids = []
        with suppress(OSError, ValueError):
            ids = [i for i in read_change(_path(store, name))["ids"] if i in new]
        if ids:
            with store.writing():
                _leave_out(store, key if action == "retract" else None, ids)


def find_object(store: Store, name: str | None) -> tuple[int, str] | None:
    """Return key and present name of an object, of the one it was merged into."""
    row = store.one(
        "SELECT o.id, o.name FROM objects given "
        "JOIN objects o ON o.id = coalesce(given.merged_into, given.id) "
        "WHERE given.id = ?",
        [store.key_of("objects", "name", name)],
    )
    return None if row is None else (int(row[0]), str(row[1]))


def known_object(store: Store, name: str) -> tuple[int, str]:
    is_name = isinstance(name, str) and is_unicode(name)
    found = find_object(store, name) if is_name else None
    if found is None and is_name and (spelling := one_spelling(name)):
        found = find_object(store, spelling)
    if found is None:
        known = [r[0] for r in store.rows("SELECT name FROM objects ORDER BY name")]
        listed = ", ".join(map(repr, known[:20])) + ", ..." * (len(known) > 20)
        raise LibraryError(
            f"object must be one in the library ({listed or 'it has none'}), got "
            f"{name!r}.{did_you_mean(name, known)}"
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
        if store.key_of("touches", "id", id_bytes(key)) is None:
            raise LibraryError(
                f"ids must be of touches in the library, got {key!r}. "
                "See `palpate library list`."
            )
    return given


def _rename(store: Store, change: int, content: dict[str, Any]) -> int:
    old, new = content["old"], content["new"]
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
    numbers = [store.key_of("touches", "id", bytes.fromhex(key)) for key in ids]
    return store.run_many(
        "UPDATE touches SET retraction = ? "
        "WHERE number = ? AND (retraction IS NULL) = ?",
        [(change, number, change is not None) for number in numbers],
    )


_ACTIONS: dict[str, Callable[[Store, int, dict[str, Any]], int]] = {
    "rename": _rename,
    "merge": _merge,
    "retract": lambda store, change, content: _leave_out(store, change, content["ids"]),
    "restore": lambda store, change, content: _leave_out(store, None, content["ids"]),
    # Arrays of whole recordings are lost: only noted, reading still tries them.
    "leave_out": lambda store, change, content: len(content["arrays"]),
}


def checked_name(name: object) -> str:
    if not isinstance(name, str) or not name.strip():
        raise LibraryError(f"The new name must be a text, got {name!r}. Give one.")
    if (spelling := one_spelling(name)) is None:
        raise LibraryError(
            "The new name must be of letters that can be printed, got "
            f"{name!r}. Leave out line breaks and control characters."
        )
    return spelling


def _brief(content: dict[str, Any]) -> dict[str, Any]:
    """Return what the database keeps of a change: not its list of ids."""
    return {n: v for n, v in content.items() if n != "ids"}


def _digest(content: dict[str, Any]) -> str:
    plain = {n: v for n, v in content.items() if n != "digest"}
    return hashlib.sha256(canonical(plain).encode()).hexdigest()


def _path(store: Store, name: str) -> Path:
    return store.folder / CHANGES / f"{name}.json"


def _write_change(store: Store, name: str, content: dict[str, Any]) -> None:
    path = _path(store, name)
    fix = "Nothing was changed; free space and try again."
    with room_for("the change", path.parent, fix):
        path.parent.mkdir(exist_ok=True)
        write_text(path, canonical(content))
