"""Encodings and classifiers of the Corradi 2014 study, over numbers of components."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import eigh
from sklearn.neighbors import KNeighborsClassifier
from sklearn.neural_network import MLPClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from ..._types import Floats
from ...classifiers import KernelDensityNaiveBayes, OnePerLabelSVC
from ...encodings import encoder_named
from .._study import fitted
from .._touches import Codes
from ._shapes import Images

PRINCIPAL = {"zernike-pca": "zernike", "oriented-pca": "scaled-pixels"}
# Rows and columns that turned images are averaged to before their components.
PCA_SIDE = 32
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Encoded:
    """Everything about a set of touches that is encoded once for all folds.

    Attributes
    ----------
    known, asked : dict of int to ndarray (n_touches, n_features)
        Features by number of components, as training and as test touches show
        them; where the components are principal ones, the features before these,
        under the number 0.
    principal : bool
        Whether components are learnt from the training touches of each fold.
    """

    known: dict[int, Floats]
    asked: dict[int, Floats]
    principal: bool

    def features(
        self, train: Codes, test: Codes, counts: tuple[int, ...]
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
        counts: tuple[int, ...],
        seed: int,
    ) -> list[float]:
        """Return the per cent that a classifier names, for each of the numbers."""
        found = []
        for old, new in self.features(train, test, counts).values():
            named = answers(kind, old, codes[train], new, seed)
            found.append(float(100 * (named == codes[test]).mean()))
        return found


def encode(
    name: str, known: Images, asked: Images | None, counts: tuple[int, ...]
) -> Encoded:
    """Encode images by the encoding called `name`, for all its component counts.

    `asked` are the same touches as they look when they test, None if no different.
    """
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
    """Return one of the paper's four classifiers, unfitted.

    Distances of 1-NN are between features as they are; the network and the support
    vector machines get features of mean 0 and variance 1; densities per feature do
    not notice their scale. The paper says nothing of scaling.
    """
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
    """Return the first principal directions, (n_features, n_components or fewer).

    From the smaller of covariance and inner products; a direction of no variance
    does not exist.
    """
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
