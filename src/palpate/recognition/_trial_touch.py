"""A model that was read is tried on a blank touch before anyone relies on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._checks import check_number
from ..touches import Touches

if TYPE_CHECKING:
    from ._recogniser import ObjectRecogniser

MAX_PIXELS = 50_000_000


def try_one_touch(recogniser: ObjectRecogniser) -> None:
    """Recognise a blank touch, so that a model that cannot work is found now."""
    n_rows, n_cols = recogniser.encoder_.image_shape_
    kept = (
        recogniser.features_,
        recogniser.labels_,
        recogniser.objects_,
        recogniser.nothing_,
    )
    rows = {len(array) for array in kept}
    if not (0 < n_rows * n_cols <= MAX_PIXELS and rows == {len(recogniser.stretches_)}):
        raise ValueError("its sizes do not agree")
    check_number("floor_", recogniser.floor_, low=0, high=0.5)
    blank = Touches(np.zeros((1, *recogniser.encoder_.image_shape_)))
    features = recogniser.features_and_log_likelihood(blank)[0]
    # A blank touch may count as no contact, whose row is zeros whatever the classifier.
    row = recogniser.feature_log_likelihood(features)
    if row.shape != (1, len(recogniser.classes_)) or not np.isfinite(row).all():
        raise ValueError("its parts do not fit together")
    belief = recogniser.start()
    belief.update_from_log_likelihood(row, features=features)
    if abs(sum(belief.posterior.values()) - 1) > 1e-6:
        raise ValueError("its belief does not sum to one")
    belief.decide()
