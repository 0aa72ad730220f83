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

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import ceil, log1p
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_expit
from scipy.stats import beta, norm
from sklearn.isotonic import isotonic_regression

from .._numbers import exp, log, log_softmax, softmaxes
from .._types import Array, Bools, Floats, Indices
from ._evidence import (
    SequenceCalibration,
    beliefs_after,
    besides_the_best,
    is_informative,
    summed_up,
    sums_after,
    with_floor,
)

# Of a smaller logarithm the probability would be 0.
LEAST_LOG = -700.0
CONFIDENCE = 0.95
# One known episode in twenty is so many standard deviations farther than usual, were
# they normal: no sign yet. Distances spread by a tenth at least.
ONE_IN_TWENTY = 1.645
_LEAST_SPREAD = 0.1
# Levels that a curve is kept at; below the least score, logarithms are rounding.
_N_LEVELS = 129
_LEAST_SCORE = 1e-9
# No height speaks for a stranger by more than 100,000 to one (nats).
_MOST_EVIDENCE = 11.5
# Episodes of strangers that stand for those of which two objects show nothing.
_N_UNSEEN = 1000
# Nats for each standard deviation by which scores differ where the curves are flat, so
# that any two episodes can be ranked.
_RANKING = 1e-3


class Promise(NamedTuple):
    """What so few objects can show about an error.

    Attributes
    ----------
    level : float
        The error that was asked for.
    bound : float
        What could be shown at 95 % confidence if none were wrong: 1 - 0.05^(1/n) for n
        objects or sessions, each counted once (Clopper and Pearson 1934,
        doi:10.1093/biomet/26.4.404).
    n_needed : int
        How many would be needed to show `level`.
    population : str
        What was left out to learn from.
    n_units : int
        How many objects, or objects in a session, that were.
    """

    level: float
    bound: float
    n_needed: int
    population: str
    n_units: int

    def __str__(self) -> str:
        if self.bound <= self.level:
            return (
                f"{self.n_units} objects left out can show an error of {self.level:g}."
            )
        return (
            f"{self.n_units} objects cannot prove an error of {100 * self.level:g} %, "
            f"about {about(self.n_needed)} would."
        )


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
_FLAT = Curve(np.zeros(1), np.zeros((1, 1)))


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
        above = (_log_nats(score) - mean.T) / spread.T
        nats = self.low_curve.at(lowest, best) + self.high_curve.at(above)
        return np.where(count > 0, nats + _RANKING * above, 0.0)

    def category_evidence(self, score: Floats, doubt: Floats) -> Floats:
        """Return the evidence that the best category is wrong (nats), shape (...,)."""
        return self.low_category_curve.at(log_level(score, doubt))

    def threshold(self, n_touches: int) -> float:
        """Return the evidence (nats) that one known episode in twenty exceeds then."""
        return float(self.exceeded[min(max(n_touches, 1), len(self.exceeded)) - 1])

    def promise(self, error: float) -> Promise:
        """Return what can be shown at an accepted error."""
        bound = upper_bound(0.0, self.n_units)
        n_needed = ceil(np.log(1 - CONFIDENCE) / log1p(-error))
        return Promise(error, bound, n_needed, self.population, self.n_units)


def stranger_log_shares(evidence: Floats, strangers: float) -> tuple[Floats, Floats]:
    """Return the log probabilities of one of the learnt objects, and of a stranger.

    Of the `evidence` for a stranger (nats) and the share of strangers expected.
    """
    if strangers == 0:
        return np.zeros_like(evidence), np.full_like(evidence, -np.inf)
    log_odds = evidence + np.log(strangers) - log1p(-strangers)
    return log_expit(-log_odds), log_expit(log_odds)


def about(number: int) -> int:
    """Return a number rounded to two figures, for people."""
    return round(number, 2 - len(str(number)))


def upper_bound(n_wrong: float, n_units: int) -> float:
    """Return the bound at 95 % on a share, of units that were wrong among others."""
    if n_wrong >= n_units:
        return 1.0
    return float(beta.ppf(CONFIDENCE, n_wrong + 1, n_units - n_wrong))


