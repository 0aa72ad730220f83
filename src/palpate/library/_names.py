"""Former and present names of objects, from the recorded changes of names."""

from bisect import bisect_left
from typing import NamedTuple

from ._content import digest_of
from ._store import Store, from_json


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
