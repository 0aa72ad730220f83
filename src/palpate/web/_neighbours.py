"""Which stored touches a new one is most like, by the features that recognise it."""

from collections.abc import Collection
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
        Fitted; learnt from a library, it knows the ids of its touches.
    stored_ids : collection of str
        Ids of the touches in the library at hand.
    """

    def __init__(
        self, recogniser: ObjectRecogniser, stored_ids: Collection[str]
    ) -> None:
        memory = recogniser.memory_
        features = memory.features
        spread = features.std(axis=0)
        self._scale = np.where(spread > 0, spread, 1.0)
        self._features = features / self._scale
        self._labels = memory.labels
        stored = set(stored_ids)
        ids = memory.touch_ids.tolist()
        self._ids = [key if key in stored else None for key in ids]

    def of(self, features: NDArray[np.float64]) -> list[dict[str, Any]]:
        """Return the nearest touches of features (1, n_features), nearest first.

        `id` is None where the touch is not in the library.
        """
        apart = self._features - features / self._scale
        distance = np.sqrt(np.mean(apart**2, axis=1))
        some = np.argsort(distance, kind="stable")[:_SHOWN]
        return [
            {
                "id": self._ids[row],
                "object": str(self._labels[row]),
                "distance": float(distance[row]),
            }
            for row in some
        ]