def log_level(score: Floats, doubt: Floats) -> Floats:
    """Return the logarithm of the larger of score and doubt."""
    return np.asarray(np.log(np.maximum(np.maximum(score, doubt), _LEAST_SCORE)))


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
    used = is_informative(floored)
    log_posterior, count = beliefs_after(used, floored, log_prior, calibration)
    by_encoding, _ = beliefs_after(used, each, log_prior, calibration)
    farther = model.farther(by_encoding, _mean_so_far(log_distances, used))
    score = model.score(by_encoding, farther, count)
    best = log_posterior.argmax(axis=-1)
    levels = log_level(score, besides_the_best(exp(log_posterior)))
    # Before any touch said something nothing is low.
    levels = np.where(count > 0, levels, np.inf)
    lowest = lowest_so_far(levels, best, len(log_prior))
    return log_posterior, model.evidence(lowest, score, best, count)


@dataclass(frozen=True)
class LeftOut:
    """What training touches that were left out tell, and how it adds up.

    Log-likelihoods (n_touches, n_objects) and those of `each` encoding (n_touches,
    n_encodings, n_objects), without floor; `log_distances` (n_touches, n_objects) as of
    `Nearest`; `codes` (n_touches,), the column of each touch's own object; and as in
    `Judge` the `log_prior`, `floor`, `calibration` and `categories`.
    """

    log_likelihood: Floats
    each: Floats
    log_distances: Floats
    codes: Array
    log_prior: Floats
    floor: float
    calibration: SequenceCalibration
    weights: Floats
    categories: NDArray[np.str_]


def fit_strangers(
    left_out: LeftOut, episodes: list[Indices], n_units: int, population: str
) -> StrangerModel:
    """Learn what tells a stranger.

    Of touches left out, and for each object the touches of its episodes (n_episodes,
    n_touches), -1 where one is over; `n_units` stand for a `population`.
    """
    groups = category_codes(left_out.categories)
    usual = _usual(left_out)
    far = _far(left_out, usual, episodes)
    one, none = np.ones((1, 2)), np.zeros(len(far))
    rest = _FLAT, _FLAT, _FLAT, none, n_units, population
    model = StrangerModel(left_out.weights, usual, far, one, *rest)
    known = _Tracks.of(left_out, model, episodes, groups, never=False)
    # Two objects do not show what a third looks like: as often as a level says it is
    # taken to get there, and what goes higher than both ever did, for a stranger.
    others, heights = _Tracks.unseen(len(usual)), np.full(_N_UNSEEN, np.inf)
    logs = _log_nats(known.score)
    mean, spread = logs.mean(axis=0), logs.std(axis=0) + _LEAST_SPREAD
    if len(usual) > 2:
        others = _Tracks.of(left_out, model, episodes, groups, never=True)
        heights = ((_log_nats(others.score) - mean) / spread).max(axis=1)
    model = replace(
        model,
        high=np.stack([mean, spread], axis=1),
        low_curve=_low_curve(known, others, len(usual)),
        high_curve=_high_curve(((logs - mean) / spread).max(axis=1), heights),
    )
    if known.category is not None and others.category is not None:
        of_categories = _low_curve(known.category, others.category, 1)
        model = replace(model, low_category_curve=of_categories)
    levels = np.where(known.count > 0, log_level(known.score, known.doubt), np.inf)
    lowest = lowest_so_far(levels, known.best, len(usual))
    nats = model.evidence(lowest, known.score, known.best, known.count)
    return replace(model, exceeded=np.quantile(nats, 0.95, axis=0))


def _low_curve(known: _Tracks, strangers: _Tracks, n_names: int) -> Curve:
    """Return the curves of the least level at which a kind is, or would be, named.

    A row for each of `n_names`: strangers get low as one object and not as another.
    What is counted of one name weighs as much as what is counted of all. A stranger
    counts where its best name is wrong: its category may be right.
    """
    level = log_level(known.score, known.doubt)
    others = log_level(strangers.score, strangers.doubt)
    others = np.where(strangers.right, np.inf, others)
    lows = np.concatenate([level.min(axis=1), others.min(axis=1)])
    levels = _spread(lows[np.isfinite(lows)])
    reached = _named_at(level, known.best, levels, n_names)
    of_others = _named_at(others, strangers.best, levels, n_names)
    ratios = np.log(of_others / reached)
    # Reached by all, a level tells nothing, whatever the name.
    ratios = np.minimum(ratios - ratios[:, -1:], 0.0)
    # Names that were never best have all the same.
    different, rows = np.unique(ratios, axis=0, return_inverse=True)
    curves = np.stack([isotonic_regression(row) for row in different])
    return Curve(levels, curves[rows.reshape(-1)])


