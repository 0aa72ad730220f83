"""Touch by touch: how log-likelihoods add up to a belief.

Plain functions on arrays, shared by `Belief` (one touch at a time) and by the
evaluation (thousands of episodes at once), so that both mean the same belief.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_softmax, logsumexp

from .._checks import check_positive

Floats = NDArray[np.float64]
_LEAST_LOG_PRIOR = -27.7
_RULED_OUT = -1e6


class Evidence(NamedTuple):
    """What touches tell, one row a touch.

    `novelty` is how much of a touch the encoding leaves unexplained, NaN where it
    cannot tell.
    """

    features: Floats
    log_likelihood: Floats
    flags: list[str]
    novelty: Floats

    @classmethod
    def together(cls, parts: Sequence["Evidence"]) -> "Evidence":
        """Return what several sets of touches tell, one after the other."""
        return cls(
            np.concatenate([part.features for part in parts]),
            np.concatenate([part.log_likelihood for part in parts]),
            [flag for part in parts for flag in part.flags],
            np.concatenate([part.novelty for part in parts]),
        )

    def one(self, touch: int) -> "Evidence":
        """Return what a single touch tells."""
        row = slice(touch, touch + 1)
        return Evidence(
            self.features[row],
            self.log_likelihood[row],
            self.flags[row],
            self.novelty[row],
        )


@dataclass(frozen=True)
class SequenceCalibration:
    """How much the touches of one episode may be trusted together.

    The log-likelihoods of k touches are summed and multiplied by
    strength / (1 + (k - 1) correlation): touches of one episode resemble each
    other, so k of them are worth fewer independent ones (the design effect of a
    sample of equally correlated readings). The most probable object under equal
    priors is the same for every trust.

    Attributes
    ----------
    strength : float
        Weight of a single touch; 1 takes the likelihood at its word.
    correlation : float
        Between 0 (independent touches) and 1 (all touches are one).
    """

    strength: float = 1.0
    correlation: float = 0.0

    def weight(self, n_touches: Floats | int) -> Floats:
        """Return the factor on the sum of `n_touches` log-likelihoods."""
        others = np.maximum(np.asarray(n_touches) - 1, 0)
        return np.asarray(self.strength / (1 + others * self.correlation))


def given_prior(prior: Mapping[str, float], classes: NDArray) -> Floats:
    """Return log probabilities in the order of `classes`, brought to sum 1."""
    names = [str(name) for name in classes]
    if not isinstance(prior, Mapping):
        raise TypeError(
            f"prior must map objects to probabilities, got {type(prior).__name__}."
        )
    if sorted(map(str, prior)) != sorted(names):
        missing = sorted(set(names) ^ set(map(str, prior)))[0]
        raise ValueError(
            f"prior must name every object and no other, got a difference in "
            f"{missing!r}. The objects are {', '.join(names)}."
        )
    given = {str(name): value for name, value in prior.items()}
    logs = np.log([check_positive("prior", given[name]) for name in names])
    log_prior: Floats = log_softmax(logs)
    if log_prior.min() < _LEAST_LOG_PRIOR:
        least = names[int(log_prior.argmin())]
        raise ValueError(
            f"prior must not all but rule an object out, got {given[least]} for "
            f"{least!r}. Give it at least 1e-12 of the sum, or forget the object."
        )
    return log_prior


def with_floor(log_likelihood: Floats, floor: float) -> Floats:
    """Return log-likelihoods under which no touch rules an object out.

    Each touch's posterior under equal priors is mixed with the uniform one, so
    that no object gets less than floor / n_objects from one touch. Shape
    (..., n_objects), natural logarithms; with `floor=0` only the scale of each
    touch changes.
    """
    log_posterior: Floats = log_softmax(log_likelihood, axis=-1)
    if floor == 0:
        # Finite, so that touches that rule out all objects in turn leave a belief.
        return np.maximum(log_posterior, _RULED_OUT)
    n_objects = log_likelihood.shape[-1]
    mixed: Floats = np.logaddexp(
        np.log1p(-floor) + log_posterior, np.log(floor / n_objects)
    )
    return mixed


def log_posteriors(
    floored: Floats, log_prior: Floats, trust: SequenceCalibration
) -> Floats:
    """Return the log posterior after each touch of an episode.

    Parameters
    ----------
    floored : ndarray of shape (..., n_touches, n_objects)
        Log-likelihoods of the touches in order, from `with_floor`.
    log_prior : ndarray of shape (n_objects,)
        Log prior (nats).
    trust : SequenceCalibration
        How touches add up.

    Returns
    -------
    ndarray of shape (..., n_touches, n_objects)
        Natural logarithms; each row sums to one after `exp`.
    """
    heard = np.where(_is_informative(floored)[..., np.newaxis], floored, 0.0)
    weight = trust.weight(n_informative(floored))[..., np.newaxis]
    total = np.cumsum(heard, axis=-2) * weight + log_prior
    result: Floats = log_softmax(total, axis=-1)
    return result


def n_informative(floored: Floats) -> Floats:
    """Return how many touches said anything so far, shape (..., n_touches).

    A touch without contact has one likelihood for all objects; it leaves the belief
    exactly where it was.
    """
    count: Floats = np.cumsum(_is_informative(floored), axis=-1)
    return count


def _is_informative(floored: Floats) -> NDArray[np.bool_]:
    return np.asarray(floored.max(axis=-1) > floored.min(axis=-1))


def doubts(log_posterior: Floats) -> Floats:
    """Return the probability outside the most probable object, shape (...,).

    Summed over the other objects, so that it stays exact near 0.
    """
    others = np.sort(log_posterior, axis=-1)[..., :-1]
    doubt: Floats = np.exp(logsumexp(others, axis=-1))
    return doubt
