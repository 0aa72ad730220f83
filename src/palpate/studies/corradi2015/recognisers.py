"""The recognisers that Corradi et al. 2015 compare, from features to beliefs.

Each learns from training touches and answers for episodes: several touches of one
object, one after the other. It is never given the labels of what it answers for.
Labels are whole numbers without gaps. `scores` of episodes (n_episodes, n_touches,
n_features) are (n_episodes, n_touches, n_objects) after each touch: log posteriors
under equal priors, but of the bags of touches, which have none; the largest is the
answer. `features` names those of the study's features that are taken.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import log_softmax
from sklearn.cluster import KMeans
from sklearn.decomposition import PCA
from sklearn.mixture import GaussianMixture

from ..._numbers import with_floor
from ..._types import Array, Floats
from ...classifiers import KernelDensityBayes
from ...evaluation import control_log_likelihood
from .. import Codes, fitted

# Share of the training touches that choose the number of clusters.
_VALIDATION = 1 / 3
# What an eigenvalue of a covariance may be of the largest before it counts as none.
_SINGULAR = 1e-9


@dataclass(frozen=True)
class Densities:
    """The paper's: principal components, a Gaussian about every training touch."""

    floor: float = 0.0
    features: str = "Zernike"

    def scores(self, train: Floats, codes: Codes, episodes: Floats) -> Floats:
        principal = principal_components(train)
        model = KernelDensityBayes().fit(principal.transform(train), codes)
        flat = principal.transform(_flat(episodes))
        return _added_up(model.log_likelihood(flat), episodes, self.floor)


@dataclass(frozen=True)
class _Clustered:
    """Base of recognisers that count touches in the best number of k-means clusters."""

    clusters: Sequence[int]
    seed: int = 0
    features: str = "Zernike"

    def scores(self, train: Floats, codes: Codes, episodes: Floats) -> Floats:
        return self.with_clusters(self.choose(train, codes), train, codes, episodes)

    def with_clusters(
        self, n_clusters: int, train: Floats, codes: Codes, episodes: Floats
    ) -> Floats:
        raise NotImplementedError

    def choose(self, train: Floats, codes: Codes) -> int:
        """Return the number with most right on a third held out, ties smallest."""
        candidates = sorted(self.clusters)
        if len(candidates) == 1:
            return candidates[0]
        rng = np.random.default_rng(self.seed)
        least = int(np.bincount(codes).min() * _VALIDATION)
        of_each = [np.flatnonzero(codes == code) for code in range(codes.max() + 1)]
        held = np.stack([rng.permutation(rows)[:least] for rows in of_each])
        kept = np.setdiff1d(np.arange(len(codes)), held)
        right = []
        for number in candidates:
            scores = self.with_clusters(number, train[kept], codes[kept], train[held])
            named = scores.argmax(axis=-1)
            right.append((named == np.arange(len(held))[:, np.newaxis]).mean())
        return candidates[int(np.argmax(right))]


class ClusterBayes(_Clustered):
    """Naive Bayes over k-means clusters; one is added to every count."""

    def with_clusters(
        self, n_clusters: int, train: Floats, codes: Codes, episodes: Floats
    ) -> Floats:
        principal = principal_components(train)
        words = _words(principal.transform(train), n_clusters, self.seed)
        counts = _histograms(words.labels_, codes, words.n_clusters) + 1.0
        log_shares = np.log(counts / counts.sum(axis=1, keepdims=True))
        met = words.predict(principal.transform(_flat(episodes)))
        return _added_up(log_shares.T[met], episodes, 0.0)


