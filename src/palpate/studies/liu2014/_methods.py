"""Twofold cross-validation of the classifiers that Liu et al. compare.

A method is fitted on training touches and answers for the others with one row of labels
per setting; it is never given the labels of what it answers for. Settings are chosen
inside the training half, but every one answers for the test half, so that what the
paper did (the setting that is best on the reported runs) can be shown beside the honest
figure. Labels are whole numbers. Kernel widths are in median distances of the training
touches, so that one grid serves z-scored and raw features.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.spatial.distance import pdist
from sklearn.model_selection import StratifiedKFold
from sklearn.neighbors import KNeighborsClassifier
from sklearn.svm import SVC

from ..._types import Floats
from ...classifiers import MKLSVC
from ...encodings import KernelPCA
from .._report import Row, spread
from .._study import fitted
from .._touches import Codes

Setting = dict[str, Any]


class Method(Protocol):
    """A classifier over its whole grid of settings."""

    @property
    def settings(self) -> Sequence[Setting]:
        """The grid, simplest first: among equally good settings the first is taken."""

    def answers(self, train: Floats, codes: Codes, test: Floats) -> Codes:
        """Return the label of each test touch, shape (n_settings, n_test)."""


@dataclass(frozen=True)
class Half:
    """The setting that the training half chose, and what each names of the other."""

    chosen: int
    right: Floats
    n_test: int


@dataclass(frozen=True)
class Twofold:
    """Twofold cross-validation, inner folds choosing; `scaled` ones are z-scored."""

    scaled: bool
    inner_folds: int

    def run(
        self, method: Method, features: Floats, codes: Codes, seed: Sequence[int]
    ) -> list[Half]:
        """Cut the touches in two halves, class by class, and test each on the other."""
        split, inner = np.random.SeedSequence(seed).generate_state(2).tolist()
        halves = StratifiedKFold(2, shuffle=True, random_state=split)
        return [
            self.half(method, features, codes, train, test, inner)
            for train, test in halves.split(features, codes)
        ]

    def half(
        self,
        method: Method,
        features: Floats,
        codes: Codes,
        train: Codes,
        test: Codes,
        seed: int,
    ) -> Half:
        """Choose a setting on the training touches; test labels are only compared."""
        chosen = self._choose(method, features[train], codes[train], seed)
        answers = self._answers(method, features, codes, train, test)
        return Half(chosen, (answers == codes[test]).mean(axis=1), len(test))

    def _choose(self, method: Method, known: Floats, codes: Codes, seed: int) -> int:
        if len(method.settings) == 1:
            return 0
        right = np.zeros(len(method.settings))
        folds = StratifiedKFold(self.inner_folds, shuffle=True, random_state=seed)
        for train, held in folds.split(known, codes):
            answers = self._answers(method, known, codes, train, held)
            right += (answers == codes[held]).sum(axis=1)
        return int(right.argmax())

    def _answers(
        self, method: Method, features: Floats, codes: Codes, train: Codes, test: Codes
    ) -> Codes:
        known, asked = features[train], features[test]
        if self.scaled:
            centre, deviation = known.mean(axis=0), known.std(axis=0)
            # A constant feature keeps rounding of its own size as its deviation.
            constant = deviation <= 1e-12 * np.abs(known).max(axis=0)
            deviation = np.where(constant, 1.0, deviation)
            known, asked = (known - centre) / deviation, (asked - centre) / deviation
        return method.answers(known, codes[train], asked)


def nested_figure(settings: Sequence[Setting], runs: Sequence[list[Half]]) -> Row:
    """Return mean and deviation over runs, %, the setting most chosen and its share."""
    shares = np.array([_pooled(run, [half.chosen for half in run]) for run in runs])
    chosen = np.array([half.chosen for run in runs for half in run])
    counts = np.bincount(chosen, minlength=len(settings))
    most = int(counts.argmax())
    return _figure(shares, settings[most], float(counts[most] / len(chosen)))


def paper_figure(settings: Sequence[Setting], runs: Sequence[list[Half]]) -> Row:
    """Return the setting that is best on these very runs, as the paper does."""
    shares = np.array(
        [[_pooled(run, [s] * len(run)) for s in range(len(settings))] for run in runs]
    )
    best = int(shares.mean(axis=0).argmax())
    return _figure(shares[:, best], settings[best], 1.0)


def _figure(shares: Floats, setting: Setting, chosen_share: float) -> Row:
    per_cent = 100 * shares
    figure = {"ours": float(per_cent.mean()), "sd": spread(per_cent)}
    return {**figure, "chosen": setting, "chosen_share": chosen_share}


def _pooled(run: Sequence[Half], settings: Sequence[int]) -> float:
    """Share right over both halves, each with its own setting."""
    right = sum(
        half.right[s] * half.n_test for half, s in zip(run, settings, strict=True)
    )
    return float(right / sum(half.n_test for half in run))


class _Machines:
    """A classifier with one machine per setting."""

    def machines(self, train: Floats) -> list[Any]:
        """Return the machines, unfitted."""
        raise NotImplementedError

    def answers(self, train: Floats, codes: Codes, test: Floats) -> Codes:
        # One pair of many that stops short of its tolerance is still a machine.
        machines = self.machines(train)
        return np.stack([fitted(m, train, codes).predict(test) for m in machines])


@dataclass(frozen=True)
class Neighbours(_Machines):
    """The k nearest neighbours, k = 3 as in the paper."""

    k: int = 3

    @property
    def settings(self) -> Sequence[Setting]:
        return [{"k": self.k}]

    def machines(self, train: Floats) -> list[Any]:
        return [KNeighborsClassifier(self.k, algorithm="brute")]


@dataclass(frozen=True)
class GaussianSVM(_Machines):
    """One-against-one SVMs with a Gaussian kernel (scikit-learn's `SVC`)."""

    widths: Sequence[float]
    costs: Sequence[float]

    @property
    def settings(self) -> Sequence[Setting]:
        return [{"width": width, "C": C} for C in self.costs for width in self.widths]

    def machines(self, train: Floats) -> list[Any]:
        unit = median_distance(train)
        grid = [(one["C"], 0.5 / (one["width"] * unit) ** 2) for one in self.settings]
        return [SVC(C=C, gamma=gamma) for C, gamma in grid]


@dataclass(frozen=True)
class MKL(_Machines):
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
class Fused:
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
        found = []
        for width in self.widths:
            fusion = KernelPCA(
                max(self.components), sigma=width * unit, scaling=self.scaling
            ).fit(train)
            old, new = fusion.transform(train), fusion.transform(test)
            # Fewer components are the first columns of the most.
            for kept in self.components:
                found.append(
                    self.classifier.answers(old[:, :kept], codes, new[:, :kept])
                )
        return np.concatenate(found)


def median_distance(touches: Floats) -> float:
    """Return the median distance of touches that differ; 1 when none do."""
    distance = pdist(touches)
    apart = distance[distance > 0]
    return float(np.median(apart)) if len(apart) else 1.0
