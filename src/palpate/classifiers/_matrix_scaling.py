"""Matrix scaling: posteriors corrected by what is said of touches left out.

Regression on one-hot labels hides a label that lies between others: a middling disc
gets less than the small one or the large one, wherever it is pressed. What it says of
all labels together still tells it. So the log posteriors of touches left out are
features of a multinomial logistic regression: they stay as they are, but for what a
symmetric matrix adds that makes differences between labels larger and none smaller
(positive semidefinite). Of two labels that are taken for each other, touches left out
seem less different than they are, since each lacks those beside it: a free matrix would
make them alike, or even exchange them.

References
----------
C. Guo et al., "On calibration of modern neural networks", ICML 2017; M. Kull et al.,
"Beyond temperature scaling: obtaining well-calibrated multi-class probabilities with
Dirichlet calibration", NeurIPS 2019.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize

from .._numbers import log_loss, log_softmax
from .._types import Array, Floats, Indices
from ._ridge import fair_shares

# Precisions of a normal prior on every entry of the matrix, of one touch's log loss.
PENALTIES = (1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001)
# A penalty is judged on so many runs of each label's groups (two of two), each left out
# by itself: a third of a recording is another time. What is said of touches left out
# comes from more of them, so that it is as good as what is said of new ones.
_N_JUDGED, _N_LEFT_OUT = 3, 5
# Touches times labels squared that a matrix is learnt from: more are thinned out; and
# so many touches for each label, at least.
_MOST_WORK, _FEWEST = 20_000_000, 4
# Where the search for factors begins: at none there is no slope.
_BEGIN = 0.3


class Scaling(NamedTuple):
    """What was learnt of log posteriors of touches left out.

    `matrix` (n_classes + 1, n_classes) is what `scaled` adds, the last row to every
    touch, None where there are too few touches; `penalty` is that of least log loss,
    None, as the matrix then is, where leaving all as it is does as well.
    `left_out` (n_touches, n_classes) are the log posteriors, each scaled by what
    touches of other groups tell.
    """

    matrix: Floats | None
    penalty: float | None
    left_out: Floats


def scaled(log_posterior: Floats, matrix: Floats | None) -> Floats:
    """Return log posteriors (..., n_classes) as a matrix corrects them; None leaves."""
    if matrix is None:
        return np.asarray(log_softmax(log_posterior))
    centred = _centred(log_posterior)
    return np.asarray(log_softmax(centred + centred @ matrix[:-1] + matrix[-1]))


def learn_scaling(log_posterior: Floats, codes: Indices, groups: Array) -> Scaling:
    """Learn from log posteriors (n_touches, n_classes) of touches left out.

    With the column of each touch's own label, and its group (n_touches,): touches of
    one group do not correct each other. Of `PENALTIES`, from the largest, one is taken
    where log loss falls by more than its standard error.
    """
    centred = _centred(log_posterior)
    sampled = _sampled(codes, centred.shape[1])
    loss, chosen = _smoothed_losses(log_softmax(log_posterior), codes), None
    thirds = _runs(codes, groups, _N_JUDGED)
    starts: dict[int, Floats] = {}
    can_judge = len(sampled) and len(np.unique(thirds)) > 1
    for penalty in PENALTIES if can_judge else ():
        left_out = _left_out(centred, codes, sampled, thirds, penalty, starts)
        gained = loss - (corrected := _smoothed_losses(left_out, codes))
        error = gained.std() / np.sqrt(len(gained))
        if gained.mean() > error:
            loss, chosen = corrected, penalty
        elif gained.mean() < -error:
            break
    return scaling_with(chosen, log_posterior, codes, groups)


def scaling_with(
    penalty: float | None,
    log_posterior: Floats,
    codes: Indices,
    groups: Array,
    before: Floats | None = None,
) -> Scaling:
    """Learn with a penalty that was chosen, perhaps from a matrix as it was `before`.

    Of touches as `learn_scaling` takes them; of too few, or where None was chosen,
    there is no matrix.
    """
    as_it_is = Scaling(None, penalty, log_softmax(log_posterior))
    if penalty is None:
        return as_it_is
    centred = _centred(log_posterior)
    sampled = _sampled(codes, centred.shape[1])
    runs = _runs(codes, groups, _N_LEFT_OUT)
    if not (len(sampled) and runs.any()):
        return as_it_is
    start = None
    if before is not None and before.shape[1] == centred.shape[1]:
        start = _factors_of(before)
    factors = _fitted(centred[sampled], codes[sampled], penalty, start)
    starts = dict.fromkeys(range(_N_LEFT_OUT), factors)
    left_out = _left_out(centred, codes, sampled, runs, penalty, starts)
    return Scaling(_matrix_of(factors), penalty, left_out)


def _left_out(
    centred: Floats,
    codes: Indices,
    sampled: Indices,
    runs: Indices,
    penalty: float,
    starts: dict[int, Floats],
) -> Floats:
    """Return log posteriors, each scaled by what other runs tell.

    Factors are sought from those of each run, if there are any, and kept there. A run
    is left as it is where others lack a label: they would only tell against it.
    """
    left_out = log_softmax(centred)
    for run in np.unique(runs).tolist():
        rows = sampled[runs[sampled] != run]
        if len(np.unique(codes[rows])) < centred.shape[1]:
            continue
        factors = _fitted(centred[rows], codes[rows], penalty, starts.get(run))
        starts[run] = factors
        left_out[runs == run] = scaled(centred[runs == run], _matrix_of(factors))
    return left_out


def _centred(log_posterior: Floats) -> Floats:
    """Return log posteriors less the mean of each touch: a constant tells nothing."""
    return np.asarray(log_posterior - log_posterior.mean(axis=-1, keepdims=True))


def _sampled(codes: Indices, n_classes: int) -> Indices:
    """Return every k-th touch of each label, for the least k that fits.

    None where they are few, or a label has none: it would be taken for one that is
    never met.
    """
    step = -(-len(codes) // max(1, _MOST_WORK // n_classes**2))
    order = np.argsort(codes, kind="stable")
    labels, first = np.unique(codes[order], return_index=True)
    if len(labels) < n_classes or -(-len(codes) // step) < _FEWEST * n_classes:
        return order[:0]
    place = np.arange(len(codes)) - first[codes[order]]
    return np.sort(order[place % step == 0])


def _runs(codes: Indices, groups: Array, n_runs: int) -> Indices:
    """Return in which run of its label's groups each touch is, as they came.

    Groups of several labels count to the first of these, whichever was touched first.
    """
    names, group = np.unique(groups, return_inverse=True)
    run = np.empty(len(names), dtype=np.intp)
    label_of = np.full(len(names), codes.max())
    np.minimum.at(label_of, group, codes)
    for code in np.unique(label_of):
        of_label = np.flatnonzero(label_of == code)
        run[of_label] = np.arange(len(of_label)) * n_runs // len(of_label)
    return run[group]


def _fitted(
    centred: Floats, codes: Indices, penalty: float, start: Floats | None
) -> Floats:
    """Return factors of least log loss and penalty, (n_classes + 1, n_classes).

    Of labels that are smoothed as in `_smoothed_losses`.
    """
    n_classes, shares = centred.shape[1], fair_shares(codes)
    shape, one_hot = (n_classes + 1, n_classes), np.eye(n_classes)[codes]
    # What smoothing adds to the loss is linear in the logits.
    smoothing = _share_of_others(*centred.shape) * shares[:, np.newaxis]
    smoothing = smoothing * (n_classes * one_hot - 1)

    def loss(flat: Floats) -> tuple[float, Floats]:
        factors = flat.reshape(shape)
        matrix = _matrix_of(factors)
        logits = centred + centred @ matrix[:-1] + matrix[-1]
        value = float(np.vdot(smoothing, logits))
        plain, pull = log_loss(logits, codes, shares)
        value, pull = value + plain, pull + smoothing
        slope = np.vstack([centred.T @ pull, pull.sum(axis=0)]) + penalty * matrix
        # By the factors, of which the matrix is the square.
        slope[:-1] = (slope[:-1] + slope[:-1].T) @ factors[:-1]
        return value + penalty * float((matrix**2).sum()) / 2, slope.ravel()

    begin = _BEGIN * np.eye(*shape) if start is None else start
    # Losses to a millionth: more moves nothing that anyone sees.
    fit: Any = minimize(
        loss, begin.ravel(), jac=True, method="L-BFGS-B", options={"ftol": 1e-6}
    )
    return np.asarray(fit.x.reshape(shape))


def _smoothed_losses(log_posterior: Floats, codes: Indices) -> Floats:
    """Return the log loss of each touch (nats), its label smoothed by Laplace's rule.

    Of n touches each counts as (n + 1) / (n + 2) of its label and as much of the others
    as of the label it lacks: where all are told apart, being surer is no gain.
    """
    of_label = log_posterior[np.arange(len(codes)), codes]
    gaps = log_posterior.shape[1] * of_label - log_posterior.sum(axis=1)
    return np.asarray(_share_of_others(*log_posterior.shape) * gaps - of_label)


def _share_of_others(n_touches: int, n_classes: int) -> float:
    """Return how much a touch counts as each label that is not its own."""
    return 1 / (n_touches + 2) / max(1, n_classes - 1)


def _matrix_of(factors: Floats) -> Floats:
    """Return the matrix of factors: symmetric, and no difference gets less by it."""
    return np.vstack([factors[:-1] @ factors[:-1].T, factors[-1]])


def _factors_of(matrix: Floats) -> Floats:
    """Return factors that a matrix is about the square of: none without a slope."""
    squares, directions = np.linalg.eigh(matrix[:-1])
    sizes = np.sqrt(np.maximum(squares, _BEGIN**2))
    return np.vstack([directions * sizes, matrix[-1]])
