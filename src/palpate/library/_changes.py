"""Renaming, merging and retracting: every change is recorded, nothing is erased.

`Names` says what an object is called now and was called before.
"""

import time
import unicodedata
from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
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
    "retract" or "restore" (of the touches with these `ids`, for a `reason`); `content`
    says all that. `after` is the number of touches there were.
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

    Returns how many rows it concerned.
    """
    tally = store.tally()
    text = canonical(change.content)
    values = {
        "time_s": change.time_s,
        "after": change.after,
        "action": change.action,
        "content": text,
    }
    digest = digest_of(values.values())
    key = store.insert("changes", {**values, "digest": digest})
    n_changed = _ACTIONS[change.action](store, key, change.content)
    if not n_changed:
        store.run("DELETE FROM changes WHERE id = ?", [key])
        return 0
    chain = chained(tally.changes, [digest])
    store.enter(tally._replace(n_changes=tally.n_changes + 1, changes=chain))
    return n_changed


def history(store: Store) -> list[Change]:
    """Return all changes in the order made, each compared with its digest."""
    rows = store.rows(
        "SELECT time_s, after, action, content, digest, id FROM changes ORDER BY id"
    )
    changes = []
    for time_s, after, action, text, digest, key in rows:
        if not is_sound([time_s, after, action, text], digest):
            raise LibraryError(
                f"{store.path} must be as it was written, got another change {key}. "
                "See `check_library`."
            )
        changes.append(Change(time_s, action, from_json(text), after))
    return changes


def is_sound(values: Sequence[Any], digest: object) -> bool:
    """Tell whether the values of a change are those that its digest is of."""
    try:
        return digest_of(values) == digest
    except TypeError:
        return False


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
    return chosen


def _rename(store: Store, change: int, content: dict[str, Any]) -> int:
    old, new = content["old"], content["new"]
    key, _ = object_row(store, old)
    if store.first_row("SELECT id FROM objects WHERE name = ?", [new]):
        raise LibraryError(
            f"The new name must not be taken, got {new!r}. To make two objects one, "
            f"merge {old!r} into it."
        )
    return store.run("UPDATE objects SET name = ? WHERE id = ?", [new, key])


def _merge(store: Store, change: int, content: dict[str, Any]) -> int:
    source, _ = object_row(store, content["source"])
    into, _ = object_row(store, content["into"])
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
}


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


class _Change(NamedTuple):
    """`old` became `new`; `after` is the number of the last touch before it."""

    after: int
    action: str
    old: str
    new: str


class Names:
    """Renames and merges in their order."""

    def __init__(self, store: Store) -> None:
        rows = store.rows(
            "SELECT time_s, after, action, content, digest FROM changes "
            "WHERE action IN ('rename', 'merge') ORDER BY id"
        )
        self.changes: list[_Change] = []
        for *values, digest in rows:
            _, after, action, text = values
            names = ("old", "new") if action == "rename" else ("source", "into")
            # Of a damaged one nothing is known: touches that it named are refused.
            if digest_of(values) == digest:
                content = from_json(text)
                old, new = (content[name] for name in names)
                self.changes.append(_Change(after, action, old, new))
        self._after = [change.after for change in self.changes]
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
            for after, action, old, new in self.changes:
                if old == name and (after >= since or action == "merge"):
                    name, since = new, 0
            self._labels[key] = name
        return self._labels[key]

    def former(self, name: str | None) -> list[str]:
        """Return what the object that now has this name has been called."""
        names: list[str] = []
        for _, _, old, new in reversed(self.changes):
            if new == name or new in names:
                names.append(old)
        return names
