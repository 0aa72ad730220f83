"""One encoding of one set of touches: counts chosen on one half, reported on the other.

Component counts come from the first half alone: by the Davies-Bouldin index for
Table 2, by accuracy in randomised folds for Fig. 3. The second half is then
cross-validated within itself, in randomised folds and recording by recording.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.stats import t as student
from sklearn.model_selection import StratifiedKFold

from ..._types import Floats
from ...evaluation import davies_bouldin
from .._report import Row, mean_row, row
from .._touches import Codes
from ._methods import Encoded, encode
from ._plan import BEST, CLASSIFIERS, TABLE_2, Corradi2014Plan
from ._shapes import Shapes

SENSORS = ("simulated", "simulated-pins")
N_FOLDS = 5
Counts = tuple[int, ...]
# From training and test touches, numbers of components and a seed to per cent right.
Right = Callable[[Codes, Codes, Counts, int], list[float]]


@dataclass(frozen=True)
class Judged:
    """Rows of one encoding, and the accuracy of each fold for the paired test.

    `folds[classifier]` has shape (n_runs, 5), in per cent.
    """

    rows: list[Row]
    folds: dict[str, Floats]


def judge(shapes: Shapes, variant: str, name: str, plan: Corradi2014Plan) -> Judged:
    """Choose on the first half and report on the second."""
    counts = plan.counts(name)
    asked = None if shapes.asked is None else shapes.asked[variant]
    encoded = encode(name, shapes.images[variant], asked, counts)
    known = {"data": shapes.data, "encoding": name, "variant": variant}
    first, second = (np.flatnonzero(shapes.half == h) for h in (0, 1))
    rows, folds = [], {}
    if asked is None:
        rows += list(_table_2(encoded, shapes, known, counts))
    for kind in CLASSIFIERS:
        right = partial(encoded.right, kind, shapes.codes)
        # The network is the slowest by far: every other number.
        tried = tuple(reversed(counts[::-2])) if kind == "network" else counts
        runs = plan.choice_runs if kind == "1-NN" else plan.slow_choice_runs
        tests = _random_folds(right, shapes.codes, first, tried, runs, plan.seed + 1)
        chosen = tried[int(tests.mean(axis=(0, 1)).argmax())]
        runs = plan.slow_runs if kind in ("network", "SVMs") else plan.runs
        tests = _random_folds(right, shapes.codes, second, (chosen,), runs, plan.seed)
        folds[kind] = tests[..., 0]
        grouped = _grouped_folds(right, shapes.groups, second, chosen, plan.seed)
        for one in _fig_3(known, kind, folds[kind].mean(axis=1), grouped):
            rows.append({**one, "n_components": chosen})
    return Judged(rows, folds)


def corrected_t_test(differences: Floats) -> tuple[float, float, float]:
    """Return mean difference, its standard error and p of no difference.

    Folds of repeated cross-validation share touches, so the variance of their mean
    is taken as (1 / n + n_test / n_train) times theirs.

    Parameters
    ----------
    differences : ndarray of shape (n_runs, n_folds)
        Of the two methods on the same folds.

    References
    ----------
    .. [1] C. Nadeau, Y. Bengio, "Inference for the generalization error", Machine
       Learning 52, 2003. doi:10.1023/A:1024068626366
    """
    n, n_folds = differences.size, differences.shape[1]
    mean = float(differences.mean())
    error = float(np.sqrt((1 / n + 1 / (n_folds - 1)) * differences.var(ddof=1)))
    if error == 0:
        return mean, 0.0, 1.0 if mean == 0 else 0.0
    return mean, error, float(2 * student.sf(abs(mean) / error, n - 1))


def holm(p_values: list[float]) -> list[float]:
    """Return p values that hold for all tests together (Holm's step-down rule).

    References
    ----------
    .. [1] S. Holm, "A simple sequentially rejective multiple test procedure",
       Scand. J. Statist. 6(2), 1979.
    """
    order = np.argsort(p_values)
    scaled = np.asarray(p_values)[order] * np.arange(len(order), 0, -1)
    held = np.minimum(np.maximum.accumulate(scaled), 1.0)
    result = np.empty(len(order))
    result[order] = held
    return [float(p) for p in result]


def _table_2(
    encoded: Encoded, shapes: Shapes, known: Row, counts: tuple[int, ...]
) -> Iterator[Row]:
    """Indices on the second half, the count being the best on the first."""
    first, second = (np.flatnonzero(shapes.half == h) for h in (0, 1))
    name, variant = known["encoding"], known["variant"]
    by_sensor = zip(SENSORS, TABLE_2.get(name, {}).get(variant, ()), strict=False)
    paper = dict(by_sensor).get(known["data"])
    both = encoded.features(first, second, counts)
    for q, beside in ((2, paper), (1, None)):
        indices = [davies_bouldin(both[n][0], shapes.codes[first], q) for n in counts]
        chosen = counts[int(np.argmin(indices))]
        index = davies_bouldin(both[chosen][1], shapes.codes[second], q)
        yield {
            **row(f"{name}, {variant}, q = {q}", index, None, beside),
            **known,
            "table": "Table 2",
            "unit": "index",
            "q": q,
            "n_components": chosen,
        }


def _fig_3(known: Row, kind: str, runs: Floats, grouped: Floats) -> Iterator[Row]:
    name, variant = known["encoding"], known["variant"]
    paper = BEST.get((name, kind, variant)) if known["data"] == "simulated" else None
    for folds, values in {"randomised": runs, "grouped": grouped}.items():
        shown = f"{name}, {kind}, {variant}, {folds} folds"
        yield {
            **mean_row(shown, values, paper if folds == "randomised" else None),
            **known,
            "table": "Fig. 3",
            "unit": "per cent",
            "classifier": kind,
            "folds": folds,
            "runs": len(runs) if folds == "randomised" else 1,
        }


def _random_folds(
    right: Right, codes: Codes, rows: Codes, counts: Counts, runs: int, seed: int
) -> Floats:
    """Return per cent right, shape (n_runs, 5, n_counts)."""
    found = []
    for run in range(runs):
        folds = StratifiedKFold(N_FOLDS, shuffle=True, random_state=1000 * seed + run)
        for train, test in folds.split(rows, codes[rows]):
            found.append(right(rows[train], rows[test], counts, run))
    return np.array(found).reshape(runs, N_FOLDS, len(counts))


def _grouped_folds(
    right: Right, groups: Codes, rows: Codes, count: int, seed: int
) -> Floats:
    """Return per cent right of each recording, learnt from the others."""
    found = []
    for group in np.unique(groups[rows]):
        held = groups[rows] == group
        found += right(rows[~held], rows[held], (count,), seed)
    return np.array(found)