def _spread(values: Floats) -> Floats:
    """Return levels that are spread evenly over values."""
    return np.unique(np.quantile(values, np.linspace(0, 1, _N_LEVELS)))


def _named_at(level: Floats, best: Indices, levels: Floats, n_names: int) -> Floats:
    """Return how often a name is best where a level is first reached.

    Shape (n_names, n_levels): times the number of names, so that it is the share of
    all episodes where all names come alike, with that share beside it and half of one
    episode. Of levels and best names (n_episodes, n_touches).
    """
    lowest = np.minimum.accumulate(level, axis=1)
    reached = lowest[:, :, np.newaxis] <= levels
    first = reached.argmax(axis=1)
    names = np.take_along_axis(best, first, axis=1) if n_names > 1 else 0 * first
    counts = np.zeros((n_names, len(levels)))
    np.add.at(
        counts,
        (names, np.broadcast_to(np.arange(len(levels)), names.shape)),
        reached[:, -1],
    )
    share_of_all = counts.sum(axis=0)
    together = n_names * counts + share_of_all + 1
    return np.asarray(together / (2 * len(level) + 1))


def _high_curve(highest: Floats, others: Floats) -> Curve:
    """Return the curve of the greatest height of known episodes and of strangers.

    Beyond what known episodes showed, their share falls as that of a normal variable.
    """
    ends = highest.min(), max(highest.max(), others[np.isfinite(others)].max(initial=0))
    levels = np.linspace(ends[0], ends[1] + 6, _N_LEVELS)
    tail = norm.logsf(levels, highest.mean(), max(highest.std(), _LEAST_SPREAD))
    log_share = np.minimum(_log_share(highest, levels), tail)
    ratios = np.maximum(_log_share(others, levels) - log_share, 0.0)
    # Reached by all, a level tells nothing; the higher, the more it is a stranger.
    ratios = np.minimum(np.maximum.accumulate(ratios), _MOST_EVIDENCE)
    return Curve(levels, ratios[np.newaxis])


def _log_share(heights: Floats, levels: Floats) -> Floats:
    """Return the log share of heights at or above each level, one more at any."""
    n_above = len(heights) - np.searchsorted(np.sort(heights), levels)
    return np.asarray(np.log((n_above + 1) / (len(heights) + 1)))


def _usual(left_out: LeftOut) -> Floats:
    """Return the mean log distance of each object's touches to its nearest other."""
    own = left_out.log_distances[np.arange(len(left_out.codes)), left_out.codes]
    is_known = ~np.isnan(own)
    everywhere = own[is_known].mean() if is_known.any() else 0.0
    n_objects = len(left_out.log_prior)
    counts = np.bincount(left_out.codes[is_known], minlength=n_objects)
    sums = np.bincount(left_out.codes[is_known], own[is_known], minlength=n_objects)
    return np.where(counts > 0, sums / np.maximum(counts, 1), everywhere)


def _far(left_out: LeftOut, usual: Floats, episodes: list[Indices]) -> Floats:
    """Return mean and spread, after each touch, of how far known episodes are."""
    parts = []
    for rows in episodes:
        own = int(left_out.codes[rows[0, 0]])
        farther = left_out.log_distances[rows, own] - usual[own]
        used = (rows >= 0) & ~np.isnan(farther)
        parts.append(_mean_so_far(farther[..., np.newaxis], used)[..., 0])
    together = np.concatenate(parts)
    spread = np.maximum(together.std(axis=0), _LEAST_SPREAD)
    return np.stack([together.mean(axis=0), spread], axis=1)


