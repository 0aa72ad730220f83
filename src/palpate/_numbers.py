"""Sums of exponentials, for the millions of small ones between a touch and a belief."""

import numpy as np

from ._types import Array, Floats


def log_softmax(values: Array, axis: int = -1) -> Floats:
    """Return values less the logarithm of the sum of their exponentials.

    As `scipy.special.log_softmax`, whose checks take longer than a single touch does.
    """
    largest = values.max(axis=axis, keepdims=True)
    if not np.isfinite(largest).all():
        largest = np.where(np.isfinite(largest), largest, 0)
    result: Floats = values - largest
    total = np.exp(result).sum(axis=axis, keepdims=True)
    with np.errstate(divide="ignore"):
        result -= np.log(total)
    return result
