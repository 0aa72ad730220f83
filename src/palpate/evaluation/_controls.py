"""Nuisance controls: what values that are not touch achieve by themselves.

A recogniser that beats none of these has learnt the recording, not the objects.
Each control learns and tests on the same touches as the recogniser, with the same
classifier, from nothing but its own values.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from sklearn.preprocessing import StandardScaler
from sklearn.utils import gen_batches

from .._types import Array, Bools, Floats
from ..classifiers import KernelRidgeClassifier
from ..images import fill_dead_taxels, find_rims
from ..recognition import correlation, find_geometry
from ..touches import Touches
from ._splits import split_touches

NO_CONTACT_CORRELATION = 0.98
LEAST_TO_SPLIT = 4
N_QUANTILES = 64
BLOCK = 256


def disc_centres(touches: Touches) -> Floats | None:
    """Return (row, column) of each image's rim in pixels; None without a dome."""
    if find_geometry(touches) != "dome":
        return None
    images, frame = _grey(fill_dead_taxels(touches.images)), touches.no_contact
    idle = None if frame is None else _grey(fill_dead_taxels(frame[np.newaxis]))[0]
    rims = find_rims(images, no_contact=idle)
    return np.stack([rims.row, rims.col], axis=1)


def brightness(touches: Touches) -> Floats:
    """Return mean and standard deviation of each image, (n_touches, 2)."""
    blocks = _blocks(touches.images)
    rows = [[np.nanmean(b, axis=1), np.nanstd(b, axis=1)] for b in blocks]
    return np.concatenate(rows, axis=1).T


def sorted_pixels(touches: Touches) -> Floats:
    """Return quantiles of each image's pixels divided by its total.

    All taxels in order of size where there are at most 64 of them, else 64
    quantiles (of every n-th row and column, where a side is above 64): what is
    known without any geometry. Shape (n_touches, n_values).
    """
    step = -(-max(touches.images.shape[1:3]) // N_QUANTILES)
    images = touches.images[:, ::step, ::step]
    n_pixels = images[0].size
    levels = np.linspace(0, 1, min(N_QUANTILES, n_pixels))
    rows = []
    for block in _blocks(images):
        values = np.nanquantile(block, levels, axis=1).T
        total = np.nansum(np.abs(block), axis=1, keepdims=True)
        rows.append(values / np.where(total > 0, total, 1) * n_pixels)
    return np.concatenate(rows)


def without_contact(touches: Touches) -> Bools | None:
    """Return which touches look like the no-contact frame; None without one.

    Those whose correlation with it is above 0.98.
    """
    frame = touches.no_contact
    if frame is None:
        return None
    idle = np.nan_to_num(np.asarray(frame, dtype=np.float64))
    blocks = map(np.nan_to_num, _blocks(touches.images))
    alike = np.concatenate([correlation(block, idle) for block in blocks])
    return np.asarray(alike > NO_CONTACT_CORRELATION)


CONTROLS: dict[str, Callable[[Touches], Floats | None]] = {
    "disc centre": disc_centres,
    "brightness": brightness,
    "sorted pixels": sorted_pixels,
}


def control_log_likelihood(
    train: Floats, labels: Array, groups: Array | None, test: Floats
) -> Floats:
    """Learn labels from nuisance values; return log-likelihoods of test touches."""
    scale = StandardScaler().fit(train)
    classifier = KernelRidgeClassifier(widths=(0.5, 2.0, 8.0))
    classifier.fit(scale.transform(train), labels, groups=groups)
    return classifier.log_likelihood(scale.transform(test))


def named_alone(touches: Touches) -> dict[str, dict[str, float]]:
    """Return what each nuisance value alone names right, and what chance does.

    The last quarter of each object's touches is asked, the others teach; objects of
    fewer than four touches are left out. Nothing where two objects are not left.
    """
    if touches.object is None:
        return {}
    names, counts = np.unique(touches.object, return_counts=True)
    kept = names[counts >= LEAST_TO_SPLIT]
    if len(kept) < 2:
        return {}
    (fold,) = split_touches(touches[np.isin(touches.object, kept)], "last")
    shares = {}
    for name, measure in CONTROLS.items():
        of_train, of_test = measure(fold.train), measure(fold.test)
        if of_train is None or of_test is None:
            continue
        labels = np.asarray(fold.train.object)
        scores = control_log_likelihood(of_train, labels, None, of_test)
        right = kept[scores.argmax(axis=1)] == fold.test.object
        shares[name] = {"right": float(right.mean()), "chance": 1 / len(kept)}
    return shares


def _grey(images: Floats) -> Floats:
    """Return images as the mean over their channels, if they have any."""
    return images if images.ndim == 3 else np.asarray(images.mean(axis=3))


def _blocks(images: Array) -> Iterator[Floats]:
    """Yield some images at a time, (n_touches, n_taxels)."""
    for rows in gen_batches(len(images), BLOCK):
        yield images[rows].reshape(len(images[rows]), -1).astype(np.float64)


def telling(figures: dict[str, Any]) -> str:
    """Return after how many touches touch and controls are to be compared.

    After the most, unless both get all right there, which tells nothing.
    """
    right: dict[str, float] = figures["accuracy"]
    controls: dict[str, dict[str, float] | None] = figures["controls"]
    curves = [c for name, c in controls.items() if c and name != "no contact"]
    some_wrong = [
        k for k in right if right[k] < 1 or all(c.get(k, 0) < 1 for c in curves)
    ]
    return [*right, *some_wrong][-1]


def as_good_alone(figures: dict[str, Any]) -> list[str]:
    """Return a sentence for each nuisance control that does as well as touch.

    Where touch gets all right, a control that was behind before only follows it.
    """
    sentences, right = [], figures["accuracy"]
    for name, curve in figures["controls"].items():
        as_good = [k for k in right if (curve or {}).get(k, -1) >= right[k]]
        if len(as_good) < len(right):
            as_good = [k for k in as_good if right[k] < 1]
        if as_good and name != "no contact":
            after = f"{', '.join(as_good)} touch{'es' * (as_good != ['1'])}"
            sentences.append(
                f"{name} alone does as well after {after}: the recogniser may have "
                "learnt the recording, not the objects."
            )
    return sentences
