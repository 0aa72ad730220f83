"""A seal on every row: a digest of all its values, kept beside them.

Triggers of each connection seal a row when it is written, and refuse to change one
whose seal is broken, so that no damage is sealed as truth. No row is ever removed
but the last: keys count from 1 without gaps, so that a row that vanished is noticed
too. A library made before rows had seals gets them when it is first written to.
"""

import hashlib
import marshal
from collections.abc import Iterator
from typing import Any

SEALED = {
    "objects": ("id", "name", "category", "merged_into"),
    "recordings": (
        *("id", "digest", "sensor", "kind", "unit", "pitch_mm", "geometry"),
        *("n_rows", "n_cols", "dtype", "whole"),
    ),
    "layouts": ("id", "columns"),
    "files": ("id", "name", "n_touches", "offset"),
    "changes": ("id", "name", "time_s", "action", "content"),
    "touches": (
        *("number", "id", "object", "category", "session", "episode", "sensor"),
        *('"order"', "time_s", "force_n", "press", "frame", "source_path", "extra"),
        *("layout", "recording", "file", "place", "image", "added_s", "retraction"),
    ),
}


def seal(*values: Any) -> bytes:
    """Return the digest of a row: of its values and their types.

    Version 2 of marshal's format depends on values alone; it takes a tenth of the time
    of `repr`.
    """
    return hashlib.blake2b(marshal.dumps(values, 2), digest_size=8).digest()


def seal_all() -> Iterator[str]:
    """Yield what gives seals to a library that was made without."""
    yield "DROP INDEX IF EXISTS touches_of_object"
    for table, columns in SEALED.items():
        yield f"ALTER TABLE {table} ADD COLUMN seal BLOB"
        yield f"UPDATE {table} SET seal = seal_of({', '.join(columns)})"


def triggers() -> Iterator[str]:
    """Yield what makes a connection seal the rows that it writes."""
    for table, columns in SEALED.items():
        key, listed = columns[0], ", ".join(columns)
        old = ", ".join(f"old.{name}" for name in columns)
        start = "CREATE TEMP TRIGGER IF NOT EXISTS"
        again = (
            f"UPDATE {table} SET seal = seal_of({listed}) WHERE {key} = new.{key}; END"
        )
        yield f"{start} enter_{table} AFTER INSERT ON main.{table} BEGIN {again}"
        yield (
            f"{start} change_{table} AFTER UPDATE OF {listed} ON main.{table} "
            f"BEGIN {again}"
        )
        yield (
            f"{start} keep_{table} BEFORE UPDATE OF {listed} ON main.{table} "
            f"WHEN old.seal IS NOT seal_of({old}) "
            f"BEGIN SELECT RAISE(ABORT, 'a damaged row of {table}'); END"
        )
