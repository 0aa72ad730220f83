"""The objects of a library, counted."""

from collections import defaultdict
from typing import Any

from ._database import Database
from ._records import ObjectRow


def object_rows(database: Database) -> list[ObjectRow]:
    """Return all objects with touches that are not retracted, sorted by name."""
    groups = database.rows(
        "SELECT o.name, o.id, t.session, t.episode, count(*) FROM touches t "
        "JOIN objects given ON given.id = t.object "
        "JOIN objects o ON o.id = coalesce(given.merged_into, given.id) "
        "WHERE t.retraction IS NULL GROUP BY t.object, t.session, t.episode"
    )
    episodes: dict[tuple[str, int], set[Any]] = defaultdict(set)
    counts: dict[tuple[str, int], int] = defaultdict(int)
    for name, key, session, episode, n_touches in groups:
        episodes[name, key].add((session, episode))
        counts[name, key] += n_touches
    return [
        ObjectRow(name, _category(database, key), counts[name, key], len(found))
        for (name, key), found in sorted(episodes.items())
    ]


def _category(database: Database, key: int) -> str | None:
    """Return the category of an object, else that of one merged into it."""
    row = database.one(
        "SELECT category FROM objects WHERE (id = ? OR merged_into = ?) "
        "AND category IS NOT NULL ORDER BY merged_into IS NOT NULL, id LIMIT 1",
        [key, key],
    )
    return None if row is None else str(row[0])
