"""Simple recognisers, exactly as anyone would write them with scikit-learn.

They are what a benchmark compares presets with. NaN counts as 0; of colour pictures
every fifth pixel counts, the three channels side by side.
"""

from collections.abc import Callable

import numpy as np
from sklearn.base import ClassifierMixin
from sklearn.metrics.pairwise import rbf_kernel
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from .._extras import needed
from .._types import Array, Floats

EVERY = 5
HOG_SIDE, HOG_CELL = 32, 8


def pictures(images: Array) -> Floats:
    """Return touches as pictures of one channel, (n_touches, n_rows, n_cols).

    Channels lie side by side; of colour pictures, whose sides are all of 40 pixels or
    more, every fifth pixel is kept.
    """
    if images.ndim == 4:
        every = EVERY if min(images.shape[1:3]) >= EVERY * HOG_CELL else 1
        thinned = images[:, ::every, ::every]
        images = np.concatenate(np.moveaxis(thinned, -1, 0), axis=2)
    return np.nan_to_num(images.astype(np.float64))


def taxels(images: Array) -> Floats:
    """Return all taxels of each touch, (n_touches, n_taxels)."""
    return pictures(images).reshape(len(images), -1)


def roots(images: Array) -> Floats:
    """Return the signed square root of all taxels, (n_touches, n_taxels)."""
    values = taxels(images)
    return np.copysign(np.sqrt(np.abs(values)), values)


def hog(images: Array) -> Floats:
    """Return histograms of oriented gradients: 9 orientations, blocks of 2 x 2 cells.

    Each picture is divided by its maximum and enlarged until its shorter side has 32
    pixels; it must have 8.
    """
    feature = needed("skimage.feature", "bench", "HOG SVM")
    transform = needed("skimage.transform", "bench", "HOG SVM")
    found = pictures(images)
    shorter = min(found.shape[1:])
    if shorter < HOG_CELL:
        raise ValueError(
            f"pictures must have at least {HOG_CELL} taxels on a side for HOG SVM, got "
            f"{shorter}. Leave it out."
        )
    larger = max(1, HOG_SIDE / shorter)
    shape = [round(side * larger) for side in found.shape[1:]]
    cells = {"pixels_per_cell": (HOG_CELL, HOG_CELL), "cells_per_block": (2, 2)}
    rows = []
    for picture in found:
        scaled = picture / (top if (top := picture.max()) > 0 else 1)
        if larger > 1:
            scaled = transform.resize(scaled, shape)
        rows.append(feature.hog(scaled, orientations=9, **cells))
    return np.stack(rows)


def rbf_by_scale(X: Floats, learnt: Floats) -> Floats:
    """Return the RBF kernel with `gamma="scale"` of the learnt touches.

    `SVC` takes it for its own kernel, many times faster where touches have thousands
    of taxels.
    """
    variance = learnt.var()
    gamma = 1 / (learnt.shape[1] * variance) if variance else 1.0
    found: Floats = rbf_kernel(X, learnt, gamma=gamma)
    return found


SVM = SVC(C=10, kernel=rbf_by_scale)
NEAREST = KNeighborsClassifier(3)
SIMPLE: dict[str, tuple[Callable[[Array], Floats], ClassifierMixin]] = {
    "taxels SVM": (taxels, make_pipeline(StandardScaler(), SVM)),
    "roots SVM": (roots, SVM),
    "HOG SVM": (hog, SVM),
    "3-NN": (taxels, NEAREST),
}
# Of values that are not touch, in any unit.
STANDARDISED = (SIMPLE["taxels SVM"][1], make_pipeline(StandardScaler(), NEAREST))