@dataclass(frozen=True)
class Mixtures:
    """A full Gaussian mixture per object, lifted as it often is singular (`facts`)."""

    components: int
    seed: int = 0
    features: str = "Zernike"

    def scores(self, train: Floats, codes: Codes, episodes: Floats) -> Floats:
        principal = principal_components(train)
        values = principal.transform(train)
        lift = 1e-3 * float(values.var(axis=0).mean())
        flat = principal.transform(_flat(episodes))
        log_likelihoods = []
        for code in range(codes.max() + 1):
            mixture = _mixture(values[codes == code], self.components, lift, self.seed)
            log_likelihoods.append(mixture.score_samples(flat))
        return _added_up(np.stack(log_likelihoods, axis=1), episodes, 0.0)

    def facts(self, train: Floats, codes: Codes) -> dict[str, float]:
        """Return numbers of features and parameters, and per cent singular unlifted."""
        values = principal_components(train).transform(train)
        singular = []
        for code in range(codes.max() + 1):
            try:
                model = _mixture(values[codes == code], self.components, 0.0, self.seed)
                spectra = np.linalg.eigvalsh(model.covariances_)
                flat = spectra[:, 0] <= _SINGULAR * spectra[:, -1]
                singular.append(bool(flat.any()))
            except ValueError:
                singular.append(True)
        n = values.shape[1]
        each = n + n * (n + 1) // 2
        return {
            "n_features": n,
            "parameters": self.components * each + self.components - 1,
            "singular": 100 * float(np.mean(singular)),
        }


class BagOfTouches(_Clustered):
    """Nearest histogram over clusters, chi-squared (doi:10.1109/TRO.2011.2125350)."""

    def with_clusters(
        self, n_clusters: int, train: Floats, codes: Codes, episodes: Floats
    ) -> Floats:
        words = _words(train, n_clusters, self.seed)
        counts = _histograms(words.labels_, codes, words.n_clusters)
        shares = counts / counts.sum(axis=1, keepdims=True)
        n_episodes, n_touches, _ = episodes.shape
        met = words.predict(_flat(episodes)).reshape(n_episodes, n_touches)
        seen = np.cumsum(np.eye(words.n_clusters)[met], axis=1)
        seen /= np.arange(1, n_touches + 1)[:, np.newaxis]
        difference = (seen[:, :, np.newaxis] - shares) ** 2
        both = seen[:, :, np.newaxis] + shares
        distance = difference / np.where(both > 0, both, 1.0)
        return np.asarray(-0.5 * distance.sum(axis=-1))


@dataclass(frozen=True)
class Nuisance:
    """A control: values that are not touch, by the classifier of `default`."""

    features: str

    def scores(self, train: Floats, codes: Codes, episodes: Floats) -> Floats:
        log_likelihood = control_log_likelihood(train, codes, None, _flat(episodes))
        return _added_up(log_likelihood, episodes, 0.01)


Recogniser = Densities | ClusterBayes | Mixtures | BagOfTouches | Nuisance


def principal_components(train: Floats) -> PCA:
    """Return the components that keep 95 % of the training touches' variance."""
    return PCA(n_components=0.95, svd_solver="full").fit(train)


def _words(train: Floats, n_clusters: int, seed: int) -> KMeans:
    # Fewer different touches than clusters leave some clusters empty.
    clusters = KMeans(min(n_clusters, len(train)), n_init=1, random_state=seed)
    return fitted(clusters, train)


def _histograms(words: Array, codes: Codes, n_clusters: int) -> Floats:
    """Return how often each object met each cluster, (n_objects, n_clusters)."""
    counts = np.zeros((codes.max() + 1, n_clusters))
    np.add.at(counts, (codes, words), 1)
    return counts


def _mixture(touches: Floats, components: int, lift: float, seed: int) -> Any:
    mixture = GaussianMixture(components, reg_covar=lift, random_state=seed)
    return fitted(mixture, touches)


def _flat(episodes: Floats) -> Floats:
    return episodes.reshape(-1, episodes.shape[-1])


def _added_up(log_likelihood: Floats, episodes: Floats, floor: float) -> Floats:
    """Return log posteriors after each touch, touches taken as independent."""
    each = with_floor(log_likelihood, floor).reshape(*episodes.shape[:2], -1)
    return log_softmax(np.cumsum(each, axis=1), axis=-1)
