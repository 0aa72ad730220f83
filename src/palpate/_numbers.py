"""Sums of exponentials, the floor and the like, millions of which make a belief.

And other numbers that several subpackages ask for: bounds on shares, thresholds; and
numbers as sentences for people have them, the same in terminal, page and reports.
"""

import math
from typing import Any

import cv2
import numpy as np

from ._types import Array, Floats, Indices

# OpenCV counts the elements of a row in 32 bits.
_MOST = 2**31 - 1
# The log-likelihood of what one touch rules out, where that is allowed.
_RULED_OUT = -1e6
CONFIDENCE = 0.95
# Interpolation leaves rounding of this relative size in what should be constant.
_ROUNDING = 1e-12


def exp(values: Array, out: Array | None = None) -> Array:
    """Return e to the power of values, in `out` if given, which may be `values`.

    `np.exp` within two units in the last place. OpenCV's takes a fifth of the time
    where numpy has no vector code for it (processors without AVX-512).
    """
    return _quickly(cv2.exp, np.exp, values, out)


def log(values: Array, out: Array | None = None) -> Array:
    """Return natural logarithms, of 0 minus infinity; as `exp`, a third of the time."""
    return _quickly(cv2.log, np.log, values, out)


def _quickly(opencv: Any, of_numpy: Any, values: Array, out: Array | None) -> Array:
    """Return a function of values by OpenCV, or by numpy where only that can."""
    if (
        0 < values.size <= _MOST
        and values.flags.c_contiguous
        and values.dtype in (np.float64, np.float32)
        and (out is None or out is values)
    ):
        flat = values.reshape(1, -1)
        quick = opencv(flat, dst=None if out is None else flat)
        return np.asarray(quick).reshape(values.shape)
    with np.errstate(divide="ignore"):
        return np.asarray(of_numpy(values, out=out))


def evenly_spaced(n: int, count: int) -> Indices:
    """Return at most `count` of `n` indices, evenly spaced from first to last."""
    return np.unique(np.linspace(0, n - 1, count).astype(np.intp))


def evenly_rounded(n: int, most: int) -> Indices:
    """Return at most so many of `n` indices, each nearest to its even place."""
    return np.linspace(0, n - 1, min(n, most)).round().astype(np.intp)


def log_softmax(values: Array, axis: int = -1) -> Floats:
    """Return values less the logarithm of the sum of their exponentials.

    As `scipy.special.log_softmax`, whose checks take longer than a single touch does.
    """
    largest = values.max(axis=axis, keepdims=True)
    if not np.isfinite(largest).all():
        largest = np.where(np.isfinite(largest), largest, 0)
    result: Floats = values - largest
    with np.errstate(divide="ignore"):
        result -= np.log(exp(result).sum(axis=axis, keepdims=True))
    return result


def without_gaps(log_likelihood: Floats) -> Floats:
    """Return log-likelihoods (..., n_classes), the least in place of minus infinity.

    Zeros where all are.
    """
    is_finite = np.isfinite(log_likelihood)
    worst = np.where(is_finite, log_likelihood, np.inf).min(axis=-1, keepdims=True)
    return np.where(is_finite, log_likelihood, np.where(worst < np.inf, worst, 0))


def with_floor(log_likelihood: Floats, floor: float) -> Floats:
    """Return log-likelihoods under which no touch rules an object out.

    Each touch's posterior under equal priors is mixed with the uniform one, so
    that no object gets less than floor / n_objects from one touch. Shape
    (..., n_objects), natural logarithms; with `floor=0` only the scale of each
    touch changes.
    """
    if floor == 0:
        # Finite, so that touches that rule out all objects in turn leave a belief.
        return np.maximum(log_softmax(log_likelihood, axis=-1), _RULED_OUT)
    mixed: Floats = log_likelihood - log_likelihood.max(axis=-1, keepdims=True)
    exp(mixed, out=mixed)
    mixed *= (1 - floor) / mixed.sum(axis=-1, keepdims=True)
    mixed += floor / mixed.shape[-1]
    return log(mixed, out=mixed)


