"""Patterns that people give for file names: checked, and matched in bounded time.

A pattern such as `(a+)+b` takes twice as long for each further letter of a name, and
nothing in Python ends it: names are matched in another process, which is.
"""

import json
import re
import subprocess
import sys
from collections.abc import Sequence

from ._columns import WHOLE, TouchesError

POSITIONS = {"position_raw": ("x", "y", "z"), "position_mm": ("x_mm", "y_mm", "z_mm")}
TAKEN = (*WHOLE, *POSITIONS, "images", "source_path")
_EXAMPLE = r"(?P<object>[a-z]+)_(?P<n>\d+)"
_MOST_S = 10.0  # seconds; some patterns would never end
# The file name is searched first, then the path relative to the folder.
_MATCH = """
import json, re, sys
pattern, names = json.load(sys.stdin)
pattern = re.compile(pattern)
for name in names:
    found = pattern.search(name.rpartition("/")[2]) or pattern.search(name)
    print(json.dumps(found and found.groupdict()), flush=True)
"""
Groups = dict[str, str | None]


def compiled(name_pattern: object) -> re.Pattern[str]:
    """Return a pattern whose groups can be columns, or explain."""
    if not isinstance(name_pattern, str):
        kind = type(name_pattern).__name__
        raise TypeError(f"name_pattern must be a string, got {kind}.")
    try:
        pattern = re.compile(name_pattern)
    except (re.error, RecursionError, OverflowError) as error:
        raise TouchesError(
            f"name_pattern must be a regular expression, got {name_pattern!r}: "
            f"{error}. An example: {_EXAMPLE}"
        ) from error
    groups = set(pattern.groupindex)
    if not groups:
        raise TouchesError(
            f"name_pattern must have named groups, got {name_pattern!r}. "
            f"An example: {_EXAMPLE}"
        )
    taken = sorted(g for g in groups if g in TAKEN or g.startswith("set_"))
    if taken or {"n", "order"} <= groups:
        got = taken[0] if taken else "both n and order"
        raise TouchesError(
            f"name_pattern must leave some names alone, got the group {got}. "
            "Rename it: x, y, z give position_raw, x_mm, y_mm, z_mm position_mm, n "
            "the order; the path is kept as source_path."
        )
    return pattern


def matched(pattern: re.Pattern[str], names: Sequence[str]) -> list[Groups | None]:
    """Return the groups of each name, None where it does not match."""
    question = json.dumps([pattern.pattern, list(names)]).encode()
    try:
        done = subprocess.run(
            [sys.executable, "-I", "-S", "-c", _MATCH],
            input=question,
            capture_output=True,
            timeout=_MOST_S,
            check=True,
        )
    except subprocess.TimeoutExpired as error:
        n_done = (error.stdout or b"").count(b"\n")
        raise TouchesError(
            f"name_pattern must match all names within {_MOST_S:g} s, got "
            f"{pattern.pattern!r}, which did not end at {names[n_done]!r}. Repeats "
            r"within repeats, such as (\w+)+, take very long: write \w+."
        ) from None
    except subprocess.CalledProcessError as error:
        why = error.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        raise TouchesError(
            f"name_pattern must be a regular expression, got {pattern.pattern!r}: {why}"
        ) from None
    return [json.loads(line) for line in done.stdout.splitlines()]
