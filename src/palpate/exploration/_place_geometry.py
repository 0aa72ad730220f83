"""Places of touches on an object: where they are, turned, and how near each other.

On a hemisphere a place is the unit vector from the centre towards the sensor; among
recorded touches it may be anything that is known beforehand, such as a height and a
radius. Places of the object's own frame are called stations.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._types import Floats
from ..touches import Touches

# Directions may have been written with a few digits.
_LENGTH_TOLERANCE = 0.01


def places_of(touches: object, places: ArrayLike | None, n_turns: int) -> Floats:
    """Return the places of touches, (n_touches, n_dimensions), or explain."""
    if not isinstance(touches, Touches):
        raise TypeError(
            f"touches must be Touches, got {type(touches).__name__}. Write "
            "Touches(images, direction=...)."
        )
    if places is None:
        directions = touches.columns.get("direction")
        if directions is None:
            raise ValueError(
                "touches must have a column 'direction' (unit vectors of approach), "
                f"got {', '.join(touches.columns) or 'none'}. Add it, or give places."
            )
        places = -np.asarray(directions, dtype=np.float64)
        length = np.sqrt((places**2).sum(axis=-1))
        wrong = np.flatnonzero(np.abs(length - 1) > _LENGTH_TOLERANCE)
        if len(wrong):
            raise ValueError(
                "direction must be unit vectors of approach, got "
                f"{(-places[wrong[0]]).tolist()} in touch {wrong[0]}. Divide it by its "
                "length; leave out touches whose direction is not known."
            )
    array = np.asarray(places, dtype=np.float64)
    if array.ndim != 2 or len(array) != len(touches) or not np.isfinite(array).all():
        raise ValueError(
            f"places must be finite, one row for each of {len(touches)} touches, got "
            f"shape {array.shape}."
        )
    if n_turns > 1 and array.shape[1] != 3:
        raise ValueError(
            f"places must be x, y, z to be turned, got {array.shape[1]} numbers each. "
            "Use TouchMap(n_turns=1) for places that do not turn."
        )
    return array


def turned_back(places: Floats, n_turns: int) -> Floats:
    """Return stations of places on an object turned about z, (n_places, n_turns, p)."""
    if n_turns == 1:
        return places[:, None]
    angle = np.arange(n_turns) * (2 * np.pi / n_turns)
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = places.T[:, :, None]
    height = np.repeat(z, n_turns, axis=1)
    return np.stack([cos * x + sin * y, cos * y - sin * x, height], axis=-1)


def squared_distances(one: Floats, other: Floats) -> Floats:
    """Return squared distances, (n_one, n_other)."""
    squared = (one**2).sum(axis=1)[:, None] + (other**2).sum(axis=1) - 2 * one @ other.T
    return np.asarray(np.maximum(squared, 0.0))


def freshness(candidates: Floats, touched: Floats, width: float) -> Floats:
    """Return the product over places touched of 1 - exp(-d^2 / 2 width^2)."""
    if not len(touched):
        return np.ones(len(candidates))
    squared = squared_distances(candidates, touched)
    return np.asarray((1 - np.exp(squared / (-2 * width**2))).prod(axis=1))
