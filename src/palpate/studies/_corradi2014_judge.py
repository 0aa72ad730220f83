"""One encoding of one set of touches: counts chosen on one half, reported on the other.

Component counts come from the first half alone: by the Davies-Bouldin index for
Table 2, by accuracy in randomised folds for Fig. 3. The second half is then
cross-validated within itself, in randomised folds and recording by recording.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student
from sklearn.model_selection import StratifiedKFold
from threadpoolctl import threadpool_limits

from ..evaluation import davies_bouldin
from ._corradi2014_methods import Encoded, answers, encode
from ._corradi2014_plan import BEST, CLASSIFIERS, TABLE_2, Corradi2014Plan
from ._corradi2014_touches import Codes, Shapes

Floats = NDArray[np.float64]
Row = dict[str, Any]
SENSOR = {"simulated": 0, "simulated-pins": 1}
N_FOLDS = 5


@dataclass(frozen=True)
class Judged:
    """Rows of one encoding, and the accuracy of each fold for the paired test.

    `folds[classifier]` has shape (n_runs, 5), in per cent.
    """

    rows: list[Row]
    folds: dict[str, Floats]


def judge(shapes: Shapes, variant: str, name: str, plan: Corradi2014Plan) -> Judged:
    """Choose on the first half and report on the second, on one thread."""
    with threadpool_limits(limits=1):
        counts = plan.counts(name)
        asked = None if shapes.asked is None else shapes.asked[variant]
        encoded = encode(name, shapes.images[variant], asked, counts)
        first, second = (np.flatnonzero(shapes.half == h) for h in (0, 1))
        known = {"data": shapes.data, "encoding": name, "variant": variant}
        rows, folds = [], {}
        if asked is None:
            rows += _table_2(encoded, shapes, known, counts)
        for kind in CLASSIFIERS:
            chosen = _choose(encoded, shapes, first, kind, counts, plan)
            found = _random_folds(
                encoded, shapes, second, kind, (chosen,), _runs(kind, plan), plan.seed
            )[..., 0]
            folds[kind] = found
            grouped = _grouped_folds(encoded, shapes, second, kind, chosen, plan.seed)
            rows += _fig_3(known, kind, chosen, found, grouped)
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
) -> list[Row]:
    """Indices on the second half, the count being the best on the first."""
    first, second = (np.flatnonzero(shapes.half == h) for h in (0, 1))
    name, variant = known["encoding"], known["variant"]
    sensor = SENSOR.get(known["data"])
    paper = None
    if sensor is not None and name in TABLE_2:
        paper = TABLE_2[name][variant][sensor]
    rows = []
    for q in (2, 1):
        chosen, index = _index(encoded, shapes.codes, first, second, counts, q)
        rows.append(
            {
                "name": f"{name}, {variant}, q = {q}",
                "paper": paper if q == 2 else None,
                "ours": index,
                "sd": None,
                **known,
                "table": "Table 2",
                "unit": "index",
                "q": q,
                "n_components": chosen,
            }
        )
    return rows


def _index(
    encoded: Encoded,
    codes: Codes,
    first: Codes,
    second: Codes,
    counts: tuple[int, ...],
    q: float,
) -> tuple[int, float]:
    """Return the count of the least index on `first`, and the index on `second`."""
    both = encoded.features(first, second, counts)
    indices = [davies_bouldin(both[n][0], codes[first], q) for n in counts]
    chosen = counts[int(np.argmin(indices))]
    return chosen, davies_bouldin(both[chosen][1], codes[second], q)


def _fig_3(
    known: Row, kind: str, chosen: int, found: Floats, grouped: Floats
) -> list[Row]:
    name, variant = known["encoding"], known["variant"]
    paper = BEST.get((name, kind, variant)) if known["data"] == "simulated" else None
    per_run = found.mean(axis=1)
    spread = float(per_run.std(ddof=1)) if len(per_run) > 1 else None
    figures = (
        ("randomised", per_run.mean(), spread, len(per_run)),
        ("grouped", grouped.mean(), float(grouped.std(ddof=1)), 1),
    )
    return [
        {
            "name": f"{name}, {kind}, {variant}, {folds} folds",
            "paper": paper if folds == "randomised" else None,
            "ours": float(mean),
            "sd": sd,
            **known,
            "table": "Fig. 3",
            "unit": "per cent",
            "classifier": kind,
            "folds": folds,
            "n_components": chosen,
            "runs": runs,
        }
        for folds, mean, sd, runs in figures
    ]


def _choose(
    encoded: Encoded,
    shapes: Shapes,
    first: Codes,
    kind: str,
    counts: tuple[int, ...],
    plan: Corradi2014Plan,
) -> int:
    runs = plan.choice_runs if kind == "1-NN" else plan.slow_choice_runs
    tried = counts
    if kind == "network":
        # The slowest by far: every other number.
        tried = tuple(reversed(counts[::-2]))
    right = _random_folds(encoded, shapes, first, kind, tried, runs, plan.seed + 1)
    return tried[int(right.mean(axis=(0, 1)).argmax())]


def _runs(kind: str, plan: Corradi2014Plan) -> int:
    return plan.slow_runs if kind in ("network", "SVMs") else plan.runs


def _random_folds(
    encoded: Encoded,
    shapes: Shapes,
    rows: Codes,
    kind: str,
    counts: tuple[int, ...],
    runs: int,
    seed: int,
) -> Floats:
    """Return per cent right, shape (n_runs, 5, n_counts)."""
    right = np.empty((runs, N_FOLDS, len(counts)))
    codes = shapes.codes
    for run in range(runs):
        folds = StratifiedKFold(N_FOLDS, shuffle=True, random_state=1000 * seed + run)
        for fold, (a, b) in enumerate(folds.split(rows, codes[rows])):
            train, test = rows[a], rows[b]
            for c, (old, new) in enumerate(
                encoded.features(train, test, counts).values()
            ):
                said = answers(kind, old, codes[train], new, run)
                right[run, fold, c] = 100 * (said == codes[test]).mean()
    return right


def _grouped_folds(
    encoded: Encoded, shapes: Shapes, rows: Codes, kind: str, count: int, seed: int
) -> Floats:
    """Return per cent right of each recording, learnt from the others."""
    codes, right = shapes.codes, []
    for group in np.unique(shapes.groups[rows]):
        held = shapes.groups[rows] == group
        train, test = rows[~held], rows[held]
        old, new = encoded.features(train, test, (count,))[count]
        said = answers(kind, old, codes[train], new, seed)
        right.append(100 * (said == codes[test]).mean())
    return np.array(right)
