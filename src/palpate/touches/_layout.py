"""What names of files and folders mean: a pattern, named levels, or found out.

Unnamed levels are read as `object`, or as `category/object`. Four layouts that people
have would make wrong objects of that, in silence: the parts of a set (`train/mug`),
days alone (`2024-05-01/mug_1.png`), a recording below each object
(`mug/dataset_0/frames`), and two cameras side by side (`mug/gel`, `mug/video`). The
third is recognised; of the others the error asks which.

A pattern such as `(a+)+b` takes twice as long for each further letter of a name, and
nothing in Python ends it: names are matched in another process, which is.
"""

import json
import re
import subprocess
import sys
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._checks import listed
from .._types import Array
from ._columns import WHOLE, Arrays, TouchesError
from ._tables import label_columns

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
# Whatever lies below a folder is of the object that the folder names.
_OF_FIRST = "`name_pattern='(?P<object>[^/]+)/.*'`"
_TEXT_GROUPS = ("object", "category", "session")
_NEEDED = ("object", "category", "session", "order", "n", *sum(POSITIONS.values(), ()))
_WHOLE_NUMBER = re.compile(r"[+-]?\d{1,18}")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_WHERE = ("in no folder", "in one folder", "in folders of folders")
SKIPPED = "-"
LABELS = "labels.csv"
KEPT = "="
_PARTS = re.compile(
    r"train(ing)?|test(ing)?|val(id|idation)?|dev|eval|hold-?out", re.IGNORECASE
)
_NUMBERED = "session|dataset|day|run|trial|recording|rec|sequence|seq|take|video|set"
_DAYS = "mon|tues|wednes|thurs|fri|satur|sun"
_SESSION = re.compile(
    rf"({_NUMBERED})[ _-]?\d+|({_DAYS})day|\d{{4}}-?\d\d-?\d\d([ T_-].*)?",
    re.IGNORECASE,
)
# What no object is called: a session, day or date, perhaps with its time.
_DAY = re.compile(
    rf"(session|day)[ _-]?\d+|({_DAYS})day"
    r"|(19|20)\d\d-?(0[1-9]|1[0-2])-?(0[1-9]|[12]\d|3[01])([ T_-]?\d.*)?",
    re.IGNORECASE,
)
_SENSOR = re.compile(
    "gel|digit|tact|video|cam|rgb|depth|frame|image|left|right", re.IGNORECASE
)


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
            f"name_pattern must have no group of a name that is in use, got {got}. "
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


def levels_pattern(levels: str) -> str:
    """Return the name pattern of folders whose levels have these names.

    `-` is a level that says nothing, `=gel` one of which the folder `gel` alone is
    read. Objects of two categories are different ones, whatever they are called.
    """
    names = levels.split("/")
    words = [name for name in names if name != SKIPPED and name[:1] != KEPT]
    are_words = all(word.isidentifier() for word in words) and KEPT not in names
    if not are_words or "object" not in words or len(set(words)) < len(words):
        raise TouchesError(
            "levels must name each level of folders by a word, once, one of them "
            f"object, got {levels!r}. Write category/object, object/session, or "
            "object/-/=gel: - skips a level, =gel reads its folder gel alone."
        )
    groups = {name: f"?P<{name}>" for name in words}  # others were chosen by name
    parts = [f"({groups.get(name, '?:')}[^/]+)" for name in names]
    last = names.index("object")
    if "category" in names[:last]:
        first = names.index("category")
        parts[first], parts[last] = f"(?P<object>{parts[first]}", "[^/]+)"
    return f"^{'/'.join(parts)}/[^/]+$"


def kept_names(names: Sequence[str], levels: str) -> list[str]:
    """Return the paths that lie in the folders that `levels` keeps (`=gel`)."""
    wanted = {
        n: part[1:] for n, part in enumerate(levels.split("/")) if part[:1] == KEPT
    }
    folders = [name.split("/")[:-1] for name in names]
    kept = [
        name
        for name, parts in zip(names, folders, strict=True)
        if all(n >= len(parts) or parts[n] == part for n, part in wanted.items())
    ]
    if not kept:
        level, part = next(iter(wanted.items()))
        there = sorted({parts[level] for parts in folders if level < len(parts)})
        raise TouchesError(
            f"levels must keep a folder that is there, got {KEPT}{part} where there "
            f"are {', '.join(there[:5])}. Name one of these."
        )
    return kept


class BadPicture(NamedTuple):
    """A picture that cannot be used: its path in the folder, why, and the fix.

    `folder` is one whose pictures all lie wrongly in one way, else empty.
    """

    picture: str
    problem: str
    fix: str
    folder: str = ""


