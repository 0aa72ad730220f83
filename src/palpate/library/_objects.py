"""What a library holds, counted."""

from collections import defaultdict
from pathlib import Path
from typing import Any

from ._database import FILE_NAME, Database
from ._files import ARRAYS, IMAGES
from ._records import ObjectRow, Stats


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


def stats_of(database: Database, folder: Path) -> Stats:
    """Return how much there is, in touches and in bytes."""
    row = database.one(
        "SELECT count(*), count(retraction), (SELECT count(*) FROM files), "
        "(SELECT count(*) FROM (SELECT DISTINCT session FROM touches)) FROM touches"
    )
    n_touches, n_retracted, n_files, n_sessions = row or (0, 0, 0, 0)
    return Stats(
        n_touches - n_retracted,
        n_retracted,
        len(object_rows(database)),
        n_sessions,
        n_files,
        sum(p.stat().st_size for p in folder.glob(f"{FILE_NAME}*")),
        _bytes_below(folder / IMAGES) + _bytes_below(folder / ARRAYS),
        _bytes_below(folder / "features"),
    )


def _bytes_below(folder: Path) -> int:
    return sum(p.stat().st_size for p in folder.rglob("*") if p.is_file())


def _category(database: Database, key: int) -> str | None:
    """Return the category of an object, else that of one merged into it."""
    row = database.one(
        "SELECT category FROM objects WHERE (id = ? OR merged_into = ?) "
        "AND category IS NOT NULL ORDER BY merged_into IS NOT NULL, id LIMIT 1",
        [key, key],
    )
    return None if row is None else str(row[0])
