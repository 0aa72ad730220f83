"""Which stored touches a new one is most like, by the features that recognise it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..recognition import ObjectRecogniser

_SHOWN = 6


class Neighbours:
    """Nearest learnt touches, each feature measured in its own spread.

    Parameters
    ----------
    recogniser : ObjectRecogniser
        Fitted; where a live session taught it, it knows the ids of its touches.
    """

    def __init__(self, recogniser: ObjectRecogniser) -> None:
        features = recogniser.features_
        spread = features.std(axis=0)
        self._scale = np.where(spread > 0, spread, 1.0)
        self._features = features / self._scale
        self._labels = recogniser.labels_
        ids = getattr(recogniser, "touch_ids_", np.empty(0, "U1"))
        self._ids = ids if len(ids) == len(features) else None

    def of(self, features: NDArray[np.float64]) -> list[dict[str, Any]]:
        """Return the nearest touches of features (1, n_features), nearest first.

        `id` is None where the touch is not in the library.
        """
        apart = self._features - features / self._scale
        distance = np.sqrt(np.mean(apart**2, axis=1))
        some = np.argsort(distance, kind="stable")[:_SHOWN]
        return [
            {
                "id": None if self._ids is None else str(self._ids[row]),
                "object": str(self._labels[row]),
                "distance": float(distance[row]),
            }
            for row in some
        ]
