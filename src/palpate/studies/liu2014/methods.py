"""Twofold cross-validation of the classifiers that Liu et al. compare, job by job.

A method is fitted on training touches and answers for the others with one row of labels
per setting; it is never given the labels of what it answers for. Settings are chosen
inside the training half, but every one answers for the test half, so that what the
paper did (the setting that is best on the reported runs) can be shown beside the honest
figure. Labels are whole numbers. Kernel widths are in median distances of the training
touches, so that one grid serves z-scored and raw features. A method's `settings` are
its grid, simplest first: among equally good ones the first is taken; `answers` are the
labels of the test touches, (n_settings, n_test).

A job gives one row or two. The paper looks at images of a bar: light loads leave them
incomplete, heavy ones distort them, thin covers break them up, thick ones blur them
(Figs 5 and 6). Here the same is counted over all presses.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, product
from typing import Any

import numpy as np
from scipy.spatial.distance import pdist
from sklearn.model_selection import StratifiedKFold
from sklearn.neighbors import KNeighborsClassifier
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from ..._types import Bools, Floats
from ...classifiers import MKLSVC
from ...encodings import CentroidMoments, KernelPCA
from ...touches import Touches
from .. import Codes, Row, Work, coded, fitted, spread
from . import plan as stated
from .plan import PAPER_N, PAPER_PARTITIONS, Encoded, Liu2014Plan, encode, overlap

Setting = dict[str, Any]
_WHOLE = {"encoding": "FD+GE", "classes": "all"}


class Method:
    """A classifier over its whole grid of settings, one machine for each."""

    @property
    def settings(self) -> Sequence[Setting]:
        raise NotImplementedError

    def machines(self, train: Floats) -> list[Any]:
        raise NotImplementedError

    def answers(self, train: Floats, codes: Codes, test: Floats) -> Codes:
        # One pair of many that stops short of its tolerance is still a machine.
        machines = self.machines(train)
        return np.stack([fitted(m, train, codes).predict(test) for m in machines])


@dataclass(frozen=True)
class Neighbours(Method):
    """The k nearest neighbours, k = 3 as in the paper."""

    k: int = 3

    @property
    def settings(self) -> Sequence[Setting]:
        return [{"k": self.k}]

    def machines(self, train: Floats) -> list[Any]:
        return [KNeighborsClassifier(self.k, algorithm="brute")]


@dataclass(frozen=True)
class GaussianSVM(Method):
    """One-against-one SVMs with a Gaussian kernel (scikit-learn's `SVC`)."""

    widths: Sequence[float]
    costs: Sequence[float]

    @property
    def settings(self) -> Sequence[Setting]:
        return [{"width": width, "C": C} for C in self.costs for width in self.widths]

    def machines(self, train: Floats) -> list[Any]:
        unit = median_distance(train)
        grid = [(s["C"], 0.5 / (s["width"] * unit) ** 2) for s in self.settings]
        return [SVC(C=C, gamma=gamma) for C, gamma in grid]


@dataclass(frozen=True)
class MKL(Method):
    """The MKL-SVM over the paper's 22 kernels; `normalize` as `MKLSVC` has it."""

    costs: Sequence[float]
    normalize: str = "trace"

    @property
    def settings(self) -> Sequence[Setting]:
        return [{"C": C} for C in self.costs]

    def machines(self, train: Floats) -> list[Any]:
        options: dict[str, Any] = {"normalize": self.normalize, "probability": False}
        return [MKLSVC(C=C, **options) for C in self.costs]


@dataclass(frozen=True)
class Fused(Method):
    """Kernel PCA (`scaling` as `KernelPCA` has it) before a classifier."""

    classifier: Method
    widths: Sequence[float]
    components: Sequence[int]
    scaling: str = "unit"

    @property
    def settings(self) -> Sequence[Setting]:
        return [
            {"kpca_width": width, "components": kept, **inner}
            for width in self.widths
            for kept in self.components
            for inner in self.classifier.settings
        ]

    def answers(self, train: Floats, codes: Codes, test: Floats) -> Codes:
        unit = median_distance(train)
        answers_of = []
        for width in self.widths:
            options: Setting = {"sigma": width * unit, "scaling": self.scaling}
            fusion = KernelPCA(max(self.components), **options).fit(train)
            old, new = fusion.transform(train), fusion.transform(test)
            # Fewer components are the first columns of the most.
            for kept in self.components:
                both = old[:, :kept], codes, new[:, :kept]
                answers_of.append(self.classifier.answers(*both))
        return np.concatenate(answers_of)


@dataclass(frozen=True)
class Half:
    """The setting that the training half chose, and what each names of the other."""

    chosen: int
    right: Floats
    n_test: int


Runs = Sequence[list[Half]]


def nested_figure(settings: Sequence[Setting], runs: Runs) -> Row:
    """Return mean and deviation over runs, %, the setting most chosen and its share."""
    shares = np.array([_pooled(run, [half.chosen for half in run]) for run in runs])
    chosen = np.array([half.chosen for run in runs for half in run])
    counts = np.bincount(chosen, minlength=len(settings))
    most = int(counts.argmax())
    return _figure(shares, settings[most], float(counts[most] / len(chosen)))


def paper_figure(settings: Sequence[Setting], runs: Runs) -> Row:
    """Return the setting that is best on these very runs, as the paper does."""
    each = range(len(settings))
    shares = np.array([[_pooled(run, [s] * len(run)) for s in each] for run in runs])
    best = int(shares.mean(axis=0).argmax())
    return _figure(shares[:, best], settings[best], 1.0)


def _figure(shares: Floats, setting: Setting, chosen_share: float) -> Row:
    per_cent = 100 * shares
    figure = {"ours": float(per_cent.mean()), "sd": spread(per_cent)}
    return {**figure, "chosen": setting, "chosen_share": chosen_share}


def _pooled(run: Sequence[Half], settings: Sequence[int]) -> float:
    """Share right over both halves, each with its own setting."""
    shares = [half.right[s] for half, s in zip(run, settings, strict=True)]
    return float(np.average(shares, weights=[half.n_test for half in run]))


def median_distance(touches: Floats) -> float:
    """Return the median distance of touches that differ; 1 when none do."""
    distance = pdist(touches)
    above_zero = distance[distance > 0]
    return float(np.median(above_zero)) if len(above_zero) else 1.0


@dataclass(frozen=True, eq=False)
class Job:
    """Features, labels and a method; `row` is what is known before the figures."""

    row: Row
    features: Floats
    codes: Codes
    method: Method

    @property
    def work(self) -> float:
        """The length of a run, in no unit."""
        return float(len(self.method.settings) * self.row["n_classes"] ** 2)

    def run(self, plan: Liu2014Plan, number: int) -> list[Half]:
        """Cut the touches in two halves, class by class, and test each on the other."""
        seeds = np.random.SeedSequence((plan.seed, number)).generate_state(2).tolist()
        halves = StratifiedKFold(2, shuffle=True, random_state=seeds[0])
        return [
            self.half(train, test, seeds[1], plan.inner_folds)
            for train, test in halves.split(self.features, self.codes)
        ]

    def half(self, train: Codes, test: Codes, seed: int, inner_folds: int) -> Half:
        """Choose a setting on the training touches; test labels are only compared."""
        right = np.zeros(len(self.method.settings))
        if len(right) > 1:
            folds = StratifiedKFold(inner_folds, shuffle=True, random_state=seed)
            for learnt, held in folds.split(train, self.codes[train]):
                right += self._right(train[learnt], train[held]).sum(axis=1)
        shares = self._right(train, test).mean(axis=1)
        return Half(int(right.argmax()), shares, len(test))

    def _right(self, train: Codes, test: Codes) -> Bools:
        """Return which test touches are named right, (n_settings, n_test)."""
        old, new = self.features[train], self.features[test]
        if self.row["features"] == "z-scored":
            scale = StandardScaler().fit(old)
            old, new = scale.transform(old), scale.transform(new)
        answers = self.method.answers(old, self.codes[train], new)
        return np.asarray(answers == self.codes[test])

    def rows(self, runs: Runs, plan: Liu2014Plan) -> Iterator[Row]:
        """Yield a row per protocol; where nothing is chosen, one outside Table 2."""
        single = len(self.method.settings) == 1 and self.row["table"] != "Table 2"
        for protocol in plan.protocols[:1] if single else plan.protocols:
            summary = nested_figure if protocol == "nested" else paper_figure
            figure = summary(self.method.settings, runs)
            yield {**self.row, "protocol": protocol, **figure}


def run_jobs(jobs: Sequence[Job], plan: Liu2014Plan, work: Work) -> list[Row]:
    # The longest first, so that no worker is left with one at the end.
    order = sorted(range(len(jobs)), key=lambda j: -jobs[j].work)
    tasks = [(jobs[j], plan, number) for j in order for number in range(plan.runs)]
    done = iter(work.done(Job.run, tasks, "cross-validating"))
    runs = {j: list(islice(done, plan.runs)) for j in order}
    return [row for j, job in enumerate(jobs) for row in job.rows(runs[j], plan)]


def study_jobs(plan: Liu2014Plan, touches: Touches, data: str) -> list[Job]:
    """Return Table 2, the controls and Figs 12 to 14 for one set of touches."""
    most = max(plan.n, *plan.counts)
    encoded = {p: encode(touches.images, p, most) for p in plan.partitions}
    jobs = [
        job
        for partitions, features in encoded.items()
        for job in _table_2(plan, features, coded(touches), partitions)
    ]
    jobs += _controls(plan, touches)
    if PAPER_PARTITIONS in encoded:
        jobs += _equal_grids(plan, encoded[PAPER_PARTITIONS], coded(touches))
        jobs += _figures(plan, encoded[PAPER_PARTITIONS], touches)
    for job in jobs:
        job.row["data"] = data
    return jobs


def condition_jobs(plan: Liu2014Plan) -> Iterator[Job]:
    """Press all parts at every load, then under every cover; 3-NN names them."""
    setups = [(f"{load:g} kgf", load, stated.PAPER_COVER_MM) for load in plan.loads_kgf]
    setups += [(f"cover {mm:g} mm", stated.PAPER_LOAD_KGF, mm) for mm in plan.covers_mm]
    for number, (condition, load, cover) in enumerate(setups):
        table = "Fig. 5" if number < len(plan.loads_kgf) else "Fig. 6"
        touches = stated.simulated_presses(plan, load, cover)
        encoded = encode(touches.images, PAPER_PARTITIONS, plan.n)
        whole = encode(touches.images, 1, 1).binary
        pieces = stated.count_pieces(whole)
        truth = stated.footprints(touches, whole.shape[1:])
        row: Row = {
            "table": table,
            "condition": condition,
            "classes": "all",
            "load_kgf": load,
            "cover_mm": cover,
            "pieces": float(pieces.mean()),
            "in_pieces": 100 * float((pieces > 1).mean()),
            "pieces_2x2": float(stated.count_pieces(encoded.binary).mean()),
            "overlap": 100 * float(overlap(whole, truth).mean()),
            "overlap_2x2": 100 * float(overlap(encoded.binary, truth).mean()),
            "data": "simulated",
        }
        compared = {"FD+GE": encoded.features("FD+GE", plan.n), **_pixels(touches)}
        for encoding, features in compared.items():
            name = f"{encoding} k-NN, {condition}"
            facts = {"name": name, "encoding": encoding, **row}
            yield from _jobs(facts, features, coded(touches), Neighbours())


def _table_2(
    plan: Liu2014Plan, encoded: Encoded, codes: Codes, partitions: int
) -> Iterator[Job]:
    svm = GaussianSVM(plan.svm_widths, plan.svm_costs)
    mkl, grid = MKL(plan.mkl_costs), (plan.widths, plan.components)
    methods: dict[str, Method] = {
        "FD+GE k-NN": Neighbours(),
        "FD+GE SVM": svm,
        "KPCA+SVM": Fused(svm, *grid),
        "KPCA+MKL-SVM": Fused(mkl, *grid),
    }
    suffix, paper = f", {partitions} x {partitions}", dict[str, float]()
    if partitions == PAPER_PARTITIONS:
        methods["KPCA (eq. 5)+MKL-SVM"] = Fused(mkl, *grid, scaling="paper")
        suffix, paper = "", stated.TABLE_2 if plan.n == PAPER_N else {}
    features = encoded.features("FD+GE", plan.n)
    for name, method in methods.items():
        row = {"name": name + suffix, "table": "Table 2", "paper": paper.get(name)}
        facts = {**row, **_WHOLE, "n": plan.n, "partitions": partitions}
        yield from _jobs(facts, features, codes, method)


def _equal_grids(plan: Liu2014Plan, encoded: Encoded, codes: Codes) -> Iterator[Job]:
    """SVM and MKL on the same components, each with the same number of settings."""
    costs = plan.equal_costs
    methods: dict[str, Method] = {
        "KPCA+SVM": GaussianSVM(plan.svm_widths, plan.svm_costs),
        "KPCA+MKL-SVM, trace": MKL(costs),
        "KPCA+MKL-SVM, variance": MKL(costs, "variance"),
    }
    width, kept = plan.widths[len(plan.widths) // 2], max(plan.components)
    features = encoded.features("FD+GE", plan.n)
    for name, method in methods.items():
        row = {"name": f"{name}, {len(costs)} settings", "table": "equal grids"}
        facts = {**row, **_WHOLE, "n": plan.n, "partitions": PAPER_PARTITIONS}
        yield from _jobs(facts, features, codes, Fused(method, (width,), (kept,)))


def _controls(plan: Liu2014Plan, touches: Touches) -> Iterator[Job]:
    """Pixels without geometry, pixels as they are, and moments, on all classes."""
    moments = CentroidMoments().fit_transform(touches.images)
    methods: dict[str, Method] = {
        "k-NN": Neighbours(),
        "SVM": GaussianSVM(plan.svm_widths, plan.svm_costs),
    }
    for encoding, features in {**_pixels(touches), "centroid moments": moments}.items():
        facts = {"table": "controls", "encoding": encoding, "classes": "all"}
        for name, method in methods.items():
            row = {"name": f"{encoding} {name}", **facts}
            yield from _jobs(row, features, coded(touches), method)


def _figures(plan: Liu2014Plan, encoded: Encoded, touches: Touches) -> Iterator[Job]:
    """3-NN on each class set: FD, GE, both, and two controls."""
    compared: list[tuple[str, str, int | None]] = [("Fig. 13", "GE", None)]
    for n in plan.counts:
        compared += [("Fig. 12", "FD", n), ("Fig. 14", "FD+GE", n)]
    pixels = _pixels(touches)
    compared += [("Figs 12-14", encoding, None) for encoding in pixels]
    part = touches.columns.get("part")
    sets = {"all": np.ones(len(touches), dtype=bool)}
    if part is not None:
        sets = {name: np.isin(part, parts) for name, parts in plan.class_sets.items()}
    for classes, (figure, encoding, count) in product(sets, compared):
        held, published = sets[classes], stated.FIGURES.get((encoding, classes))
        shown = "" if count is None else f", n = {count}"
        row = {
            "name": f"{encoding} k-NN{shown}, {classes}",
            "table": figure,
            "paper": published if count in (None, PAPER_N) else None,
            "encoding": encoding,
            "classes": classes,
            "n": count,
            "partitions": PAPER_PARTITIONS,
        }
        features = pixels.get(encoding)
        if features is None:
            features = encoded.features(encoding, count or 0)
        yield from _jobs(row, features[held], coded(touches)[held], Neighbours())


def _jobs(row: Row, features: Floats, codes: Codes, method: Method) -> Iterator[Job]:
    """Yield the same for z-scored and for raw features."""
    sizes = {"n_classes": len(np.unique(codes)), "n_touches": len(codes)}
    for scaling in stated.SCALINGS:
        facts: Row = {"paper": None, **sizes, "features": scaling}
        yield Job({**facts, **row}, features, codes, method)


def _pixels(touches: Touches) -> dict[str, Floats]:
    """Return pixels as they are, and what of them tells without any geometry."""
    flat = touches.images.reshape(len(touches), -1).astype(np.float64)
    # By the largest level first, so that no sum over- or underflows.
    top = np.abs(flat).max(axis=1, keepdims=True)
    relative = flat / np.where(top > 0, top, 1)
    size = top * np.abs(relative).sum(axis=1, keepdims=True)
    shares = flat / np.where(size > 0, size, 1)
    return {"sorted pixels": np.sort(shares, axis=1)[:, ::-1], "raw pixels": flat}
