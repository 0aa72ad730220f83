"""The classifiers that Liu et al. compare, each over its whole grid of settings.

A method is fitted on training touches and answers for the others with one row of
labels per setting; it is never given the labels of what it answers for. Labels are
whole numbers. Kernel widths are in median distances of the training touches, so
that one grid serves z-scored and raw features.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import pdist
from sklearn.exceptions import ConvergenceWarning
from sklearn.neighbors import KNeighborsClassifier
from sklearn.svm import SVC

from ..classifiers import MKLSVC
from ..encodings import KernelPCA
from ._twofold import Codes, Floats, Method, Setting


@dataclass(frozen=True)
class Neighbours:
    """The k nearest neighbours, k = 3 as in the paper."""

    k: int = 3

    @property
    def settings(self) -> Sequence[Setting]:
        return [{"k": self.k}]

    def answers(self, train: Floats, codes: Codes, test: Floats) -> Codes:
        model = KNeighborsClassifier(self.k, algorithm="brute").fit(train, codes)
        return model.predict(test)[np.newaxis]


@dataclass(frozen=True)
class GaussianSVM:
    """One-against-one SVMs with a Gaussian kernel (scikit-learn's `SVC`)."""

    widths: Sequence[float]
    costs: Sequence[float]

    @property
    def settings(self) -> Sequence[Setting]:
        return [{"width": width, "C": C} for C in self.costs for width in self.widths]

    def answers(self, train: Floats, codes: Codes, test: Floats) -> Codes:
        unit = median_distance(train)
        return np.stack(
            [
                SVC(C=one["C"], gamma=0.5 / (one["width"] * unit) ** 2)
                .fit(train, codes)
                .predict(test)
                for one in self.settings
            ]
        )


@dataclass(frozen=True)
class MKL:
    """The MKL-SVM over the paper's 22 kernels."""

    costs: Sequence[float]

    @property
    def settings(self) -> Sequence[Setting]:
        return [{"C": C} for C in self.costs]

    def answers(self, train: Floats, codes: Codes, test: Floats) -> Codes:
        machines = [MKLSVC(C=C, probability=False) for C in self.costs]
        with warnings.catch_warnings():
            # One pair of many that stops short of a gap of 1e-6 is still a machine.
            warnings.simplefilter("ignore", ConvergenceWarning)
            return np.stack([m.fit(train, codes).predict(test) for m in machines])


@dataclass(frozen=True)
class Fused:
    """Kernel PCA before a classifier.

    The widths are fitted with as many components as the largest setting; fewer are
    its first columns. `scaling` is that of `KernelPCA`.
    """

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
