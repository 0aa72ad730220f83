"""Why a belief is what it is: the touches that moved it, and what they resemble."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ._sequence import Floats, n_informative

if TYPE_CHECKING:
    from ._recogniser import ObjectRecogniser

# Distances are told in units of a middling pair among so many training touches.
N_PAIRED = 300


def explanation(
    recogniser: ObjectRecogniser,
    floored: Floats,
    features: Floats,
    log_posterior: Floats,
    flags: list[str],
    how_many: tuple[int, int],
) -> list[dict[str, Any]]:
    """Return the touches that moved the belief most; see `Belief.explain`."""
    if not len(floored):
        return []
    order = np.argsort(-log_posterior, kind="stable")
    best, rival = int(order[0]), int(order[min(1, len(order) - 1)])
    weight = float(recogniser.sequence_calibration_.weight(n_informative(floored)[-1]))
    nats = weight * (floored[:, best] - floored[:, rival])
    names = recogniser.classes_
    n_touches, n_nearest = how_many
    moved = np.argsort(-np.abs(nats), kind="stable")[:n_touches]
    unit = _unit(recogniser.features_)
    return [
        {
            "touch": int(k) + 1,
            "best": str(names[best]),
            "rival": str(names[rival]),
            "nats": float(nats[k]),
            "flag": flags[k],
            "nearest": _nearest(recogniser, features[k], unit, n_nearest),
        }
        for k in moved
    ]


def _nearest(
    recogniser: ObjectRecogniser, features: Floats, unit: float, n_nearest: int
) -> list[dict[str, Any]]:
    """Return the nearest training touches; none where the features are not known."""
    if not np.isfinite(features).all():
        return []
    squared = ((recogniser.features_ - features) ** 2).sum(axis=1)
    rows = np.argsort(squared, kind="stable")[:n_nearest]
    return [
        {
            "object": str(recogniser.objects_[row]),
            "row": int(row),
            "distance": float(np.sqrt(squared[row])) / unit,
        }
        for row in rows
    ]


def _unit(features: NDArray) -> float:
    """Return the median distance between training touches."""
    some = features[:: -(-len(features) // N_PAIRED)]
    squared = ((some[:, np.newaxis] - some) ** 2).sum(axis=2)
    apart = squared[np.triu_indices(len(some), 1)]
    return float(np.sqrt(np.median(apart))) if len(apart) and apart.any() else 1.0
