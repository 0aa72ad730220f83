"""How probable it is that a thing was never learnt.

A belief over the learnt objects says which of them it is, if it is one of them. What
is missing is the probability of a stranger, something that was never learnt. Two signs
tell one, both learnt from training touches left out, in episodes of known objects and
in the same episodes as if their object had never been learnt:

- how **low** the score of disagreement gets, together with the doubt: a known object
  soon gets there, a stranger seldom;
- how **high** the score still is after so many touches: a stranger stays there.

Of each sign one curve is kept: how much oftener strangers ever reach a level than known
objects do, as a logarithm. It is learnt as it is used: someone who stops at a level
meets those that ever reach it, and a stranger has as many chances as touches. The odds
of a stranger are the share of strangers that the user expects, times both ratios.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log1p
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_expit

from .._numbers import exp, log, units_needed, upper_bound
from .._types import Array, Bools, Floats, Indices
from ._evidence import (
    SequenceCalibration,
    beliefs_after,
    doubts,
    is_informative,
    summed_up,
)
from ._sentences import Promise

# Of a smaller logarithm the probability would be 0; below the least score, logarithms
# are rounding.
LEAST_LOG, LEAST_SCORE = -700.0, 1e-9
# One known episode in twenty is so many standard deviations farther than usual, were
# they normal: no sign yet.
ONE_IN_TWENTY = 1.645
# Nats for each standard deviation by which scores differ where the curves are flat, so
# that any two episodes can be ranked.
_RANKING = 1e-3


@dataclass(frozen=True)
class Curve:
    """How much oftener strangers ever reach a level than known objects (nats).

    Attributes
    ----------
    levels : ndarray of shape (n_levels,)
        Rising levels.
    log_ratios : ndarray of shape (n_names, n_levels)
        The logarithm of the ratio of shares at each, for each name that is best there;
        one row for all names alike.
    """

    levels: Floats
    log_ratios: Floats

    def at(self, level: Floats, best: Indices | int = 0) -> Floats:
        """Return the log ratio (nats) between the levels, (...,), where a name is best.

        Of levels (...,) and the rows of `log_ratios` (...,).
        """
        place = np.interp(level, self.levels, np.arange(len(self.levels)))
        below = np.asarray(place, dtype=np.intp)
        above = np.minimum(below + 1, len(self.levels) - 1)
        rows = np.minimum(best, len(self.log_ratios) - 1)
        share, ratios = place - below, self.log_ratios
        return (1 - share) * ratios[rows, below] + share * ratios[rows, above]


# Nothing tells a stranger: both kinds reach every level alike.
FLAT = Curve(np.zeros(1), np.zeros((1, 1)))


@dataclass(frozen=True)
class StrangerModel:
    """What tells a stranger, learnt from training touches left out.

    Attributes
    ----------
    weights : ndarray of shape (n_encodings,)
        Share of each encoding in the score; they sum to 1.
    usual : ndarray of shape (n_objects,)
        Mean log distance from a touch of an object, left out, to its nearest other.
    far, high : ndarray of shape (n_lengths, 2)
        Mean and standard deviation, over known episodes after 1, 2, 3... touches, of
        how much farther their touches are, and of the logarithm of their score in nats.
    low_curve, low_category_curve : Curve
        Of the logarithm of the larger of score and doubt, of objects or categories.
    high_curve : Curve
        Of how many standard deviations the score is above that of known episodes.
    exceeded : ndarray of shape (n_lengths,)
        Evidence for a stranger (nats) that one known episode in twenty exceeds after
        1, 2, 3... touches.
    n_units : int
        Objects, or objects in a session, that were left out.
    population : str
        What they stand for.
    """

    weights: Floats
    usual: Floats
    far: Floats
    high: Floats
    low_curve: Curve
    low_category_curve: Curve
    high_curve: Curve
    exceeded: Floats
    n_units: int
    population: str

    def farther(self, each: Floats, log_distances: Floats) -> Floats:
        """Return how much farther than usual touches are, shape (...,).

        From the object on which the encodings agree best; of their log posteriors (...,
        n_encodings, n_objects) and mean log distances (..., n_objects).
        """
        agreed = (self.weights @ each).argmax(axis=-1)
        farther = log_distances - self.usual
        return np.take_along_axis(farther, agreed[..., np.newaxis], axis=-1)[..., 0]

    def score(self, each: Floats, farther: Floats, count: Indices) -> Floats:
        """Return the score of disagreement, between 0 and 1, shape (...,).

        Of the log posteriors that each encoding alone would have (..., n_encodings,
        n_names), how much farther than usual the touches are from the object that is
        agreed on (...,), in logarithms, NaN where not known, and how many said
        something (...,); 0 where none did.
        """
        mean, spread = self.far[np.clip(count, 1, len(self.far)) - 1].T
        beyond = (farther - mean.T) / spread.T - ONE_IN_TWENTY
        nats = np.maximum(-(self.weights @ each).max(axis=-1), 0) + np.fmax(beyond, 0)
        return np.where(count > 0, -np.expm1(-nats), 0.0)

    def evidence(
        self, lowest: Floats, score: Floats, best: Indices, count: Indices
    ) -> Floats:
        """Return the evidence for a stranger (nats), shape (...,); 0 without touches.

        Of the `lowest` level (`log_level`) so far at which the present best object
        was best, the `score` now, the column of that object, and how many touches said
        something, (...,) each.
        """
        mean, spread = self.high[np.clip(count, 1, len(self.high)) - 1].T
        above = (log_nats(score) - mean.T) / spread.T
        nats = self.low_curve.at(lowest, best) + self.high_curve.at(above)
        return np.where(count > 0, nats + _RANKING * above, 0.0)

    def threshold(self, n_touches: int) -> float:
        """Return the evidence (nats) that one known episode in twenty exceeds then."""
        return float(self.exceeded[min(max(n_touches, 1), len(self.exceeded)) - 1])

    def promise(self, error: float) -> Promise:
        """Return what can be shown at an accepted error."""
        n_units, n_needed = self.n_units, units_needed(error)
        bound = upper_bound(0.0, n_units)
        return Promise(error, bound, n_needed, self.population, n_units)


def stranger_log_shares(evidence: Floats, strangers: float) -> tuple[Floats, Floats]:
    """Return the log probabilities of one of the learnt objects, and of a stranger.

    Of the `evidence` for a stranger (nats) and the share of strangers expected.
    """
    if strangers == 0:
        return np.zeros_like(evidence), np.full_like(evidence, -np.inf)
    log_odds = evidence + np.log(strangers) - log1p(-strangers)
    return log_expit(-log_odds), log_expit(log_odds)


def log_level(score: Floats, doubt: Floats) -> Floats:
    """Return the logarithm of the larger of score and doubt."""
    return np.asarray(np.log(np.maximum(np.maximum(score, doubt), LEAST_SCORE)))


def lowest_so_far(levels: Floats, best: Indices, n_names: int) -> Floats:
    """Return the lowest level so far at which the present best name was best.

    Of levels and best names (..., n_touches), of that shape. How low an episode came
    stays true of it, whatever comes later.
    """
    of_each = np.full((*levels.shape[:-1], n_names), np.inf)
    lowest = np.empty_like(levels)
    for touch in range(levels.shape[-1]):
        now = slice(touch, touch + 1)
        name = best[..., now]
        before = np.take_along_axis(of_each, name, axis=-1)
        lowest[..., now] = np.minimum(before, levels[..., now])
        np.put_along_axis(of_each, name, lowest[..., now], axis=-1)
    return lowest


class EpisodeState(NamedTuple):
    """State of an episode after each touch: beliefs, distances, informative touches.

    Log posteriors (..., n_touches, n_objects) and those of each encoding (...,
    n_touches, n_encodings, n_objects); how much farther than usual the touches are, and
    the number of those that were informative (..., n_touches).
    """

    log_posterior: Floats
    by_encoding: Floats
    farther: Floats
    n_informative: Indices


def episode_state(
    used: Bools,
    floored: Floats,
    each: Floats,
    log_distances: Floats,
    log_prior: Floats,
    calibration: SequenceCalibration,
    model: StrangerModel,
) -> EpisodeState:
    """Return what touches come to, those that are `used` (..., n_touches).

    The others as of `episode_evidence`.
    """
    log_posterior, count = beliefs_after(used, floored, log_prior, calibration)
    by_encoding, _ = beliefs_after(used, each, log_prior, calibration)
    wide = used[..., np.newaxis]
    total = summed_up(np.where(wide, log_distances, 0.0), used.ndim - 1)
    mean = total / np.maximum(count, 1)[..., np.newaxis]
    return EpisodeState(
        log_posterior, by_encoding, model.farther(by_encoding, mean), count
    )


class Track(NamedTuple):
    """What episodes come to after each touch, (n_episodes, n_touches) each.

    The `level` (infinite before any touch said something) and the `score`, the column
    of the `best` name and whether it is `right`, and the number of touches that said
    something.
    """

    level: Floats
    score: Floats
    best: Indices
    right: Bools
    n_informative: Indices


def track_of(
    model: StrangerModel, state: EpisodeState, names: Indices, truth: int
) -> Track:
    """Return the track of episodes of `truth` among `names` (n_objects,)."""
    score = model.score(state.by_encoding, state.farther, state.n_informative)
    best = names[state.log_posterior.argmax(axis=-1)]
    level = log_level(score, doubts(state.log_posterior))
    level = np.where(state.n_informative > 0, level, np.inf)
    return Track(level, score, best, best == truth, state.n_informative)


def evidence_of(model: StrangerModel, track: Track, n_names: int) -> Floats:
    lowest = lowest_so_far(track.level, track.best, n_names)
    return model.evidence(lowest, track.score, track.best, track.n_informative)


def episode_evidence(
    floored: Floats,
    each: Floats,
    log_distances: Floats,
    log_prior: Floats,
    calibration: SequenceCalibration,
    model: StrangerModel,
) -> tuple[Floats, Floats]:
    """Return log posteriors and the evidence for a stranger after each touch.

    Shapes (..., n_touches, n_objects) and (..., n_touches), in nats; the posteriors are
    of learnt objects, if it is one of them. Of floored log-likelihoods (..., n_touches,
    n_objects), those of each encoding (..., n_touches, n_encodings, n_objects) and log
    distances, as in `Evidence`.
    """
    tables = floored, each, log_distances
    used = is_informative(floored)
    state = episode_state(used, *tables, log_prior, calibration, model)
    track = track_of(model, state, np.arange(len(log_prior)), truth=-1)
    return state.log_posterior, evidence_of(model, track, len(log_prior))


def category_codes(categories: NDArray[np.str_]) -> Indices | None:
    """Return a number for each object's category, None where none says more.

    Objects of no category have one of their own.
    """
    names = categories[categories != ""]
    if len(np.unique(names)) < 2 or len(np.unique(names)) == len(names):
        return None
    codes = np.unique(categories, return_inverse=True)[1]
    alone = categories == ""
    codes[alone] = codes.max() + 1 + np.arange(alone.sum())
    return np.asarray(codes)


def summed_by_category(log_posterior: Floats, codes: Array, present: Array) -> Floats:
    """Return log posteriors of the categories with some codes, (..., n_categories).

    `present` are all the codes (n_objects,) there are, sorted. A category that rounding
    leaves nothing has the least logarithm.
    """
    shares = exp(np.maximum(log_posterior, LEAST_LOG))
    member = (codes[:, np.newaxis] == present).astype(np.float64)
    # As one matrix: products of many small ones take several times as long.
    summed: Floats = shares.reshape(-1, len(codes)) @ member
    return np.maximum(log(summed.reshape(*shares.shape[:-1], -1)), LEAST_LOG)


def log_nats(score: Floats) -> Floats:
    """Return the logarithm of a score in nats of disagreement."""
    return np.log(-np.log1p(-np.minimum(score, 1 - 1e-15)) + 1e-6)
