"""Learning an encoding: which one suits the sensor, and what it makes of touches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.base import clone

from .._types import Array, Floats
from ..images import fill_dead_taxels, repose
from ..touches import Touches, TouchSource
from ._contact import NO_CONTACT, ContactCheck, encoded_and_flagged
from ._encoder import TouchEncoder, find_geometry
from ._evidence import with_floor
from ._memory import Memory
from ._model_file import state_digest
from ._presets import Preset

# An encoding is learnt from this many touches of a source, the same number of each
# label where there are enough.
SHOWN = 2000
# Candidates are compared on at most so many touches, in so many folds, shifted by up to
# this share of the side and multiplied by up to this factor or its inverse.
AT_MOST = 600
N_FOLDS = 3
SHIFT_SHARE = 0.05
GAIN_RANGE = 1.2


@dataclass
class Encoded:
    """What an encoding makes of touches, one row a touch; see `Memory`."""

    features: Floats
    unexplained: Floats
    nothing: NDArray[np.bool_]


def learn_encoding(
    preset: Preset,
    touches: Touches | TouchSource,
    labels: Array,
    group: NDArray[np.intp],
    seed: int,
) -> tuple[TouchEncoder, ContactCheck, dict[str, Any], Encoded]:
    """Choose and learn an encoding, and what contact looks like.

    Of a source, some touches of each label are shown to the encoder and the rest only
    pass through it. Returns encoder, contact, the reasons for the encoding, and what it
    makes of all the touches.
    """
    if isinstance(touches, Touches):
        encoder, chosen = choose_encoder(preset, touches, labels, group, seed)
        cleaned = encoder.fit_clean(touches)
        contact = ContactCheck().fit(touches, encoder)
        nothing = contact.no_contact(touches, cleaned)
        both = encoder.fit_encode(cleaned, group)
        return encoder, contact, chosen, Encoded(*both, nothing)
    rows = shown_rows(labels)
    shown = touches.touches(rows)
    encoder, chosen = choose_encoder(preset, shown, labels[rows], group[rows], seed)
    left_out = encoder.fit_encode(encoder.fit_clean(shown), group[rows])[1]
    contact = ContactCheck().fit(shown, encoder)
    result = encoded(encoder, contact, touches)
    result.unexplained[rows] = left_out
    return encoder, contact, chosen, result


def encoded(
    encoder: TouchEncoder, contact: ContactCheck, touches: Touches | TouchSource
) -> Encoded:
    """Return what a learnt encoding makes of all touches."""

    def encode(some: Touches) -> Floats:
        features, unexplained, flags = encoded_and_flagged(encoder, contact, some)
        nothing = np.array(flags) == NO_CONTACT
        return np.column_stack([features, unexplained, nothing])

    if isinstance(touches, Touches):
        table = encode(touches)
    else:
        key = state_digest(encoder) + state_digest(contact)
        table = touches.features(key, encode)
    features = np.ascontiguousarray(table[:, :-2])
    return Encoded(features, table[:, -2].copy(), table[:, -1] > 0)


def memory_of(
    touches: Touches | TouchSource,
    encoding: Encoded,
    labels: Array,
    objects: Array,
    blocks: NDArray[np.intp],
) -> Memory:
    """Return what is kept of touches that were encoded."""
    unknown = np.full(len(labels), "")
    sessions, ids = touches.session, touches.touch_id
    return Memory(
        features=encoding.features,
        labels=labels,
        objects=objects,
        blocks=blocks,
        sessions=unknown if sessions is None else sessions.astype(str),
        nothing=encoding.nothing,
        unexplained=encoding.unexplained,
        touch_ids=unknown if ids is None else ids,
    )


def shown_rows(labels: Array, n_shown: int = SHOWN) -> NDArray[np.intp]:
    """Return all rows, of many about `n_shown`, spread evenly over each label."""
    if len(labels) <= n_shown:
        return np.arange(len(labels))
    codes, counts = np.unique(labels, return_inverse=True, return_counts=True)[1:]
    share = max(2, n_shown // len(counts))
    by_label = np.split(np.argsort(codes, kind="stable"), np.cumsum(counts)[:-1])
    chosen = [
        rows[np.unique(np.linspace(0, len(rows) - 1, share).round().astype(int))]
        for rows in by_label
    ]
    return np.sort(np.concatenate(chosen))


def choose_encoder(
    preset: Preset, touches: Touches, labels: Array, group: Array, seed: int
) -> tuple[TouchEncoder, dict[str, Any]]:
    """Return the preset's best encoder for these touches, not fitted, and the reasons.

    With several candidates each learns two thirds of the groups (at most `AT_MOST`
    touches) and is asked about the rest, turned by any angle, shifted by up to 5 % of
    the side and multiplied by up to 1.2 or its inverse, so that none is chosen that
    only works upright; the least log loss (nats) wins.
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


def alter(images: Array, seed: int) -> Floats:
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
    labels: Array,
    fold: Array,
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
        row[:, columns] = again.log_likelihood(altered[test])
        log_posterior[test] = with_floor(row, 0.01)
    codes = np.searchsorted(classes, labels)
    hit = log_posterior.argmax(axis=1) == codes
    loss = -log_posterior[np.arange(len(codes)), codes].mean()
    return {"log_loss": float(loss), "accuracy": float(hit.mean())}


def _folds(group: Array) -> NDArray[np.intp]:
    """Deal whole groups to folds in turn."""
    return np.unique(group, return_inverse=True)[1] % N_FOLDS
