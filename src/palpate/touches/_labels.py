"""Labels of pictures: from their names by a pattern, or from their folders."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._columns import WHOLE, Arrays
from ._errors import TouchesError

_TEXT_GROUPS = ("object", "category", "session")
_POSITIONS = {"position_raw": ("x", "y", "z"), "position_mm": ("x_mm", "y_mm", "z_mm")}
_NEEDED = ("object", "category", "session", "order", "n", *sum(_POSITIONS.values(), ()))
_TAKEN = (*WHOLE, *_POSITIONS, "images", "source_path")
_WHOLE_NUMBER = re.compile(r"[+-]?\d{1,18}")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_EXAMPLE = r"(?P<object>[a-z]+)_(?P<n>\d+)"


def compiled(name_pattern: object) -> re.Pattern[str]:
    """Return the pattern ready for use, or say what is wrong with it."""
    if not isinstance(name_pattern, str):
        kind = type(name_pattern).__name__
        raise TypeError(f"name_pattern must be a string, got {kind}.")
    try:
        pattern = re.compile(name_pattern)
    except re.error as error:
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
    taken = sorted(g for g in groups if g in _TAKEN or g.startswith("set_"))
    if taken or {"n", "order"} <= groups:
        got = taken[0] if taken else "both n and order"
        raise TouchesError(
            f"name_pattern must leave some names alone, got the group {got}. "
            "Rename it: x, y, z give position_raw, x_mm, y_mm, z_mm position_mm, n "
            "the order; the path is kept as source_path."
        )
    return pattern


def labels_from_names(names: Sequence[str], pattern: re.Pattern[str]) -> Arrays:
    """Match every name; turn the named groups into columns.

    The file name is searched first, then the path relative to the folder.
    """
    matches = [_matched(name, pattern) for name in names]
    texts = {group: [m[group] for m in matches] for group in pattern.groupindex}
    for group in texts:
        if group in _NEEDED and not all(texts[group]):
            odd = next(i for i, text in enumerate(texts[group]) if not text)
            raise TouchesError(
                f"{names[odd]}: the group {group} of name_pattern must match something,"
                f" got nothing with {pattern.pattern!r}. Correct either."
            )
    columns: Arrays = {}
    for column, axes in _POSITIONS.items():
        if all(axis in texts for axis in axes):
            parts = [_floats(axis, texts.pop(axis), names) for axis in axes]
            columns[column] = np.stack(parts, axis=1)
    columns.update(_columns(texts, names))
    return columns


def labels_from_folders(names: Sequence[str]) -> Arrays:
    """Take labels from the levels of folders above each picture.

    One level: its folder is the object. More: the first level is the category, the
    whole relative folder the object. None at all: no labels.
    """
    depths = [min(name.count("/"), 2) for name in names]
    if len(set(depths)) > 1:
        _explain_mixed_depths(names, depths)
    if depths[0] == 0:
        return {}
    labels = {"object": np.array([name.rpartition("/")[0] for name in names])}
    if depths[0] > 1:
        labels["category"] = np.array([name.partition("/")[0] for name in names])
    return labels


def _explain_mixed_depths(names: Sequence[str], depths: Sequence[int]) -> None:
    usual = max(set(depths), key=depths.count)
    odd = next(i for i, depth in enumerate(depths) if depth != usual)
    told = ("lies in no folder", "lies in one folder", "lies in folders of folders")
    raise TouchesError(
        f"Pictures must all be labelled by folders in one way, but {names[odd]} "
        f"{told[depths[odd]]} and {names[depths.index(usual)]} {told[usual]}. "
        "Move it to the folder of its object, give a name_pattern, or name it as "
        "no_contact if that is what it shows."
    )


def _matched(name: str, pattern: re.Pattern[str]) -> re.Match[str]:
    found = pattern.search(name.rpartition("/")[2]) or pattern.search(name)
    if found is None:
        raise TouchesError(
            f"{name} must match name_pattern {pattern.pattern!r}, and does not. "
            "Correct the pattern, move the file out of the folder, or name it as "
            "no_contact if that is what it shows."
        )
    return found


def _columns(texts: dict[str, list[Any]], names: Sequence[str]) -> Arrays:
    columns: Arrays = {}
    for group, values in texts.items():
        if group in _TEXT_GROUPS:
            columns[group] = np.array(values)
        elif group in ("n", "order"):
            columns["order"] = _integers(group, values, names)
        else:
            columns[group] = _numbers_or_text(values)
    return columns


def _integers(
    group: str, values: Sequence[str], names: Sequence[str]
) -> NDArray[np.int64]:
    for value, name in zip(values, names, strict=True):
        if not _WHOLE_NUMBER.fullmatch(value):
            raise _not_a_number(group, "a whole number", value, name)
    return np.array([int(value) for value in values], dtype=np.int64)


def _floats(
    group: str, values: Sequence[str], names: Sequence[str]
) -> NDArray[np.float64]:
    for value, name in zip(values, names, strict=True):
        if not _NUMBER.fullmatch(value):
            raise _not_a_number(group, "a number", value, name)
    return np.array([float(value) for value in values])


def _not_a_number(group: str, what: str, value: str, name: str) -> TouchesError:
    return TouchesError(
        f"{name}: the group {group} of name_pattern must match {what}, got {value!r}. "
        "Correct the pattern or the file name."
    )


def _numbers_or_text(values: Sequence[str | None]) -> NDArray[Any]:
    """Return numbers where every value is one; what did not match is NaN or ""."""
    present = [value for value in values if value is not None]
    if len(present) == len(values) and all(map(_WHOLE_NUMBER.fullmatch, present)):
        return np.array([int(value) for value in present], dtype=np.int64)
    if present and all(map(_NUMBER.fullmatch, present)):
        return np.array([np.nan if v is None else float(v) for v in values])
    return np.array(["" if value is None else value for value in values])
