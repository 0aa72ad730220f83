"""Which encoding suits this sensor: asked of altered touches that were left out."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.base import clone

from ..images import fill_dead_taxels, repose
from ..touches import Touches
from ._calibration import touch_log_likelihood
from ._encoder import TouchEncoder
from ._geometry import find_geometry
from ._presets import Preset
from ._sequence import with_floor

AT_MOST = 600
N_FOLDS = 3
SHIFT_SHARE = 0.05
GAIN_RANGE = 1.2


def choose_encoder(
    preset: Preset, touches: Touches, labels: NDArray, group: NDArray, seed: int
) -> tuple[TouchEncoder, dict[str, Any]]:
    """Return the preset's best encoder for these touches, and the reasons.

    With several candidates each learns two thirds of the groups (at most
    `AT_MOST` touches) and is asked about the rest, turned by any angle, shifted by
    up to 5 % of the side and multiplied by up to 1.2 or its inverse, so that
    none is chosen that only works upright; the least log loss wins.

    Returns
    -------
    encoder : TouchEncoder
        Not fitted yet.
    chosen : dict
        Name, geometry, and per candidate the log loss (nats) and accuracy.
    """
    candidates = preset.encoders(touches)
    chosen: dict[str, Any] = {"geometry": find_geometry(touches)}
    if len(candidates) == 1:
        name, encoder = next(iter(candidates.items()))
        chosen |= {"encoding": name, "why": "the one encoding for this geometry"}
        return encoder, chosen
    some = np.unique(np.linspace(0, len(labels) - 1, AT_MOST).astype(int))
    fold = _folds(group[some])
    results = {
        name: _try(
            encoder, preset.classifier(), touches[some], labels[some], fold, seed
        )
        for name, encoder in candidates.items()
    }
    best = min(results, key=lambda name: results[name]["log_loss"])
    why = "least log loss on touches left out, turned, shifted and re-exposed"
    return candidates[best], {
        **chosen,
        "encoding": best,
        "why": why,
        "candidates": results,
    }


def alter(images: NDArray, seed: int) -> NDArray[np.float64]:
    """Return the images turned, shifted and re-exposed at random, same shape.

    Dead taxels are filled first.
    """
    rng = np.random.default_rng(seed)
    n_touches, n_rows, n_cols = images.shape
    reach = SHIFT_SHARE * min(n_rows, n_cols)
    living = fill_dead_taxels(images)
    return repose(
        living,
        rng.uniform(0, 360, n_touches),
        rng.uniform(-reach, reach, (n_touches, 2)),
        np.exp(rng.uniform(-1, 1, n_touches) * np.log(GAIN_RANGE)),
    )


def _try(
    encoder: TouchEncoder,
    classifier: Any,
    touches: Touches,
    labels: NDArray,
    fold: NDArray,
    seed: int,
) -> dict[str, float]:
    encoder = clone(encoder)
    features = encoder.fit_transform(touches)
    altered = encoder.transform(Touches(alter(touches.images, seed)))
    classes = np.unique(labels)
    log_posterior = np.full((len(labels), len(classes)), -np.log(len(classes)))
    for k in range(N_FOLDS):
        train, test = fold != k, fold == k
        if not test.any() or len(np.unique(labels[train])) < 2:
            continue
        again = clone(classifier).fit(features[train], labels[train])
        columns = np.searchsorted(classes, again.classes_)
        row = np.full((int(test.sum()), len(classes)), -np.inf)
        row[:, columns] = touch_log_likelihood(again, altered[test])
        log_posterior[test] = with_floor(row, 0.01)
    codes = np.searchsorted(classes, labels)
    hit = log_posterior.argmax(axis=1) == codes
    loss = -log_posterior[np.arange(len(codes)), codes].mean()
    return {"log_loss": float(loss), "accuracy": float(hit.mean())}


def _folds(group: NDArray) -> NDArray[np.intp]:
    """Deal whole groups to folds in turn."""
    return np.unique(group, return_inverse=True)[1] % N_FOLDS
