"""Why a belief is what it is: the touches that moved it, and what they resemble."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._types import Array, Floats
from ._memory import Memory

# Distances are told in units of a middling pair among so many training touches.
N_PAIRED = 300


def explanation(
    memory: Memory,
    names: NDArray[np.str_],
    floored: Floats,
    weight: float,
    features: Floats,
    log_posterior: Floats,
    how_many: tuple[int, int],
) -> list[dict[str, Any]]:
    """Return the touches that moved the belief most; see `Belief.explain`.

    `floored` (n_touches, n_objects) are their log-likelihoods, which entered with
    `weight`.
    """
    order = np.argsort(-log_posterior, kind="stable")
    best, rival = int(order[0]), int(order[min(1, len(order) - 1)])
    nats = weight * (floored[:, best] - floored[:, rival])
    n_touches, n_nearest = how_many
    moved = np.argsort(-np.abs(nats), kind="stable")[:n_touches]
    unit = _unit(memory.features)
    return [
        {
            "touch": int(k) + 1,
            "best": str(names[best]),
            "rival": str(names[rival]),
            "nats": float(nats[k]),
            "nearest": _nearest(memory, features[k], unit, n_nearest),
        }
        for k in moved
    ]


def _nearest(
    memory: Memory, features: Floats, unit: float, n_nearest: int
) -> list[dict[str, Any]]:
    """Return the nearest training touches; none where the features are not known."""
    if not np.isfinite(features).all():
        return []
    squared = ((memory.features - features) ** 2).sum(axis=1)
    rows = np.argsort(squared, kind="stable")[:n_nearest]
    return [
        {
            "object": str(memory.objects[row]),
            "row": int(row),
            "distance": float(np.sqrt(squared[row])) / unit,
        }
        for row in rows
    ]


def _unit(features: Array) -> float:
    """Return the median distance between training touches."""
    some = features[:: -(-len(features) // N_PAIRED)]
    squared = ((some[:, np.newaxis] - some) ** 2).sum(axis=2)
    apart = squared[np.triu_indices(len(some), 1)]
    return float(np.sqrt(np.median(apart))) if len(apart) and apart.any() else 1.0
