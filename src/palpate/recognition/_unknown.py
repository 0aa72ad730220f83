"""How little an episode looks like any known object, and what may be decided.

Encodings that fail in different ways tell a thing that was never learnt by not
agreeing on its name, however sure the belief is in the end. One score says how little
they agree, and grows where the touches are farther from all training touches of the
agreed object than its own are. Below one limit an object may be named, above another it
is called unknown, and between them more touches are needed.

Both limits are learnt from two kinds of episodes: training touches left out with their
block or session, and the same touches as if their object had never been learnt. A
known object may behave like the second kind tomorrow: of n that were seen not to, one
in n + 2 is expected to (Laplace's rule of succession). What must hold for the mixture
of both is therefore stricter with few objects than with many.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

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
# Shares of wrong decisions for which limits are learnt.
LEVELS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
# Touches after which someone who asks after every one has stopped asking.
MOST_ASKED = 20
CONFIDENCE = 0.95
# One known episode in twenty is so many standard deviations farther than usual, were
# they normal: no sign yet. Distances spread by a tenth at least.
ONE_IN_TWENTY = 1.645
_LEAST_SPREAD = 0.1
# At most so many of what was never learnt are named, whatever the error.
_NEVER_NAMED = 0.15
_FOUR_IN_FIVE = 0.8
_CANDIDATES = np.geomspace(1, 1e-9, 46)


class Promise(NamedTuple):
    """What is known of how often a named object is wrong.

    Attributes
    ----------
    level : float
        The error that was asked for.
    bound : float
        Upper bound at 95 % confidence on the share of wrong names, for objects or
        sessions like those that were learnt, each counted once (Clopper and Pearson
        1934, doi:10.1093/biomet/26.4.404). From n of them it is at least
        1 - 0.05^(1/n), however well they are recognised.
    population : str
        What was left out to find it.
    n_units : int
        How many objects, or objects in a session, the bound is from.
    """

    level: float
    bound: float
    population: str
    n_units: int


@dataclass(frozen=True)
class DecisionLimits:
    """What decides, learnt from training touches left out.

    Attributes
    ----------
    weights : ndarray of shape (n_encodings,)
        Share of each encoding in the score; they sum to 1.
    usual : ndarray of shape (n_objects,)
        Mean log distance from a touch of an object, left out, to its nearest other.
    far : ndarray of shape (n_lengths, 2)
        Mean and standard deviation, over known episodes after 1, 2, 3... touches, of
        how much farther their touches are.
    naming, naming_category : ndarray of shape (len(LEVELS),)
        Scores up to which an object or a category is named, for each error in `LEVELS`;
        those of categories are 0 where none are known.
    refusing : ndarray of shape (len(LEVELS),)
        Scores above which "unknown" is said.
    wrong : ndarray of shape (len(LEVELS),)
        Share of left-out episodes in which another object is named.
    quantiles : ndarray of shape (n_lengths, len(LEVELS))
        Scores that a share of known episodes exceeds after 1, 2, 3... touches.
    n_units : int
        Objects, or objects in a session, that were left out.
    population : str
        What they stand for.
    """

    weights: Floats
    usual: Floats
    far: Floats
    naming: Floats
    naming_category: Floats
    refusing: Floats
    wrong: Floats
    quantiles: Floats
    n_units: int
    population: str

    def score(self, said: Floats, apart: Floats, count: Indices) -> Floats:
        """Return the unknown score, between 0 and 1, shape (...,).

        Of the log posteriors that each encoding alone would have (..., n_encodings,
        n_names), how much farther than usual the touches are from the object that is
        agreed on (...,), in logarithms, NaN where not known, and how many said
        something (...,); 0 where none did.
        """
        mean, spread = self.far[np.clip(count, 1, len(self.far)) - 1].T
        beyond = (apart - mean.T) / spread.T - ONE_IN_TWENTY
        nats = disagreement(said, self.weights) + np.fmax(beyond, 0)
        return np.where(count > 0, -np.expm1(-nats), 0.0)

    def apart(self, said: Floats, log_distances: Floats) -> Floats:
        """Return how much farther than usual touches are, shape (...,).

        From the object on which the encodings agree best; of their log posteriors (...,
        n_encodings, n_objects) and mean log distances (..., n_objects).
        """
        agreed = (self.weights @ said).argmax(axis=-1)
        farther = log_distances - self.usual
        return np.take_along_axis(farther, agreed[..., np.newaxis], axis=-1)[..., 0]

    def naming_limit(self, error: float, *, category: bool = False) -> float:
        """Return the score up to which an object, or a category, may be named."""
        limits = self.naming_category if category else self.naming
        # Of an error between two that were learnt the stricter limit.
        first = np.searchsorted(LEVELS, error, side="right") - 1
        last = np.searchsorted(LEVELS, error)
        return float(limits[max(int(first), 0) : int(last) + 1].min())

    def refusing_limit(self, refusal: float) -> float:
        """Return the score above which "unknown" is said, asked after every touch."""
        return _at(refusal, self.refusing)

    def threshold(self, n_touches: int, share: float) -> float:
        """Return what a share of known episodes exceeds after some touches."""
        row = self.quantiles[min(max(n_touches, 1), len(self.quantiles)) - 1]
        return _at(share, row)

    def promise(self, error: float) -> Promise:
        """Return what can be said of the share of wrong names at an accepted error."""
        bound = upper_bound(_at(error, self.wrong) * self.n_units, self.n_units)
        return Promise(error, bound, self.population, self.n_units)


def upper_bound(n_wrong: float, n_units: int) -> float:
    """Return the bound at 95 % on a share, of units that were wrong among others."""
    if n_wrong >= n_units:
        return 1.0
    return float(beta.ppf(CONFIDENCE, n_wrong + 1, n_units - n_wrong))


def disagreement(said: Floats, weights: Floats) -> Floats:
    """Return how little encodings agree on any name (nats), shape (...,).

    Of the log posteriors of their beliefs (..., n_encodings, n_objects): the logarithm
    of the largest weighted geometric mean of what they give to one object, negative.
    """
    return np.asarray(np.maximum(-(weights @ said).max(axis=-1), 0.0))


def episode_scores(
    floored: Floats,
    each: Floats,
    log_distances: Floats,
    log_prior: Floats,
    calibration: SequenceCalibration,
    limits: DecisionLimits,
) -> Floats:
    """Return the unknown score after each touch of episodes, (..., n_touches).

    Of floored log-likelihoods (..., n_touches, n_objects), those of each encoding (...,
    n_touches, n_encodings, n_objects) and log distances, as in `Evidence`.
    """
    used = is_informative(floored)
    said, count = beliefs_after(used, each, log_prior, calibration)
    mean = _mean_so_far(log_distances, used)
    return limits.score(said, limits.apart(said, mean), count)


def _mean_so_far(values: Floats, used: Bools) -> Floats:
    """Return the mean of (..., n_touches, n_objects) over the touches so far in use."""
    wide = used[..., np.newaxis]
    total = summed_up(np.where(wide, values, 0.0), values.ndim - 2)
    return np.asarray(total / np.maximum(wide.cumsum(axis=-2), 1))


@dataclass(frozen=True)
class LeftOut:
    """What is said of training touches that were left out, and how it adds up.

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


