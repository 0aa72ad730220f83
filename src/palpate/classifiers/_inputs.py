"""Checks of what a fitted classifier is given: touches, a new label, groups."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.utils.validation import validate_data

from .._checks import are_plain_vectors

Floats = NDArray[np.float64]


def as_touches(estimator: BaseEstimator, X: ArrayLike) -> Floats:
    """Return `X` as touches like those of `fit`, (n_touches, n_features).

    Raises what scikit-learn's `validate_data` raises.
    """
    n_features = getattr(estimator, "n_features_in_", -1)
    named = hasattr(estimator, "feature_names_in_")
    if not named and are_plain_vectors(X, n_features):
        return np.asarray(X)
    touches: Floats = validate_data(estimator, X, dtype=np.float64, reset=False)
    return touches


def as_label(label: object, classes: NDArray) -> NDArray:
    """Return a new `label` as an array of one, of the kind of `classes`.

    Raises
    ------
    TypeError
        If it is text among numbers or a number among text.
    ValueError
        If it is known already.
    """
    new = np.array([label], dtype=object)
    if classes.dtype.kind != "O":
        new = np.array([label])
        if new.ndim != 1 or new.dtype.kind != classes.dtype.kind:
            raise TypeError(
                f"label must be of the kind of the known labels ({classes.dtype}), "
                f"got {type(label).__name__}."
            )
    if label in classes.tolist():
        raise ValueError(f"label must be new, got {label!r}. Forget it first.")
    return new


def as_groups(groups: ArrayLike | None, n_touches: int) -> NDArray[np.intp]:
    """Return the number of each training touch's group; by default its own."""
    if groups is None:
        return np.arange(n_touches)
    given = np.asarray(groups)
    if given.shape != (n_touches,):
        raise ValueError(
            f"groups must have one entry per training touch ({n_touches}), "
            f"got shape {given.shape}."
        )
    codes: NDArray[np.intp] = np.unique(given, return_inverse=True)[1]
    return codes