def odd_names(
    names: Sequence[str], pattern: re.Pattern[str] | None
) -> dict[str, BadPicture]:
    """Return the paths that are not labelled as most are, by a pattern or folders."""
    fix = (
        "move it to the folder of its object, correct the `name_pattern` or give one, "
        "or give it as `no_contact` if that is what it shows"
    )
    if pattern is None:
        depths = [*map(_depth, names)]
        usual = max(set(depths), key=depths.count)
        pairs = zip(names, depths, strict=True)
        odd = {
            n: f"{_WHERE[depth]}, unlike the others"
            for n, depth in pairs
            if depth != usual
        }
    else:
        matches = zip(names, matched(pattern, names), strict=True)
        odd = {n: "not named like the others" for n, match in matches if match is None}
        if len(odd) == len(names):
            odd = dict.fromkeys(odd, "not named as levels or name_pattern say")
            fix = "give `levels` or a `name_pattern` as these paths are"
    bad = {name: BadPicture(name, problem, fix) for name, problem in odd.items()}
    if pattern is None or "/" in pattern.pattern:
        bad |= _odd_folders(names, odd)
    return bad


def _depth(name: str) -> int:
    return min(name.count("/"), 2)


def _odd_folders(names: Sequence[str], odd: Collection[str]) -> dict[str, BadPicture]:
    """Return the odd paths that lie one level off in a folder, and that folder.

    None of those that lie elsewhere, or where others lie mixed.
    """
    usual = {_depth(name) for name in names if name not in odd}
    below: dict[tuple[str, int], list[str]] = {}
    for name in odd:
        below.setdefault((name.partition("/")[0], _depth(name)), []).append(name)
    bad: dict[str, BadPicture] = {}
    for (folder, depth), inside in below.items():
        if (depth, usual) == (2, {1}):
            among = list(dict.fromkeys(name.split("/")[1] for name in inside))
            few = ", ".join(among[:3]) + ", ..." * (len(among) > 3)
            problem = f"in folders inside {folder}/ ({few}), unlike the others"
            fix = f"move them up into {folder}/, or say {_OF_FIRST}"
        elif (depth, usual) == (1, {2}):
            problem = "in one folder, where the others lie in two"
            fix = (
                "put them into one more folder, as the others are, or, if the first "
                f"folder names the object, say {_OF_FIRST}"
            )
        else:
            continue
        bad |= {name: BadPicture(name, problem, fix, folder) for name in inside}
    return bad


def _refuse_odd(names: Sequence[str], pattern: re.Pattern[str] | None) -> None:
    for name, bad in odd_names(names, pattern).items():
        by = "folders" if pattern is None else f"name_pattern {pattern.pattern!r}"
        raise TouchesError(
            f"Pictures must all be labelled by {by} in one way, got {name}, "
            f"{bad.problem}. {bad.fix[0].upper()}{bad.fix[1:]}."
        )


def labels_of_folders(names: Sequence[str]) -> Arrays:
    """Return labels from the levels of folders above pictures; see `Touches.load`."""
    _refuse_odd(names, None)
    folders = [name.split("/")[:-1] for name in names]
    if not folders[0]:
        return {}
    _refuse_parts(folders)
    columns: Arrays = {}
    if len({*map(len, folders)}) == 1:
        above = {tuple(parts[:-1]) for parts in folders}
        alike = len({parts[-1] for parts in folders}) == 1
        if len(folders[0]) > 1 and len(above) > 1 and alike:  # that level says nothing
            folders = [parts[:-1] for parts in folders]
        folders, sessions = _without_sessions(folders)
        if sessions:
            columns["session"] = np.array(sessions)
        _refuse_sessions(folders)
        _refuse_sensors(folders)
    columns["object"] = np.array(["/".join(parts) for parts in folders])
    if len(folders[0]) > 1:
        columns["category"] = np.array([parts[0] for parts in folders])
    return columns


def _refuse_parts(folders: list[list[str]]) -> None:
    parts = sorted({levels[0] for levels in folders})
    if not all(map(_PARTS.fullmatch, parts)):
        return
    what = "which is a part" if len(parts) == 1 else "which are parts"
    together = f", or together with `levels={SKIPPED}/object`" * (len(folders[0]) > 1)
    raise TouchesError(
        f"Folders must name objects, got {' and '.join(parts)}, {what} of a set. "
        f"Give each by itself, as .../{parts[0]}{together}."
    )


def _without_sessions(folders: list[list[str]]) -> tuple[list[list[str]], list[str]]:
    """Take out the last or the first level, where all its folders name sessions."""
    if len(folders[0]) > 1:
        for level in (-1, 0):
            names = [parts[level] for parts in folders]
            if all(map(_SESSION.fullmatch, names)):
                rest = [p[:-1] if level else p[1:] for p in folders]
                return rest, names
    return folders, []


