"""How little an episode looks like any known object.

Three things tell: the posterior is spread over objects (doubt), the touches give the
best object less than its own touches do (misfit), and the encoding, made for what was
learnt, leaves much of them unexplained (novelty). An object never learnt may end in a
sharp posterior, but hardly with touches that fit as those of the object itself.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logsumexp, ndtri

from .._types import Array, Floats
from ._evidence import SequenceCalibration, doubts, is_informative, log_posteriors

# Touches after which someone who asks after every one has stopped asking.
MOST_ASKED = 20
REFUSED = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
# Doubt counts between odds of exp(-20) and exp(20): beyond, the floor decides it.
_MOST_DOUBT = 20.0
_LEAST_SPREAD = 0.02
# Known episodes of clean touches are so alike that any other would stand out: the
# doubt (nats), misfit (standard errors) and novelty (of the variance of all touches)
# count for no less than these deviations.
_LEAST_DEVIATION = np.array([1.0, 0.5, 0.02])
# Scores are 0.5 where one known episode in twenty would lie, were they normal. Above
# the score of one in five, 0.17, nothing is named.
_ONE_IN_TWENTY = 1.645
# Most unknown objects resemble known ones. Touches as new as those of one known episode
# in twenty are no sign yet; what is beyond is a sign of its own.
_NO_SIGN = _ONE_IN_TWENTY
_ONE_IN_FIVE = 0.2
# Strictest share that a limit is extrapolated to, and the laxest: 0.5 is no score to
# refuse below.
_RAREST, _OFTEN = 1e-3, 0.05
_LEAST_NAMING_LIMIT = 0.17


@dataclass(frozen=True)
class UnknownScale:
    """What known episodes look like, learnt from left-out training touches.

    Attributes
    ----------
    usual, spread : ndarray of shape (n_objects,)
        Mean and standard deviation of the probability that one touch of an object,
        left out of training, gives that object.
    lengths : ndarray of shape (n_lengths,)
        Numbers of touches of the episodes that were simulated.
    mean, deviation : ndarray of shape (n_lengths, 3)
        Of doubt, misfit and novelty, over known episodes of each length.
    together : ndarray of shape (n_lengths,)
        Standard deviation of the sum of doubt and misfit, each standardised.
    limits : ndarray of shape (n_lengths, len(REFUSED))
        Scores that a share of known episodes exceeds.
    levels : ndarray of shape (len(REFUSED),)
        For each share of episodes to refuse in all, the share to refuse after each
        touch; see `refusal_levels`.
    """

    usual: Floats
    spread: Floats
    lengths: Floats
    mean: Floats
    deviation: Floats
    together: Floats
    limits: Floats
    levels: Floats

    def scores(
        self, log_posterior: Floats, floored: Floats, novelty: Floats | None = None
    ) -> Floats:
        """Return how unknown the object seems after each touch of an episode.

        Of `log_posterior` after each touch and `floored` likelihoods (..., n_touches,
        n_objects), and `novelty` (..., n_touches), NaN where not told. Between 0 and 1,
        higher is less known; about 0.04 for a middling known episode and 0.5 for one in
        twenty. 0 before any touch said something.
        """
        used = is_informative(floored)
        given = np.where(used[..., np.newaxis], np.exp(floored), 0.0).cumsum(axis=-2)
        new = None if novelty is None else _mean_novelty(novelty, used)
        return self.score(
            log_posterior, np.cumsum(used, axis=-1, dtype=np.intp), given, new
        )

    def score(
        self,
        log_posterior: Floats,
        count: NDArray[np.intp],
        given: Floats,
        novelty: Floats | None,
    ) -> Floats:
        """Return `scores` from sums over the touches so far that said anything.

        Of the belief (..., n_objects), the number of those touches (...,), the sum of
        the probabilities that they give each object (..., n_objects), and the mean of
        what they leave unexplained (...,), NaN where none told it.
        """
        doubt = _doubt(log_posterior)
        misfit = _misfit(log_posterior, count, given, self.usual, self.spread)
        fit = self._standard(doubt, count, 0) + self._standard(misfit, count, 1)
        unlike = fit / np.interp(count, self.lengths, self.together)
        if novelty is not None:
            new = self._standard(novelty, count, 2) - _NO_SIGN
            unlike = np.fmax(unlike, new)
        return np.where(count > 0, expit(2 * (unlike - _ONE_IN_TWENTY)), 0.0)

    def _standard(self, values: Floats, count: NDArray[np.intp], column: int) -> Floats:
        mean = np.interp(count, self.lengths, self.mean[:, column])
        deviation = np.interp(count, self.lengths, self.deviation[:, column])
        standard: Floats = (values - mean) / deviation
        return standard

    def threshold(self, n_touches: int, refused: float) -> float:
        """Return the score that a share `refused` of known episodes exceeds."""
        at_lengths = [np.interp(refused, REFUSED, row) for row in self.limits]
        return float(np.interp(n_touches, self.lengths, at_lengths))

    def refusal_threshold(self, n_touches: int, error: float) -> float:
        """Return the score above which "unknown" is said, asked after every touch."""
        level = float(np.interp(error, REFUSED, self.levels))
        return max(self.threshold(n_touches, level), _normal_score(level))

    def naming_threshold(self, n_touches: int) -> float:
        """Return the score above which no object is named: one known episode in five.

        The posterior over known objects soon becomes sharp for any object; these
        wait for another touch or two.
        """
        return float(np.interp(n_touches, self.lengths, _naming_limits(self.limits)))


def fit_unknown_scale(
    floored: Floats,
    novelty: Floats,
    codes: Array,
    episodes: Mapping[int, Array],
    log_prior: Floats,
    calibration: SequenceCalibration,
) -> UnknownScale:
    """Learn what known episodes look like.

    Of left-out likelihoods (n_touches, n_objects) and novelty (n_touches,), the column
    of each touch's own object (n_touches,), and rows of touches per length,
    (n_episodes, length).
    """
    usual, spread = _own_touches(floored, codes)
    beliefs = {
        k: log_posteriors(floored[rows], log_prior, calibration)
        for k, rows in episodes.items()
    }
    means, deviations, together = [], [], []
    for k, rows in episodes.items():
        used = is_informative(floored[rows])
        given = np.where(used[..., np.newaxis], np.exp(floored[rows]), 0.0)
        count = np.cumsum(used, axis=-1, dtype=np.intp)
        given = np.cumsum(given, axis=-2)
        signs = [
            _doubt(beliefs[k]),
            _misfit(beliefs[k], count, given, usual, spread),
            _mean_novelty(novelty[rows], used),
        ]
        ends = np.stack([sign[:, -1] for sign in signs], axis=1)
        # Episodes of which no touch said anything have no novelty.
        ends = np.where(np.isnan(ends), np.nanmean([0, *ends[:, -1]]), ends)
        means.append(ends.mean(axis=0))
        deviations.append(np.maximum(ends.std(axis=0), _LEAST_DEVIATION))
        standard = (ends - means[-1]) / deviations[-1]
        together.append(max(float(standard[:, :2].sum(axis=1).std()), 1.0))
    lengths = np.array(list(episodes), dtype=float)
    learnt = (usual, spread, lengths, np.array(means), np.array(deviations))
    bare = UnknownScale(*learnt, np.array(together), np.empty(0), np.empty(0))
    scores = {
        k: bare.scores(beliefs[k], floored[rows], novelty[rows])
        for k, rows in episodes.items()
    }
    shares = 1 - np.array(REFUSED)
    limits = np.array([np.quantile(s[:, -1], shares) for s in scores.values()])
    longest = max(k for k in episodes if k <= MOST_ASKED)
    levels = refusal_levels(scores[longest], doubts(beliefs[longest]), lengths, limits)
    return UnknownScale(*learnt, np.array(together), limits, levels)


def refusal_levels(
    scores: Floats, doubt: Floats, lengths: Floats, limits: Floats
) -> Floats:
    """Return how strict to be after each touch, to refuse so many episodes in all.

    Who asks after every touch refuses a known object if ever its score exceeds a limit
    before it is named, which happens more often than after one touch. Of scores and
    doubts of known episodes (n_episodes, n_touches): for each share in `REFUSED` the
    greatest share to refuse at each length.
    """
    touches = np.arange(1, scores.shape[1] + 1)
    fits = scores <= np.interp(touches, lengths, _naming_limits(limits))
    chosen = []
    for share in REFUSED:
        level = 0.0
        for candidate in np.geomspace(1e-3, 0.5, 28):
            row = [np.interp(candidate, REFUSED, at_length) for at_length in limits]
            seen = np.interp(touches, lengths, row)
            limit = np.maximum(seen, _normal_score(candidate))
            refused = scores > limit
            ended = refused | (fits & (doubt <= share))
            first = ended.argmax(axis=1)
            ever = refused[np.arange(len(scores)), first]
            if ever.mean() > share:
                break
            level = float(candidate)
        chosen.append(level)
    return np.array(chosen)


def _normal_score(share: float) -> float:
    """Score that a share of known episodes would exceed, were they normal.

    A limit is never lower: few training touches have not shown the rare ones yet.
    """
    rare = min(max(share, _RAREST), _OFTEN)
    return float(expit(2 * (-ndtri(rare) - _ONE_IN_TWENTY)))


def _naming_limits(limits: Floats) -> Floats:
    """Return for each length the score above which no object is named."""
    one_in_five = limits[:, REFUSED.index(_ONE_IN_FIVE)]
    return np.maximum(one_in_five, _LEAST_NAMING_LIMIT)


def _own_touches(floored: Floats, codes: Array) -> tuple[Floats, Floats]:
    """Mean and spread, per object, of the probability that its own touches give it."""
    used = is_informative(floored)
    own = np.exp(floored[np.arange(len(codes)), codes])
    usual, spread = np.empty(floored.shape[1]), np.empty(floored.shape[1])
    for code in range(floored.shape[1]):
        mine = own[(codes == code) & used]
        mine = mine if len(mine) else own[codes == code]
        usual[code], spread[code] = mine.mean(), mine.std() + _LEAST_SPREAD
    return usual, spread


def _doubt(log_posterior: Floats) -> Floats:
    """Log odds against the best object, shape (...,)."""
    ranked = np.sort(log_posterior, axis=-1)
    odds = logsumexp(ranked[..., :-1], axis=-1) - ranked[..., -1]
    return np.clip(odds, -_MOST_DOUBT, _MOST_DOUBT)


def _misfit(
    log_posterior: Floats,
    count: NDArray[np.intp],
    given: Floats,
    usual: Floats,
    spread: Floats,
) -> Floats:
    """How far the touches fall short of those of the best object, shape (...,).

    In standard errors of a mean of independent touches; see `UnknownScale.score`.
    """
    best = log_posterior.argmax(axis=-1)
    own = np.take_along_axis(given, best[..., np.newaxis], axis=-1)[..., 0]
    n = np.maximum(count, 1)
    misfit: Floats = (usual[best] - own / n) / spread[best] * np.sqrt(n)
    return misfit


def _mean_novelty(novelty: Floats, used: NDArray[np.bool_]) -> Floats:
    """Mean over the touches so far that said anything and told it; NaN for none."""
    tells = used & ~np.isnan(novelty)
    count = np.cumsum(tells, axis=-1)
    total = np.cumsum(np.where(tells, novelty, 0.0), axis=-1)
    mean: Floats = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return mean
