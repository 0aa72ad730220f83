"""Putting sets of touches after one another; each refusal names the fix."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._columns import Arrays
from ._errors import TouchesError


def joined_images(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Stack images of one size and type."""
    for number, part in enumerate(parts):
        if part.shape[1:] != parts[0].shape[1:]:
            raise TouchesError(
                f"images must all be {_size(parts[0])} taxels like set 0, "
                f"got {_size(part)} in set {number}. Resize or crop them first."
            )
        if part.dtype != parts[0].dtype:
            raise TouchesError(
                f"images must all be {parts[0].dtype} like set 0, got {part.dtype} in "
                f"set {number}. Convert one of them with images.astype."
            )
    return np.concatenate(parts)


def joined_columns(parts: Sequence[Arrays]) -> Arrays:
    """Join columns by name, in the order in which names first appear."""
    names = list(dict.fromkeys(name for part in parts for name in part))
    return {name: _joined_column(name, parts) for name in names}


def joined_whole(parts: Sequence[Arrays]) -> Arrays:
    """Keep the entries of the whole set, which must be the same in every set."""
    for name in dict.fromkeys(name for part in parts for name in part):
        for number, part in enumerate(parts):
            if name not in part or name not in parts[0]:
                lacking = number if name not in part else 0
                raise TouchesError(
                    f"{name} must be the same in every set, got none in set {lacking}. "
                    f"Add it there, or drop it with touches.without({name!r})."
                )
            if not _same(part[name], parts[0][name]):
                raise TouchesError(
                    f"{name} must be the same in every set, got another one in set "
                    f"{number}. Drop it with touches.without({name!r}), or keep the "
                    "sets apart."
                )
    return dict(parts[0])


def _joined_column(name: str, parts: Sequence[Arrays]) -> NDArray[Any]:
    for number, part in enumerate(parts):
        if name not in part:
            raise TouchesError(
                f"column {name!r} must be in every set, got none in set {number}. "
                f"Add it with touches.with_columns({name}=...), or drop it "
                f"elsewhere with touches.without({name!r})."
            )
    columns = [part[name] for part in parts]
    for number, column in enumerate(columns):
        if (
            _kind(column) != _kind(columns[0])
            or column.shape[1:] != (columns[0].shape[1:])
        ):
            raise TouchesError(
                f"column {name!r} must be alike in every set, got {_told(column)} in "
                f"set {number} after {_told(columns[0])} in set 0. Convert one of "
                f"them, or drop it with touches.without({name!r})."
            )
    return np.concatenate(columns)


def _kind(column: NDArray[Any]) -> str:
    """Return what may be joined: numbers with numbers, text with text."""
    kind = column.dtype.kind
    return "numbers" if kind in "iufc" else kind


def _same(one: NDArray[Any], other: NDArray[Any]) -> bool:
    numbers = one.dtype.kind in "fc" and other.dtype.kind in "fc"
    alike = _kind(one) == _kind(other)
    return alike and bool(np.array_equal(one, other, equal_nan=numbers))


def _told(column: NDArray[Any]) -> str:
    row = " x ".join(map(str, column.shape[1:]))
    return f"{row} {column.dtype} a row" if row else str(column.dtype)


def _size(images: NDArray[Any]) -> str:
    return " x ".join(map(str, images.shape[1:]))