def _refuse_sessions(folders: list[list[str]]) -> None:
    """Ask for the objects, where the only folders are named as sessions are."""
    names = sorted({"/".join(parts) for parts in folders})
    if all(map(_DAY.fullmatch, names)):
        raise TouchesError(
            f"Folders must name objects, got {listed(names, 2)}, named as sessions "
            "are. If names of files tell the object, say how: "
            "`name_pattern='(?P<session>[^/]+)/(?P<object>[a-z]+)'`; if these are "
            "objects, say so: `levels=object`."
        )


def _refuse_sensors(folders: list[list[str]]) -> None:
    """Ask which, where every object holds the same folders, named as cameras are."""
    below: dict[tuple[str, ...], set[str]] = {}
    for parts in folders:
        below.setdefault(tuple(parts[:-1]), set()).add(parts[-1])
    kinds = next(iter(below.values()))
    crossed = len(below) > 1 and all(names == kinds for names in below.values())
    if not crossed or len(kinds) < 2 or not any(map(_SENSOR.search, kinds)):
        return
    named = sorted(kinds)
    levels = "/".join(["object", *[SKIPPED] * (len(folders[0]) - 2), KEPT + named[0]])
    raise TouchesError(
        f"Folders must name objects, got {' and '.join(named)} in each of "
        f"{len(below)} folders. If these are cameras, read one: `levels={levels}`; if "
        "they are objects, say so: `levels=category/object`."
    )


def labels_of(
    root: Path, names: Sequence[str], pattern: re.Pattern[str] | None, max_bytes: int
) -> Arrays:
    """Return the columns that names, else a table, else folders give."""
    columns = {} if pattern is None else _from_names(names, pattern)
    if "object" not in columns:
        columns = {**_from_table(root, names, max_bytes), **columns}
    if "object" not in columns:
        columns = {**labels_of_folders(names), **columns}
    return columns


def _from_names(names: Sequence[str], pattern: re.Pattern[str]) -> Arrays:
    """Match every name; turn the named groups into columns."""
    texts: dict[str, list[Any]] = {group: [] for group in pattern.groupindex}
    for name, match in zip(names, _all_matched(names, pattern), strict=True):
        for group, values in texts.items():
            if group in _NEEDED and not match[group]:
                raise TouchesError(
                    f"{name}: the group {group} of name_pattern must match something, "
                    f"got nothing with {pattern.pattern!r}. Correct either."
                )
            values.append(match[group])
    columns: Arrays = {}
    for column, axes in POSITIONS.items():
        if all(axis in texts for axis in axes):
            parts = [_numbers(axis, texts.pop(axis), names) for axis in axes]
            columns[column] = np.stack(parts, axis=1)
    for group, values in texts.items():
        if group in _TEXT_GROUPS:
            columns[group] = np.array(values)
        elif group in ("n", "order"):
            columns["order"] = _numbers(group, values, names, whole=True)
        else:
            columns[group] = _numbers_or_text(values)
    return columns


def _all_matched(names: Sequence[str], pattern: re.Pattern[str]) -> list[Groups]:
    """Return the groups of each name; one that does not match is refused."""
    matches = [match for match in matched(pattern, names) if match is not None]
    if len(matches) < len(names):
        _refuse_odd(names, pattern)
    return matches


def _from_table(root: Path, names: Sequence[str], max_bytes: int) -> Arrays:
    """Return the columns of a `labels.csv` in the folder, none where it has none."""
    if not (root / LABELS).is_file():
        return {}
    columns = label_columns(root / LABELS, names, max_bytes)
    if taken := sorted({*columns} & {*TAKEN}):
        raise TouchesError(f"{LABELS} must not have a column {taken[0]}. Rename it.")
    for column, axes in POSITIONS.items():
        if all(axis in columns for axis in axes):
            columns[column] = np.stack([columns.pop(a) for a in axes], axis=1)
    return columns


def _numbers(
    group: str, values: Sequence[str], names: Sequence[str], *, whole: bool = False
) -> Array:
    kinds = (_NUMBER, "a number"), (_WHOLE_NUMBER, "a whole number")
    pattern, what = kinds[whole]
    for value, name in zip(values, names, strict=True):
        if not pattern.fullmatch(value):
            raise TouchesError(
                f"{name}: the group {group} of name_pattern must match {what}, got "
                f"{value!r}. Correct the pattern or the file name."
            )
    return np.array(values).astype(np.int64 if whole else np.float64)


def _numbers_or_text(values: Sequence[str | None]) -> Array:
    """Return numbers where every value is one; what did not match is NaN or ""."""
    present = [value for value in values if value is not None]
    if len(present) == len(values) and all(map(_WHOLE_NUMBER.fullmatch, present)):
        return np.array(present).astype(np.int64)
    if present and all(map(_NUMBER.fullmatch, present)):
        return np.array([np.nan if v is None else float(v) for v in values])
    return np.array(["" if value is None else value for value in values])