def fit_limits(
    left_out: LeftOut, episodes: list[Indices], n_units: int, population: str
) -> DecisionLimits:
    """Learn what may be decided.

    Of touches left out, and for each object the touches of its episodes (n_episodes,
    n_touches), -1 where one is over; `n_units` stand for a `population`.
    """
    n_objects = len(left_out.log_prior)
    missed = 1 / (n_units + 2) if n_objects > 2 else 0.0
    groups = category_codes(left_out.categories)
    usual = _usual(left_out)
    ones = np.ones(len(LEVELS))
    scale = DecisionLimits(
        weights=left_out.weights,
        usual=usual,
        far=_far(left_out, usual, episodes),
        naming=ones,
        naming_category=0 * ones,
        refusing=ones,
        wrong=0 * ones,
        quantiles=ones[np.newaxis],
        n_units=n_units,
        population=population,
    )

    def of_all(never: bool) -> _Tracks:
        each = (
            _tracks(left_out, scale, rows, groups, never=never) for rows in episodes
        )
        return _Tracks.together(each)

    known, never = of_all(False), of_all(True) if missed else None
    naming, wrong = _naming(known, never, missed)
    quantiles = known.scores
    # Of two objects nothing shows what a third would look like; what is so far beyond
    # any known episode is none of them.
    refusing = 1 - (1 - known.scores.max()) * np.array(LEVELS) ** 2
    shares = np.full(len(known.scores), 1 / len(known.scores))
    if never is not None:
        quantiles = np.concatenate([known.scores, never.scores])
        shares = np.concatenate([(1 - missed) * shares, missed * shares])
        refusing = _exceeded(quantiles.max(axis=1), shares)
    naming_category = scale.naming_category
    if groups is not None:
        of_categories = None if never is None else never.category
        naming_category, _ = _naming(known.category, of_categories, missed)
    return replace(
        scale,
        naming=naming,
        naming_category=naming_category,
        refusing=refusing,
        wrong=wrong,
        quantiles=np.stack([_exceeded(column, shares) for column in quantiles.T]),
    )


