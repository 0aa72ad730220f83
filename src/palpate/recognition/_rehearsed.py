"""How far machines that know invented sessions count beside those that do not.

How a session changes touches is invented, and weighed down in the features before a
second machine learns them. How far it is to be trusted beside the first is told by
touches left out: as they are, and as in the invented sessions.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from typing import NamedTuple

import numpy as np

from .._numbers import evenly_rounded, log_softmax
from .._types import Array, Bools, Floats, Indices
from ..classifiers import EncodingPool

# A smaller share changes next to nothing, and would double the work of each touch.
LEAST_SHARE = 0.1
# Machines that are asked about invented sessions learn at most so many touches.
_AT_MOST = 500


class Drawn(NamedTuple):
    """Touches in invented sessions: features (n_sessions, n_drawn, n_features).

    The first session is that of training, of the training touches `rows` (n_drawn,).
    Of the others the first `n_weighing` tell the share, all of them where it is None.
    """

    features: Floats
    rows: Indices
    n_weighing: int | None = None


def rehearsed(
    pool: EncodingPool,
    X: Floats,
    y: Array,
    groups: Indices,
    weighing: Floats,
    drawn: Drawn,
    sessions_known: bool,
) -> tuple[EncodingPool, float, Floats]:
    """Return a pool whose machines know invented sessions too, and how far they count.

    The plain pool where they count for nothing. Also which share of touches, learnt
    from half of them, is recognised as they are and in each session (n_sessions + 1,).

    Parameters
    ----------
    pool : EncodingPool
        What learnt the touches `X` (n_touches, n_features), labels `y`, in `groups`.
    weighing : ndarray of shape (n_features, n_features)
        What weighs down how the invented sessions differ, part by part.
    drawn : Drawn
        Touches in these sessions.
    sessions_known : bool
        Whether groups are whole sessions, or persons: then these tell the share, else
        invented sessions do as well, and count half.

    Notes
    -----
    The share is that of the weights of least log loss; a priori both count alike, with
    a standard deviation as large (`EncodingPool.best_weights`).
    """
    weighed = EncodingPool(pool.parts, pool.machine, together=pool.together)
    weighed.fit(X @ weighing, y, groups=groups)
    codes = np.searchsorted(pool.classes_, y)
    rows = pool.left_out_rows
    left_out = np.stack([pool.left_out_, weighed.left_out_])
    label_codes, n_ordinary = codes[rows], len(rows)
    of_drawn, is_asked = _answers_of_drawn(pool, weighed, X, y, groups, weighing, drawn)
    drawn_codes = codes[drawn.rows]
    if not sessions_known and is_asked.any():
        # As many of each kind, in turn.
        invented = of_drawn[:, 1:][:, : drawn.n_weighing, is_asked]
        names = np.tile(drawn_codes[is_asked], invented.shape[1])
        invented = invented.reshape(2, -1, of_drawn.shape[3])
        n_each = min(n_ordinary, len(names))
        sampled, others = (evenly_rounded(n, n_each) for n in (n_ordinary, len(names)))
        left_out = np.concatenate([left_out[:, sampled], invented[:, others]], axis=1)
        label_codes = np.concatenate([label_codes[sampled], names[others]])
    finite = np.isfinite(left_out).all(axis=(0, 2))
    bounded = np.maximum(left_out[:, finite], -30.0)
    weights = EncodingPool.best_weights(bounded, label_codes[finite])
    share = float(weights[1] / max(weights.sum(), 1e-12))
    if share < LEAST_SHARE:
        share = 0.0
    mixed = (1 - share) * of_drawn[0] + share * of_drawn[1]
    is_right = (mixed.argmax(axis=-1) == drawn_codes)[:, is_asked]
    right = is_right.mean(axis=1) if is_asked.any() else np.full(len(is_right), np.nan)
    if share:
        pool = pool.beside(weighed, weighing, share, codes[rows], groups[rows])
    return pool, share, right


def _answers_of_drawn(
    pool: EncodingPool,
    weighed: EncodingPool,
    X: Floats,
    y: Array,
    groups: Indices,
    weighing: Floats,
    drawn: Drawn,
) -> tuple[Floats, Bools]:
    """Return what both pools say of drawn touches whose group they have not learnt.

    Shape (2, n_sessions, n_drawn, n_classes), of machines that learnt one half of each
    label's groups, with the choices made for all; and which touches could be asked.
    """
    n_sessions, n_drawn, n_features = drawn.features.shape
    answers = np.zeros((2, n_sessions, n_drawn, len(pool.classes_)))
    is_asked = np.zeros(n_drawn, dtype=bool)
    for learnt, left_out in halves(y, groups, drawn.rows):
        rows = np.isin(np.arange(n_drawn), left_out)
        is_asked |= rows
        test_features = drawn.features[:, rows].reshape(-1, n_features)
        for kind, (machines, matrix) in enumerate(((pool, None), (weighed, weighing))):
            touches, others = X[learnt], test_features
            if matrix is not None:
                touches, others = touches @ matrix, others @ matrix
            refitted = copy(machines).refit(touches, y[learnt], groups=groups[learnt])
            columns = np.searchsorted(pool.classes_, refitted.classes_)
            row = np.full((len(others), len(pool.classes_)), -30.0)
            row[:, columns] = refitted.log_likelihood(others)
            answers[kind][:, rows] = row.reshape(n_sessions, int(rows.sum()), -1)
    return log_softmax(answers, axis=-1), is_asked


def halves(
    y: Array, groups: Indices, drawn: Indices
) -> Iterator[tuple[Indices, Indices]]:
    """Yield touches to learn, of half of each label's groups, and to ask of the rest.

    Those are some of the touches `drawn`, by their place in it, of labels that are
    learnt; nothing where fewer than two labels are, or none can be asked.
    """
    half = np.zeros(len(y), dtype=np.intp)
    for name in np.unique(y):
        of_label = y == name
        half[of_label] = np.unique(groups[of_label], return_inverse=True)[1] % 2
    for k in range(2):
        learnt = _thinned(np.flatnonzero(half != k), y)
        left_out = (half[drawn] == k) & np.isin(y[drawn], y[learnt])
        if len(np.unique(y[learnt])) > 1 and left_out.any():
            yield learnt, np.flatnonzero(left_out)


def _thinned(rows: Indices, y: Array) -> Indices:
    """Return at most so many rows, of each label its share, at least four."""
    if len(rows) <= _AT_MOST:
        return rows
    kept = []
    for name in np.unique(y[rows]):
        of_label = rows[y[rows] == name]
        count = len(of_label)
        n_kept = min(count, max(4, round(count * _AT_MOST / len(rows))))
        kept.append(of_label[evenly_rounded(count, n_kept)])
    return np.sort(np.concatenate(kept))
