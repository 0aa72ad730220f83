"""What kind of sensor made these touches."""

import numpy as np

from ..images import typical_rim
from ..touches import Touches

SMALL_SIDE = 8
ARRAY_SIDE = 48
LOOK_AT = 50


def find_geometry(touches: Touches) -> str:
    """Return "dome", "array", "plane" or "none" for a set of touches.

    What the touches say of themselves holds; else a side below 8 taxels means
    that places mean nothing ("none"), a rim that most of 50 touches spread over the
    set have in common a "dome", a side of at most 48 taxels an "array", and anything
    else a "plane".
    """
    n_rows, n_cols = touches.images.shape[1:]
    if touches.geometry == "none" or min(n_rows, n_cols) < SMALL_SIDE:
        return "none"
    if touches.geometry is not None:
        return touches.geometry
    spread = np.unique(np.linspace(0, len(touches) - 1, LOOK_AT).astype(int))
    some = np.nan_to_num(touches.images[spread])
    if min(n_rows, n_cols) > ARRAY_SIDE and typical_rim(some) is not None:
        return "dome"
    return "array" if max(n_rows, n_cols) <= ARRAY_SIDE else "plane"