def _usual(left_out: LeftOut) -> Floats:
    """Return the mean log distance of each object's touches to its nearest other."""
    own = left_out.log_distances[np.arange(len(left_out.codes)), left_out.codes]
    told = ~np.isnan(own)
    everywhere = own[told].mean() if told.any() else 0.0
    n_objects = len(left_out.log_prior)
    counts = np.bincount(left_out.codes[told], minlength=n_objects)
    sums = np.bincount(left_out.codes[told], own[told], minlength=n_objects)
    return np.where(counts > 0, sums / np.maximum(counts, 1), everywhere)


def _far(left_out: LeftOut, usual: Floats, episodes: list[Indices]) -> Floats:
    """Return mean and spread, after each touch, of how far known episodes are."""
    farther = []
    for rows in episodes:
        own = int(left_out.codes[rows[0, 0]])
        mine = left_out.log_distances[rows, own] - usual[own]
        used = (rows >= 0) & ~np.isnan(mine)
        farther.append(_mean_so_far(mine[..., np.newaxis], used)[..., 0])
    every = np.concatenate(farther)
    spread = np.maximum(every.std(axis=0), _LEAST_SPREAD)
    return np.stack([every.mean(axis=0), spread], axis=1)


@dataclass
class _Tracks:
    """Scores and doubts after each touch of episodes, and whether the best is right.

    All of shape (n_episodes, n_touches); `category` is the same of categories.
    """

    scores: Floats
    doubt: Floats
    right: Bools
    category: Any = None

    @classmethod
    def together(cls, parts: Iterable[_Tracks]) -> _Tracks:
        """Return the tracks of all objects as one."""
        every = list(parts)
        columns = ([getattr(p, n) for p in every] for n in ("scores", "doubt", "right"))
        told = every[0].category is not None
        category = cls.together(part.category for part in every) if told else None
        scores, doubt, right = map(np.concatenate, columns)
        return cls(scores, doubt, right, category)


