"""Kernel densities per touch beside a bare matrix product and two float64 peers.

The matrix product is the floor: any exact density has to multiply the new touches by
all stored ones. scikit-learn's trees return wrong densities in this many dimensions,
so its `KernelDensity` gets one leaf that holds everything.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import logsumexp
from sklearn.neighbors import KernelDensity

from .._types import Array, Floats
from ..classifiers import KernelDensityBayes
from ._timing import Row, cpu_ms, one_thread, row

SIZES = ((10, 60), (50, 24), (50, 94))  # objects, touches of each
BATCHES = (1, 64)

Measure = Callable[[Floats], Floats]


def bench_likelihood(
    *,
    n_features: int = 22,
    seconds: float = 0.3,
    random_state: int = 0,
) -> list[Row]:
    """Time log-likelihoods per touch; `error_nats` is our largest from float64."""
    rng = np.random.default_rng(random_state)
    rows = []
    with one_thread():
        for n_objects, n_each in SIZES:
            labels = np.repeat(np.arange(n_objects), n_each)
            centres = rng.normal(size=(n_objects, n_features))
            stored = centres[labels] + rng.normal(size=(len(labels), n_features))
            size = f"{n_objects} objects x {n_each} touches, {n_features} features"
            for n_touches in BATCHES:
                new = rng.normal(size=(n_touches, n_features))
                mode = "single" if n_touches == 1 else f"batch {n_touches}"
                name = f"{size}, float32 {mode}"
                rows += _rows(name, stored, labels, new, seconds)
    return rows


def _rows(
    name: str, stored: Floats, labels: Array, new: Floats, seconds: float
) -> list[Row]:
    """Time ours and every peer at one size."""
    model = KernelDensityBayes(precision="single").fit(stored, labels)
    peers = _peers(stored, labels)
    reference = peers["scipy cdist + logsumexp, float64"](new)
    error = float(np.abs(model.log_likelihood(new) - reference).max())
    ours = cpu_ms(lambda: model.log_likelihood(new), seconds) / len(new)
    times = {
        peer: cpu_ms(partial(measure, new), seconds) / len(new)
        for peer, measure in peers.items()
    }
    return [row(name, ours, peer, ms, error_nats=error) for peer, ms in times.items()]


def _peers(stored: Floats, labels: Array) -> dict[str, Measure]:
    """Return what is measured beside ours; preparation is free."""
    columns = np.ascontiguousarray(stored.T, dtype=np.float32)
    deviations = stored.std(axis=0, ddof=1)
    whitened = stored / deviations
    parts = np.split(whitened, np.flatnonzero(np.diff(labels)) + 1)
    trees = [KernelDensity(leaf_size=len(part)).fit(part) for part in parts]
    log_volume = np.log(deviations).sum()
    gaussian = log_volume + stored.shape[1] * np.log(2 * np.pi) / 2

    def product(new: Floats) -> Floats:
        return np.asarray(new.astype(np.float32) @ columns)

    def one_leaf(new: Floats) -> Floats:
        x = new / deviations
        scores = [tree.score_samples(x) for tree in trees]
        return np.asarray(np.stack(scores, axis=1) - log_volume)

    def written_out(new: Floats) -> Floats:
        x = new / deviations
        sums = [logsumexp(cdist(x, p, "sqeuclidean") / -2, axis=1) for p in parts]
        counts = [len(part) for part in parts]
        logs: Floats = np.stack(sums, axis=1) - np.log(counts) - gaussian
        return logs

    return {
        "float32 matrix product": product,
        "scipy cdist + logsumexp, float64": written_out,
        "scikit-learn KernelDensity leaf_size=n": one_leaf,
    }
