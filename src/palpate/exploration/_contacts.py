"""Where touches met something: tips, ways of approach, faces, and what they aim at."""

import numpy as np

from .._types import Floats, Indices
from ..touches import Touches
from ._touch_map import places_of

# Lines of approach that pass within this (mm) of one point aim at it.
_AIM_MM = 10.0


def faces_of(touches: Touches) -> Indices:
    """Return the number of the face that the object stood on, 0 unless told."""
    faces = touches.columns.get("face")
    if faces is None:
        return np.zeros(len(touches), int)
    numbers = np.unique(np.asarray(faces), return_inverse=True)
    if np.asarray(faces).dtype.kind in "iu":
        return np.asarray(faces, int)
    return np.asarray(numbers[1])


def contacts_of(touches: Touches) -> tuple[Floats, Floats]:
    """Return tips at the contacts and ways of approach, (n_touches, 3) each."""
    ways = -places_of(touches, None, 4)
    column = touches.columns.get("position_mm")
    if column is None:
        raise ValueError(
            "touches must have a column 'position_mm' (the tip at the contact, in mm), "
            f"got {', '.join(touches.columns) or 'none'}. Add it, or use TouchMap."
        )
    tips = np.asarray(column, dtype=np.float64)
    if tips.shape != (len(touches), 3):
        raise ValueError(
            f"position_mm must have shape ({len(touches)}, 3), got {tips.shape}."
        )
    unplaced = np.flatnonzero(~np.isfinite(tips).all(axis=1))
    if len(unplaced):
        raise ValueError(
            f"position_mm must be finite, got {tips[unplaced[0]].tolist()} in touch "
            f"{unplaced[0]}, and no place in {len(unplaced)} of {len(touches)} "
            "touches. Leave those touches out."
        )
    return tips, ways


def middle_of(tips_mm: Floats, ways: Floats) -> Floats:
    """Return the point that the approaches aim at, else the middle of the contacts."""
    across = np.eye(3) - ways[:, :, None] * ways[:, None]
    total = across.sum(axis=0)
    if np.linalg.eigvalsh(total)[0] > 0.1 * len(tips_mm):
        point = np.linalg.solve(total, np.einsum("nij,nj->i", across, tips_mm))
        off = np.einsum("nij,nj->ni", across, tips_mm - point)
        if np.linalg.norm(off, axis=1).max() < _AIM_MM:
            return np.asarray(point)
    return np.asarray((tips_mm.min(axis=0) + tips_mm.max(axis=0)) / 2)
