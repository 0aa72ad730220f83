"""One encoding of one set of touches: counts chosen on one half, reported on the other.

Component counts come from the first half alone: by the Davies-Bouldin index for
Table 2, by accuracy in randomised folds for Fig. 3. The second half is then
cross-validated within itself, in randomised folds and recording by recording.

Of objects never touched in training the category is named: each fold leaves one object
of every category out. The best of several encodings is chosen by inner folds of the
same kind among the training objects alone, so the objects that are reported have no say
in it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import eigh
from scipy.special import logsumexp
from scipy.stats import t as student
from sklearn.model_selection import StratifiedKFold
from sklearn.neighbors import KNeighborsClassifier
from sklearn.neural_network import MLPClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from ... import classifiers
from ..._types import Floats
from ...encodings import RootScaler, encoder_named
from ...evaluation import davies_bouldin
from ...touches import Touches
from .. import Codes, Row, coded, fitted, mean_row, row
from . import plan as stated
from .plan import CANDIDATES, CLASSIFIERS, Corradi2014Plan, Images, Shapes

SENSORS = ("simulated", "simulated-pins")
N_FOLDS = 5  # as in the paper
Counts = tuple[int, ...]
# From training and test touches, numbers of components and a seed to per cent right.
Right = Callable[[Codes, Codes, Counts, int], list[float]]
PRINCIPAL = {"zernike-pca": "zernike", "oriented-pca": "scaled-pixels"}
# Rows and columns that turned images are averaged to before their components.
PCA_SIDE = 32
_ROUNDING = 1e-12
DATA = "bathtip50, unseen objects"
LENGTHS = (1, 10)
N_ORDERS = 50
FOUNDATION = "zernike-pca"
CHOSEN = "chosen on the training objects"
_KNOWN = {"data": DATA, "unit": "per cent"}


@dataclass(frozen=True, eq=False)
class Encoded:
    """Touches encoded once for all folds: as they train, and as they test.

    Features (n_touches, n_features) by number of components; of `principal` ones, which
    each fold learns, the features before them under the number 0.
    """

    train: dict[int, Floats]
    test: dict[int, Floats]
    principal: bool

    def features(
        self, train: Codes, test: Codes, counts: Counts
    ) -> dict[int, tuple[Floats, Floats]]:
        if not self.principal:
            return {n: (self.train[n][train], self.test[n][test]) for n in counts}
        old, new = self.train[0][train], self.test[0][test]
        mean = old.mean(axis=0)
        # Principal directions of any variance, (n_features, n or fewer).
        centred = old - mean
        wide = centred.shape[1] > len(centred)
        square = centred @ centred.T if wide else centred.T @ centred
        lowest = max(len(square) - max(counts), 0)
        values, vectors = eigh(square, subset_by_index=(lowest, len(square) - 1))
        real = values > _ROUNDING * values[-1]
        values, vectors = values[real][::-1], vectors[:, real][:, ::-1]
        directions = centred.T @ vectors / np.sqrt(values) if wide else vectors
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
        percents = []
        for old, new in self.features(train, test, counts).values():
            named = answers(kind, old, codes[train], new, seed)
            percents.append(float(100 * (named == codes[test]).mean()))
        return percents


def encode(
    name: str, train_images: Images, test_images: Images | None, counts: Counts
) -> Encoded:
    """Encode images, and as `test_images` show them if different, for all counts."""
    if name == "scaled-pixels":
        encoders = {n: encoder_named(name, n).fit(train_images) for n in counts}
    else:
        options = {"side": PCA_SIDE} if name == "oriented-pca" else {}
        encoder = encoder_named(PRINCIPAL.get(name, name), **options)
        encoders = {0: encoder.fit(train_images)}

    def features(images: Images) -> dict[int, Floats]:
        by_count = {n: encoder.transform(images) for n, encoder in encoders.items()}
        if name in PRINCIPAL or name == "scaled-pixels":
            return by_count
        return {n: by_count[0][:, :n] for n in counts}

    old = features(train_images)
    new = old if test_images is None else features(test_images)
    return Encoded(old, new, name in PRINCIPAL)


def answers(name: str, train: Floats, codes: Codes, test: Floats, seed: int) -> Codes:
    """Return what a classifier of the paper names; it says nothing of scaling."""
    model: Any
    if name == "1-NN":
        model = KNeighborsClassifier(1, algorithm="kd_tree")
    elif name == "naive Bayes":
        model = classifiers.KernelDensityNaiveBayes()
    elif name == "SVMs":
        model = make_pipeline(StandardScaler(), classifiers.OnePerLabelSVC(C=10.0))
    else:  # it stops after so many steps, converged or not
        network = MLPClassifier((7,), solver="lbfgs", max_iter=200, random_state=seed)
        model = make_pipeline(StandardScaler(), network)
    return np.asarray(fitted(model, train, codes).predict(test))


@dataclass(frozen=True)
class Judged:
    """Rows of one encoding, and per cent right (n_runs, 5) by classifier."""

    rows: list[Row]
    folds: dict[str, Floats]


def judge(shapes: Shapes, variant: str, name: str, plan: Corradi2014Plan) -> Judged:
    """Choose on the first half and report on the second."""
    counts = plan.counts(name)
    test_images = None if shapes.test_images is None else shapes.test_images[variant]
    encoded = encode(name, shapes.images[variant], test_images, counts)
    facts = {"data": shapes.data, "encoding": name, "variant": variant}
    first, second = (np.flatnonzero(shapes.half == h) for h in (0, 1))
    rows, folds = [], {}
    if test_images is None:
        rows += list(_table_2(encoded, shapes, facts, counts))
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
        # Per cent right of each recording, learnt from the others.
        grouped, group = [], shapes.groups[second]
        for held in (group == number for number in np.unique(group)):
            grouped += right(second[~held], second[held], (chosen,), plan.seed)
        for figures in _fig_3(facts, kind, folds[kind].mean(axis=1), np.array(grouped)):
            rows.append({**figures, "n_components": chosen})
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
    return list(held[np.argsort(order)].tolist())


def _table_2(
    encoded: Encoded, shapes: Shapes, facts: Row, counts: tuple[int, ...]
) -> Iterator[Row]:
    """Indices on the second half, the count being the best on the first."""
    first, second = (np.flatnonzero(shapes.half == h) for h in (0, 1))
    name, variant = facts["encoding"], facts["variant"]
    by_sensor = zip(
        SENSORS, stated.TABLE_2.get(name, {}).get(variant, ()), strict=False
    )
    paper = dict(by_sensor).get(facts["data"])
    both = encoded.features(first, second, counts)
    for q, beside in ((2, paper), (1, None)):
        indices = [davies_bouldin(both[n][0], shapes.codes[first], q) for n in counts]
        chosen = counts[int(np.argmin(indices))]
        index = davies_bouldin(both[chosen][1], shapes.codes[second], q)
        shown = f"{name}, {variant}, q = {q}"
        more = {**facts, "table": "Table 2", "unit": "index", "q": q}
        yield row(shown, index, None, beside, **more, n_components=chosen)


def _fig_3(facts: Row, kind: str, runs: Floats, grouped: Floats) -> Iterator[Row]:
    name, variant = facts["encoding"], facts["variant"]
    paper = (
        stated.BEST.get((name, kind, variant)) if facts["data"] == "simulated" else None
    )
    alike = {**facts, "table": "Fig. 3", "unit": "per cent", "classifier": kind}
    protocols = (("randomised", runs, paper, len(runs)), ("grouped", grouped, None, 1))
    for folds, values, beside, n_runs in protocols:
        shown = f"{name}, {kind}, {variant}, {folds} folds"
        yield mean_row(shown, values, beside, **alike, folds=folds, runs=n_runs)


def _random_folds(
    right: Right, codes: Codes, rows: Codes, counts: Counts, runs: int, seed: int
) -> Floats:
    """Return per cent right, shape (n_runs, 5, n_counts)."""
    percents = []
    for run in range(runs):
        folds = StratifiedKFold(N_FOLDS, shuffle=True, random_state=1000 * seed + run)
        for train, test in folds.split(rows, codes[rows]):
            percents.append(right(rows[train], rows[test], counts, run))
    return np.array(percents).reshape(runs, N_FOLDS, len(counts))


@dataclass(frozen=True, eq=False)
class Recording:
    """Touches cut to discs; `codes` are categories, `fold` numbers their objects."""

    images: dict[str, Images]
    codes: Codes
    objects: Codes
    fold: Codes


def recording(touches: Touches) -> Recording:
    """Cut the touches to discs and number the objects of each category."""
    codes, objects = coded(touches, "category"), coded(touches)
    fold = np.zeros(len(codes), dtype=np.intp)
    for category in np.unique(codes):
        members = codes == category
        fold[members] = np.unique(objects[members], return_inverse=True)[1]
    return Recording(stated.variants(stated.rim_discs(touches)), codes, objects, fold)


def judge_unseen(
    seen: Recording, variant: str, name: str, plan: Corradi2014Plan
) -> list[Row]:
    """Return one row per classifier: one touch names the category, per cent."""
    counts = plan.counts(name)[1::2]
    encoded = encode(name, seen.images[variant], None, counts)

    def judged(kind: str, k: int) -> tuple[float, int]:
        """Return per cent right on fold `k`, and the count chosen without it."""
        others, test = np.flatnonzero(seen.fold != k), np.flatnonzero(seen.fold == k)
        # The network takes the machines' count: it would be chosen for minutes.
        chooser = "SVMs" if kind == "network" else kind
        left_out = seen.fold[others] == (k + 1) % (seen.fold.max() + 1)
        held = others[left_out][:: 2 * plan.thinning]
        rest = others[~left_out][:: 4 * plan.thinning]
        shares = encoded.right(chooser, seen.codes, rest, held, counts, plan.seed)
        chosen = counts[int(np.argmax(shares))]
        train = others[:: 2 * plan.thinning]
        (share,) = encoded.right(kind, seen.codes, train, test, (chosen,), plan.seed)
        return share, chosen

    rows = []
    for kind in CLASSIFIERS:
        folds = [judged(kind, k) for k in range(plan.fold_limit)]
        right, chosen = zip(*folds, strict=True)
        kept: Row = {**_KNOWN, "table": "unseen", "encoding": name, "variant": variant}
        kept |= {"classifier": kind, "n_components": list(chosen)}
        rows.append(mean_row(f"{name}, {kind}, {variant}", np.array(right), **kept))
    return rows


def candidate_features(seen: Recording, name: str) -> list[Floats]:
    """Return the features of each part of a candidate.

    What polar gradients learn (a scale per channel) is undone by the scaling of
    each feature on the training touches, so all touches may teach it.
    """
    parts = CANDIDATES["zernike" if name == FOUNDATION else name]
    return [
        encoder_named(encoding, **options).fit_transform(seen.images[variant])
        for encoding, options, variant in parts
    ]


def compare_fold(
    seen: Recording, features: dict[str, list[Floats]], k: int, plan: Corradi2014Plan
) -> dict[str, Any]:
    """Choose among candidates without fold `k`'s objects, then test them all on it.

    Returns `chosen`, `inner` (per cent of inner folds) and `right`, after each number
    of touches, also of the foundation as its paper has it.
    """
    test, train_rows = np.flatnonzero(seen.fold == k), np.flatnonzero(seen.fold != k)
    train, thin = train_rows[:: plan.thinning], train_rows[:: 2 * plan.thinning]
    inner, right = {}, {}
    for name, parts in features.items():
        posterior = partial(_log_posterior, seen, name, parts)
        right[name] = _right_after(seen, posterior(train, test), test)
        # Share right on left-out objects among the known ones, after one touch.
        shares = []
        for held in np.unique(seen.fold[train_rows])[: plan.fold_limit]:
            held_out = seen.fold[thin] == held
            log_posterior = posterior(thin[~held_out], thin[held_out])
            shares.append(_right_after(seen, log_posterior, thin[held_out])[0])
        inner[name] = float(np.mean(shares))
    # The foundation's own classifier.
    old, new = _zernike_pca(features[FOUNDATION][0], train, test)
    scores = (
        classifiers.KernelDensityBayes().fit(old, seen.codes[train]).log_likelihood(new)
    )
    density = scores - logsumexp(scores, axis=1, keepdims=True)
    right[f"{FOUNDATION}, kernel density"] = _right_after(seen, density, test)
    chosen = max(inner, key=lambda name: inner[name])
    return {"chosen": chosen, "inner": inner, "right": right}


def compared_rows(results: list[dict[str, Any]]) -> list[Row]:
    """Return rows of each candidate, of the chosen ones, and of their lead."""
    after = {
        name: np.array([result["right"][name] for result in results])
        for name in results[0]["right"]
    }
    after[CHOSEN] = np.array([r["right"][r["chosen"]] for r in results])
    after[f"{CHOSEN}, less {FOUNDATION}"] = after[CHOSEN] - after[FOUNDATION]
    rows = []
    chosen = [result["chosen"] for result in results]
    for name, right in after.items():
        for length, folds in zip(LENGTHS, right.T, strict=True):
            facts = {**_KNOWN, "table": "best", "encoding": name, "after": length}
            facts |= {"folds_right": folds.tolist(), "chosen": chosen}
            rows.append(mean_row(f"{name}, after {length}", folds, **facts))
    return rows


def _log_posterior(
    seen: Recording, name: str, parts: list[Floats], train: Codes, test: Codes
) -> Floats:
    """Kernel ridge on scaled features, told which touches are of one object."""
    if name == FOUNDATION:
        old, new = _zernike_pca(parts[0], train, test)
    else:
        scalers = [RootScaler().fit(part[train]) for part in parts]
        both = list(zip(scalers, parts, strict=True))
        old = np.hstack([scaler.transform(part[train]) for scaler, part in both])
        new = np.hstack([scaler.transform(part[test]) for scaler, part in both])
    model = classifiers.KernelRidgeClassifier(max_choice_touches=800)
    model.fit(old, seen.codes[train], groups=seen.objects[train])
    return model.predict_log_proba(new)


def _zernike_pca(moments: Floats, train: Codes, test: Codes) -> tuple[Floats, Floats]:
    """Components that hold 95 % of the training touches' variance."""
    encoded = Encoded({0: moments}, {0: moments}, principal=True)
    n_moments = moments.shape[1]
    old, new = encoded.features(train, test, (n_moments,))[n_moments]
    share = np.cumsum(old.var(axis=0)) / old.var(axis=0).sum()
    kept = int(np.searchsorted(share, 0.95)) + 1
    return old[:, :kept], new[:, :kept]


def _right_after(seen: Recording, log_posterior: Floats, test: Codes) -> list[float]:
    """Per cent right after one touch, and after ten in random orders."""
    single = 100 * (log_posterior.argmax(axis=1) == seen.codes[test]).mean()
    rng = np.random.default_rng(0)
    right = []
    for number in np.unique(seen.objects[test]):
        rows = np.flatnonzero(seen.objects[test] == number)
        for _ in range(N_ORDERS):
            drawn = rng.permutation(rows)[: LENGTHS[1]]
            answer = log_posterior[drawn].sum(axis=0).argmax()
            right.append(answer == seen.codes[test[rows[0]]])
    return [float(single), float(100 * np.mean(right))]
