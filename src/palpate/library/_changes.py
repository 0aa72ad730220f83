"""Renaming, merging and retracting: every change is recorded, nothing is erased.

`Names` says what an object is called now and was called before.
"""

import time
import unicodedata
from bisect import bisect_left
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from .._checks import did_you_mean, one_spelling
from ._content import canonical, digest_of, id_bytes
from ._store import LibraryError, Store, chained, from_json, is_unicode

# Persian and some emoji are written with them.
_JOINERS = dict.fromkeys(map(ord, "\u200c\u200d"))
_FIND_OBJECT = (
    "SELECT o.id, o.name FROM objects given "
    "JOIN objects o ON o.id = coalesce(given.merged_into, given.id) "
    "WHERE given.name = ?"
)


class Change(NamedTuple):
    """One recorded change: when it was made and what it did.

    `action` is "rename" (of `old` to `new`), "merge" (of `source` `into` another),
    "retract" (of the touches with these `ids`, for a `reason`) or "restore" (of these
    `ids`); `content` says all that. `after` is the number of touches there were.
    """

    time_s: float
    action: str
    content: dict[str, Any]
    after: int


def make_change(store: Store, action: str, **content: Any) -> int:
    """Record a change and carry it out; return how many rows it concerned."""

    def job() -> int:
        after = store.count("SELECT max(number) FROM touches")
        return enter_change(store, Change(time.time(), action, content, after))

    return store.write(job)


def enter_change(store: Store, change: Change) -> int:
    """Enter a change within a job and carry it out; one that does nothing is not kept.

    It names objects as they are called then: others may have changed that since it was
    asked for. Returns how many rows it concerned.
    """
    tally = store.tally()
    names = {"rename": ("old",), "merge": ("source", "into")}.get(change.action, ())
    now = {key: object_row(store, change.content[key])[1] for key in names}
    change = change._replace(content=change.content | now)
    text = canonical(change.content)
    values = {
        "time_s": change.time_s,
        "after": change.after,
        "action": change.action,
        "content": text,
    }
    digest = digest_of(values.values())
    key = store.insert("changes", {**values, "digest": digest})
    n_changed = _carry_out(store, key, change)
    if not n_changed:
        store.run("DELETE FROM changes WHERE id = ?", [key])
        return 0
    chain = chained(tally.changes, [digest])
    store.enter(tally._replace(n_changes=tally.n_changes + 1, changes=chain))
    return n_changed


def change_rows(
    store: Store, tail: str = "ORDER BY id", values: Sequence[Any] = ()
) -> list[tuple[int, bytes, Change | None]]:
    """Return key and digest of changes, and each that is as it was made, else None."""
    sql = f"SELECT id, digest, time_s, after, action, content FROM changes {tail}"
    changes = []
    for key, digest, *cells in store.rows(sql, values):
        change = None
        if digest_of(cells) == digest:
            time_s, after, action, text = cells
            change = Change(time_s, action, from_json(text), after)
        changes.append((key, digest, change))
    return changes


def history(store: Store) -> list[Change]:
    """Return all changes in the order made, each compared with its digest."""
    changes = []
    for key, _, change in change_rows(store):
        if change is None:
            raise LibraryError(
                f"{store.path} must be as it was written, got another change {key}. "
                "See `check_library`."
            )
        changes.append(change)
    return changes


def find_object(store: Store, name: str | None) -> tuple[int, str] | None:
    """Return key and present name of an object, of the one it was merged into."""
    row = store.first_row(_FIND_OBJECT, [name])
    return None if row is None else (int(row[0]), str(row[1]))


def object_row(store: Store, name: str) -> tuple[int, str]:
    is_name = isinstance(name, str) and is_unicode(name)
    row = find_object(store, name) if is_name else None
    if row is None and is_name and (spelling := one_spelling(name)):
        row = find_object(store, spelling)
    if row is None:
        names = [r[0] for r in store.rows("SELECT name FROM objects ORDER BY name")]
        listed = ", ".join(map(repr, names[:20])) + ", ..." * (len(names) > 20)
        raise LibraryError(
            f"object must be one in the library ({listed or 'it has none'}), got "
            f"{name!r}.{did_you_mean(name, names)}"
        )
    return row


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
            object_row(store, name)[:1],
        )
        return [row[0] for row in rows]
    chosen = [ids] if isinstance(ids, str) else list(ids or [])
    for key in chosen:
        if not store.first_row("SELECT 1 FROM touches WHERE id = ?", [id_bytes(key)]):
            raise LibraryError(
                f"ids must be of touches in the library, got {key!r}. "
                "See `TouchLibrary.list`."
            )
    return [id_bytes(key).hex() for key in chosen]