def _tracks(
    left_out: LeftOut,
    scale: DecisionLimits,
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
    mine, local = np.unique(rows, return_inverse=True)
    # `take` keeps objects next to each other, as sums over them want it.
    said_of = left_out.log_likelihood, left_out.each, left_out.log_distances
    some, every, apart = (values[mine].take(columns, axis=-1) for values in said_of)
    # What they all say together, then what each encoding says.
    together = np.concatenate([some[:, np.newaxis], every], axis=1)
    floored = with_floor(together, left_out.floor)
    local = local.reshape(rows.shape)
    used = is_informative(floored[:, 0])[local] & ~over
    prior = log_softmax(left_out.log_prior[columns])
    sums, count = sums_after(used, floored[local], prior, left_out.calibration)
    said, shares, total = softmaxes(sums)
    mean = _mean_so_far(apart[local], used)
    apart = replace(scale, usual=scale.usual[columns]).apart(said[..., 1:, :], mean)

    def ended(said: Floats, shares: Floats, names: Array, own: int) -> _Tracks:
        right = names[said[..., 0, :].argmax(axis=-1)] == own
        doubt = besides_the_best(shares[..., 0, :] / total[..., 0, :])
        return _Tracks(scale.score(said[..., 1:, :], apart, count), doubt, right)

    result = ended(said, shares, columns, own)
    if groups is not None:
        present, names = np.unique(groups[columns]), groups[columns]
        shares = _by_category(shares, names, present)
        # A category that rounding leaves nothing has the least logarithm.
        said = np.maximum(log(shares / total), LEAST_LOG)
        result.category = ended(said, shares, present, int(groups[own]))
    return result


def _naming(
    known: _Tracks, never: _Tracks | None, missed: float
) -> tuple[Floats, Floats]:
    """Return for each of `LEVELS` the greatest limit that keeps to it, and the wrong.

    Where no limit keeps strangers out, objects with twins among them, a score up to the
    error suffices: the encodings then give 1 - error to the name. Nor is less asked for
    because left-out touches, nearer to each other than new ones, score next to nothing;
    and what four in five of their episodes come to in the end is always allowed, up to
    the error. The wrong are a share of known episodes.
    """
    reached = float(np.quantile(known.scores[:, -1], _FOUR_IN_FIVE))
    limits, shares = [], []
    for level in LEVELS:
        limit = level
        for candidate in _CANDIDATES:
            if never is None:
                break
            wrong = _share_wrong(known, candidate, level)
            other = _share_wrong(never, candidate, level)
            expected = (1 - missed) * wrong + missed * other
            if expected <= level and other <= _NEVER_NAMED:
                sure = max(level, _when_sure(known, level))
                limit = max(min(level, reached), min(float(candidate), sure))
                break
        limits.append(limit)
        shares.append(_share_wrong(known, limit, level))
    return np.array(limits), np.array(shares)


def _when_sure(tracks: _Tracks, error: float) -> float:
    """Return the score that four in five episodes have when doubt is first so small.

    The fifth waits for another touch or two, as does what was never learnt.
    """
    sure = tracks.doubt <= error
    first = sure.argmax(axis=1)
    episode = np.flatnonzero(sure.any(axis=1))
    if not len(episode):
        return 1.0
    return float(np.quantile(tracks.scores[episode, first[episode]], _FOUR_IN_FIVE))


def _share_wrong(tracks: _Tracks, limit: float, error: float) -> float:
    named = (tracks.scores <= limit) & (tracks.doubt <= error)
    first = named.argmax(axis=1)
    episode = np.arange(len(first))
    return float((named[episode, first] & ~tracks.right[episode, first]).mean())


def _exceeded(values: Floats, shares: Floats) -> Floats:
    """Return for each of `LEVELS` what that share of values exceeds at most."""
    order = np.argsort(-values, kind="stable")
    above = np.cumsum(shares[order])
    places = np.searchsorted(above, LEVELS, side="right")
    return values[order][np.minimum(places, len(values) - 1)]


def _at(level: float, values: Floats) -> float:
    """Return a limit for a level between those that were learnt."""
    return float(np.interp(np.log(level), np.log(LEVELS), values))


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
    mine = (codes[:, np.newaxis] == present).astype(np.float64)
    # As one matrix: products of many small ones take several times as long.
    summed: Floats = shares.reshape(-1, len(codes)) @ mine
    return summed.reshape(*shares.shape[:-1], len(present))