@dataclass
class _Tracks:
    """What episodes come to after each touch, and whether the best name is right.

    All of shape (n_episodes, n_touches): `score`, `doubt`, column of the `best` name,
    number of touches that said something (`count`) and `right`; `category` is the same
    of categories.
    """

    score: Floats
    doubt: Floats
    best: Indices
    count: Indices
    right: Bools
    category: _Tracks | None = None

    @classmethod
    def of(
        cls,
        left_out: LeftOut,
        model: StrangerModel,
        episodes: list[Indices],
        groups: Indices | None,
        *,
        never: bool,
    ) -> _Tracks:
        """Return the tracks of all objects, perhaps as if `never` learnt."""
        return cls.together(
            _tracks(left_out, model, rows, groups, never=never) for rows in episodes
        )

    @classmethod
    def unseen(cls, n_names: int) -> _Tracks:
        """Return tracks that get as low as each level says, as each name alike."""
        lowest = np.linspace(_LEAST_SCORE, 1, _N_UNSEEN)[:, np.newaxis]
        best = np.arange(_N_UNSEEN)[:, np.newaxis] % n_names
        return cls(lowest, lowest, best, np.ones_like(best), best < 0)

    @classmethod
    def together(cls, tracks: Iterable[_Tracks]) -> _Tracks:
        """Return the tracks of several objects as one."""
        parts = list(tracks)
        names = "score", "doubt", "best", "count", "right"
        columns = [np.concatenate([getattr(p, n) for p in parts]) for n in names]
        of_categories = [p.category for p in parts if p.category is not None]
        category = cls.together(of_categories) if of_categories else None
        score, doubt, best, count, right = columns
        return cls(score, doubt, best, count, right, category)


def _tracks(
    left_out: LeftOut,
    model: StrangerModel,
    rows: Indices,
    groups: Indices | None,
    *,
    never: bool,
) -> _Tracks:
    """Return what one object's episodes come to, perhaps as if it were not learnt."""
    over, own = rows < 0, int(left_out.codes[rows[0, 0]])
    columns = np.arange(len(left_out.log_prior))
    if never:
        columns = columns[columns != own]
    touches, local = np.unique(rows, return_inverse=True)
    # `take` keeps objects next to each other, as sums over them want it.
    tables = left_out.log_likelihood, left_out.each, left_out.log_distances
    pooled, each, distances = (t[touches].take(columns, axis=-1) for t in tables)
    # What they all tell together, then what each encoding tells.
    together = np.concatenate([pooled[:, np.newaxis], each], axis=1)
    floored = with_floor(together, left_out.floor)
    local = local.reshape(rows.shape)
    used = is_informative(floored[:, 0])[local] & ~over
    prior = log_softmax(left_out.log_prior[columns])
    sums, count = sums_after(used, floored[local], prior, left_out.calibration)
    log_posterior, shares, total = softmaxes(sums)
    mean = _mean_so_far(distances[local], used)
    model = replace(model, usual=model.usual[columns])
    farther = model.farther(log_posterior[..., 1:, :], mean)

    def ended(log_posterior: Floats, shares: Floats, names: Array, own: int) -> _Tracks:
        best = names[log_posterior[..., 0, :].argmax(axis=-1)]
        doubt = besides_the_best(shares[..., 0, :] / total[..., 0, :])
        score = model.score(log_posterior[..., 1:, :], farther, count)
        return _Tracks(score, doubt, best, count, best == own)

    result = ended(log_posterior, shares, columns, own)
    if groups is not None:
        present, names = np.unique(groups[columns]), groups[columns]
        shares = _by_category(shares, names, present)
        # A category that rounding leaves nothing has the least logarithm.
        log_posterior = np.maximum(log(shares / total), LEAST_LOG)
        result.category = ended(log_posterior, shares, present, int(groups[own]))
    return result


def _log_nats(score: Floats) -> Floats:
    """Return the logarithm of a score in nats of disagreement."""
    return np.log(-np.log1p(-np.minimum(score, 1 - 1e-15)) + 1e-6)


def _mean_so_far(values: Floats, used: Bools) -> Floats:
    """Return the mean of (..., n_touches, n_objects) over the touches so far in use."""
    wide = used[..., np.newaxis]
    total = summed_up(np.where(wide, values, 0.0), values.ndim - 2)
    return np.asarray(total / np.maximum(wide.cumsum(axis=-2), 1))


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

    `present` are all the codes (n_objects,) there are, sorted.
    """
    shares = exp(np.maximum(log_posterior, LEAST_LOG))
    return log(_by_category(shares, codes, present))


def _by_category(shares: Floats, codes: Array, present: Array) -> Floats:
    member = (codes[:, np.newaxis] == present).astype(np.float64)
    # As one matrix: products of many small ones take several times as long.
    summed: Floats = shares.reshape(-1, len(codes)) @ member
    return summed.reshape(*shares.shape[:-1], len(present))