def _carry_out(store: Store, key: int, change: Change) -> int:
    content = change.content
    if change.action == "rename":
        return _rename(store, content["old"], content["new"])
    if change.action == "merge":
        return _merge(store, content["source"], content["into"])
    retraction = {"retract": key, "restore": None}[change.action]
    return store.run_many(
        "UPDATE touches SET retraction = ? WHERE id = ? AND (retraction IS NULL) = ?",
        [
            (retraction, bytes.fromhex(touch), retraction is not None)
            for touch in content["ids"]
        ],
    )


def _rename(store: Store, old: str, new: str) -> int:
    key, _ = object_row(store, old)
    if store.first_row("SELECT id FROM objects WHERE name = ?", [new]):
        raise LibraryError(
            f"The new name must not be taken, got {new!r}. To make two objects one, "
            f"merge {old!r} into it."
        )
    return store.run("UPDATE objects SET name = ? WHERE id = ?", [new, key])


def _merge(store: Store, source: str, into: str) -> int:
    key, _ = object_row(store, source)
    into_key, _ = object_row(store, into)
    if key == into_key:
        raise LibraryError(
            f"Objects to merge must be two, got {source!r} and {into!r}, which are one."
        )
    return store.run(
        "UPDATE objects SET merged_into = ? WHERE id = ? OR merged_into = ?",
        [into_key, key, key],
    )


def checked_name(name: object) -> str:
    """Return the name of an object in its one spelling, or say what it should be."""
    if not isinstance(name, str) or not name.strip():
        raise LibraryError(
            f"The name of an object must be a text, got {name!r}. Give one."
        )
    spelling = one_spelling(name)
    letters = (spelling or "").translate(_JOINERS)
    if spelling is None or not letters.isprintable():
        raise LibraryError(
            "The name of an object must be of letters that can be printed, got "
            f"{name!r}. Leave out line breaks and control characters."
        )
    if all(unicodedata.category(letter)[0] in "PZ" for letter in letters):
        raise LibraryError(
            "The name of an object must hold a letter, a digit or a sign, got "
            f"{name!r}. Call it what it is, such as 'mug'."
        )
    return spelling


class Names:
    """Renames and merges in their order."""

    def __init__(self, store: Store) -> None:
        # What became what, after which touch; of a damaged change nothing is known:
        # touches that it named are refused.
        self._changes: list[tuple[int, str, str, str]] = []
        tail = "WHERE action IN ('rename', 'merge') ORDER BY id"
        for _, _, change in change_rows(store, tail):
            if change is not None:
                keys = {"rename": ("old", "new"), "merge": ("source", "into")}
                old, new = (change.content[key] for key in keys[change.action])
                self._changes.append((change.after, change.action, old, new))
        self._after = [after for after, *_ in self._changes]
        self._labels: dict[tuple[str | None, int], str | None] = {}

    def now(self, label: str | None, number: int) -> str | None:
        """Return what the object of the touch `number`, added as `label`, is called.

        A name that was merged stays with the object it was merged into, also for
        touches that came later.
        """
        # Between two changes all touches with one label fare alike.
        place = bisect_left(self._after, number)
        key = label, place
        if key not in self._labels:
            name, since = label, number
            for after, action, old, new in self._changes:
                if old == name and (after >= since or action == "merge"):
                    name, since = new, 0
            self._labels[key] = name
        return self._labels[key]

    def former(self, name: str | None) -> list[str]:
        """Return what the object that now has this name has been called."""
        names: list[str] = []
        for _, _, old, new in reversed(self._changes):
            if new == name or new in names:
                names.append(old)
        return names