def log_loss(logits: Floats, codes: Array, shares: Floats) -> tuple[float, Floats]:
    """Return the log loss of softmax beliefs (nats), and its slope by each logit.

    Of `logits` (n_touches, n_classes), which become the slope, the column of each
    touch's own class (n_touches,) and its share in the loss (n_touches,).
    """
    each = np.arange(len(codes))
    of_labels = logits[each, codes]
    largest = logits.max(axis=1)
    logits -= largest[:, np.newaxis]
    exp(logits, out=logits)
    total = logits.sum(axis=1)
    loss = (largest + np.log(total) - of_labels) @ shares
    logits *= (shares / total)[:, np.newaxis]
    logits[each, codes] -= shares
    return float(loss), logits


def correlation(images: Array, idle: Array) -> Floats:
    """Return the correlation of each image with one, 0 for even ones, (n_touches,)."""
    centred_idle = idle.ravel().astype(np.float64)
    centred_idle -= centred_idle.mean()
    correlations = np.zeros(len(images))
    for number, image in enumerate(images):  # one at a time, it stays in the cache
        flat = image.ravel().astype(np.float64)
        flat -= flat.mean()
        norm = np.linalg.norm(flat) * np.linalg.norm(centred_idle)
        correlations[number] = flat @ centred_idle / norm if norm > 0 else 0.0
    return correlations


def units_needed(share: float) -> int:
    """Return how many units, of which none is wrong, show a share at 95 %."""
    return math.ceil(math.log(1 - CONFIDENCE) / math.log1p(-share))


def upper_bound(n_wrong: float, n_units: int) -> float:
    """Return the bound at 95 % on a share, of units that were wrong among others."""
    from scipy.stats import beta

    if n_wrong >= n_units:
        return 1.0
    return float(beta.ppf(CONFIDENCE, n_wrong + 1, n_units - n_wrong))


def otsu_thresholds(levels: Array) -> Floats:
    """Return the threshold of most variance between classes of each row of levels.

    The middle of the best gap between levels (the lowest of equals), NaN for a constant
    row. N. Otsu, IEEE SMC 9(1), 1979. doi:10.1109/TSMC.1979.4310076
    """
    ordered = np.sort(levels.astype(np.float64, copy=False), axis=1)
    n_rows, n_levels = ordered.shape
    if n_levels < 2:
        return np.full(n_rows, np.nan)
    below = np.arange(1, n_levels)
    total = np.cumsum(ordered - ordered.mean(axis=1, keepdims=True), axis=1)[:, :-1]
    # Between-class variance, up to a factor, for a cut after each sorted level.
    between = total**2 / (below * (n_levels - below))
    gap = np.diff(ordered, axis=1)
    size = np.abs(ordered[:, [0, -1]]).max(axis=1, keepdims=True)
    between[gap <= _ROUNDING * size] = -1.0
    best = between.max(axis=1, keepdims=True)
    cut = (between >= best * (1 - _ROUNDING)).argmax(axis=1)
    row = np.arange(n_rows)
    threshold = (ordered[row, cut] + ordered[row, cut + 1]) / 2
    return np.where(best[:, 0] < 0, np.nan, threshold)


def share_of(probability: float) -> str:
    """Return a probability as people read it, rounded down.

    What has not reached a limit never reads as if it had, nor 100 % unless certain.
    """
    if probability > 0.999:
        return "over 99.9 %"
    if probability < 0.01:
        return "under 1 %"
    steps = 10 if probability >= 0.99 else 1
    # 0.29 is 29 %, though 100 times it is a little less.
    return f"{math.floor(100 * steps * probability + 1e-9) / steps:g} %"


def figure_of(share: float) -> str:
    """Return a share for a table: rounded down, so that none sum to more than 100 %."""
    if 0.999 < share < 1:
        return ">99.9 %"
    if 0 < share < 0.001:
        return "<0.1 %"
    steps = 1 if 0.1 <= share < 0.99 else 10
    digits = int(steps > 1 and 0 < share < 1)
    return f"{math.floor(100 * steps * share + 1e-9) / steps:.{digits}f} %"


def about(number: int) -> int:
    """Return a number rounded to two figures."""
    return round(number, 2 - len(str(number)))


def n_touches_of(n_touches: int | str) -> str:
    """Return a number of touches in words: "1 touch", "5 touches"."""
    return f"{n_touches} touch{'es' * (str(n_touches) != '1')}"
