"""What may stand between the brackets of `touches[...]`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._errors import TouchesError


def picked_rows(index: Any, n_touches: int) -> slice | NDArray[Any]:
    """Return `index` as a slice or an array that keeps at least one touch."""
    if isinstance(index, int | np.integer) and not isinstance(index, bool):
        touch = int(index)
        if not -n_touches <= touch < n_touches:
            raise IndexError(f"touch {touch} is out of range: there are {n_touches}.")
        return slice(touch % n_touches, touch % n_touches + 1)
    rows: slice | NDArray[Any] = index
    if not isinstance(index, slice):
        rows = _row_numbers(index, n_touches)
    if len(np.arange(n_touches)[rows]) == 0:
        raise TouchesError(
            f"A selection must keep at least one of {n_touches} touches, got none."
        )
    return rows


def _row_numbers(index: Any, n_touches: int) -> NDArray[Any]:
    rows = np.asarray(None if isinstance(index, tuple) else index)
    if rows.size == 0 and rows.ndim == 1:
        rows = rows.astype(np.intp)
    if rows.ndim != 1 or rows.dtype.kind not in "biu":
        raise TypeError(
            "Touches are picked by number, slice, mask or array of numbers, "
            f"got {index!r}. Columns are in touches.columns[name]."
        )
    if rows.dtype.kind == "b" and len(rows) != n_touches:
        raise IndexError(
            f"a mask must have one value per touch ({n_touches}), got {len(rows)}."
        )
    return rows
