"""One encoding of one set of touches: counts chosen on one half, reported on the other.

Component counts come from the first half alone: by the Davies-Bouldin index for
Table 2, by accuracy in randomised folds for Fig. 3. The second half is then
cross-validated within itself, in randomised folds and recording by recording.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import eigh
from scipy.stats import t as student
from sklearn.model_selection import StratifiedKFold
from sklearn.neighbors import KNeighborsClassifier
from sklearn.neural_network import MLPClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from ..._types import Floats
from ...classifiers import KernelDensityNaiveBayes, OnePerLabelSVC
from ...encodings import encoder_named
from ...evaluation import davies_bouldin
from .._report import Row, mean_row, row
from .._study import fitted
from .._touches import Codes
from ._plan import BEST, CLASSIFIERS, TABLE_2, Corradi2014Plan
from ._shapes import Images, Shapes

SENSORS = ("simulated", "simulated-pins")
N_FOLDS = 5
Counts = tuple[int, ...]
# From training and test touches, numbers of components and a seed to per cent right.
Right = Callable[[Codes, Codes, Counts, int], list[float]]
PRINCIPAL = {"zernike-pca": "zernike", "oriented-pca": "scaled-pixels"}
# Rows and columns that turned images are averaged to before their components.
PCA_SIDE = 32
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Encoded:
    """Touches encoded once for all folds: as they train, and as they are asked.

    Features (n_touches, n_features) by number of components; of `principal` ones, which
    each fold learns, the features before them under the number 0.
    """

    known: dict[int, Floats]
    asked: dict[int, Floats]
    principal: bool

    def features(
        self, train: Codes, test: Codes, counts: Counts
    ) -> dict[int, tuple[Floats, Floats]]:
        """Return training and test features for each number of components."""
        if not self.principal:
            return {n: (self.known[n][train], self.asked[n][test]) for n in counts}
        old, new = self.known[0][train], self.asked[0][test]
        mean = old.mean(axis=0)
        directions = _directions(old - mean, max(counts))
        old, new = (old - mean) @ directions, (new - mean) @ directions
        return {n: (old[:, :n], new[:, :n]) for n in counts}

    def right(
        self,
        kind: str,
        codes: Codes,
        train: Codes,
        test: Codes,
        counts: Counts,
        seed: int,
    ) -> list[float]:
        """Return the per cent that a classifier names, for each of the numbers."""
        found = []
        for old, new in self.features(train, test, counts).values():
            named = answers(kind, old, codes[train], new, seed)
            found.append(float(100 * (named == codes[test]).mean()))
        return found


def encode(name: str, known: Images, asked: Images | None, counts: Counts) -> Encoded:
    """Encode images, and as they look when `asked` if different, for all counts."""
    if name == "scaled-pixels":
        encoders = {n: encoder_named(name, n).fit(known) for n in counts}
    else:
        options = {"side": PCA_SIDE} if name == "oriented-pca" else {}
        encoders = {0: encoder_named(PRINCIPAL.get(name, name), **options).fit(known)}

    def features(images: Images) -> dict[int, Floats]:
        every = {n: encoder.transform(images) for n, encoder in encoders.items()}
        if name in PRINCIPAL or name == "scaled-pixels":
            return every
        return {n: every[0][:, :n] for n in counts}

    old = features(known)
    new = old if asked is None else features(asked)
    return Encoded(old, new, name in PRINCIPAL)


def classifier(name: str, seed: int) -> Any:
    """Return a classifier of the paper, unfitted; it says nothing of scaling."""
    if name == "1-NN":
        return KNeighborsClassifier(1, algorithm="kd_tree")
    if name == "naive Bayes":
        return KernelDensityNaiveBayes()
    if name == "SVMs":
        return make_pipeline(StandardScaler(), OnePerLabelSVC(C=10.0))
    network = MLPClassifier((7,), solver="lbfgs", max_iter=200, random_state=seed)
    return make_pipeline(StandardScaler(), network)


def answers(name: str, train: Floats, codes: Codes, test: Floats, seed: int) -> Codes:
    """Return the label that a classifier gives to each test touch."""
    # The network stops after so many steps, converged or not.
    predicted: Codes = fitted(classifier(name, seed), train, codes).predict(test)
    return predicted


def _directions(centred: Floats, n_components: int) -> Floats:
    """Return principal directions of any variance, (n_features, n or fewer)."""
    n_touches, n_features = centred.shape
    wide = n_features > n_touches
    square = centred @ centred.T if wide else centred.T @ centred
    lowest = max(len(square) - n_components, 0)
    values, vectors = eigh(square, subset_by_index=(lowest, len(square) - 1))
    real = values > _ROUNDING * values[-1]
    values, vectors = values[real][::-1], vectors[:, real][:, ::-1]
    directions: Floats = vectors
    if wide:
        directions = centred.T @ vectors / np.sqrt(values)
    return directions


@dataclass(frozen=True)
class Judged:
    """Rows of one encoding, and per cent right (n_runs, 5) by classifier."""

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
        chosen = tried[0]
        if len(tried) > 1:
            runs = plan.choice_runs if kind == "1-NN" else plan.slow_choice_runs
            seed = plan.seed + 1
            tests = _random_folds(right, shapes.codes, first, tried, runs, seed)
            chosen = tried[int(tests.mean(axis=(0, 1)).argmax())]
        runs = plan.slow_runs if kind in ("network", "SVMs") else plan.runs
        tests = _random_folds(right, shapes.codes, second, (chosen,), runs, plan.seed)
        folds[kind] = tests[..., 0]
        grouped = _grouped_folds(right, shapes.groups, second, chosen, plan.seed)
        for one in _fig_3(known, kind, folds[kind].mean(axis=1), grouped):
            rows.append({**one, "n_components": chosen})
    return Judged(rows, folds)


def corrected_t_test(differences: Floats) -> tuple[float, float, float]:
    """Return mean, standard error and p of no difference; (n_runs, n_folds) given.

    The variance is (1 / n + n_test / n_train) times theirs, as folds share touches
    (Nadeau and Bengio 2003, doi:10.1023/A:1024068626366).
    """
    n, n_folds = differences.size, differences.shape[1]
    mean = float(differences.mean())
    error = float(np.sqrt((1 / n + 1 / (n_folds - 1)) * differences.var(ddof=1)))
    if error == 0:
        return mean, 0.0, 1.0 if mean == 0 else 0.0
    return mean, error, float(2 * student.sf(abs(mean) / error, n - 1))


def holm(p_values: list[float]) -> list[float]:
    """Return p values of all tests together (Holm 1979, Scand. J. Statist. 6(2))."""
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
