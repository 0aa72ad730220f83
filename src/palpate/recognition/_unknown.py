"""How little an episode looks like any known object, and what may be decided.

Encodings that fail in different ways tell a thing that was never learnt by not
agreeing on its name, however sure the belief is in the end. One score says how little
they agree. Below one limit an object may be named, above another it is called unknown,
and between them more touches are needed.

Both limits are learnt from two kinds of episodes: training touches left out with their
block or session, and the same touches as if their object had never been learnt. A
known object may behave like the second kind tomorrow: of n that were seen not to, one
in n + 2 is expected to (Laplace's rule of succession). What must hold for the mixture
of both is therefore stricter with few objects than with many.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_softmax, logsumexp
from scipy.stats import beta

from .._types import Array, Floats
from ._evidence import SequenceCalibration, doubts, is_informative, with_floor

# Shares of wrong decisions for which limits are learnt.
LEVELS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
# Touches after which someone who asks after every one has stopped asking.
MOST_ASKED = 20
CONFIDENCE = 0.95
# At most so many of what was never learnt are named, whatever the error; and blocks of
# one recording are more alike than another visit is: their scores count twice.
_NEVER_NAMED = 0.15
_CAUTION = 2.0
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
    naming: Floats
    naming_category: Floats
    refusing: Floats
    wrong: Floats
    quantiles: Floats
    n_units: int
    population: str

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


def unknown_score(said: Floats, weights: Floats) -> Floats:
    """Return how little encodings agree on any name, between 0 and 1, shape (...,).

    Of the log posteriors of their beliefs (..., n_encodings, n_objects): 1 less the
    largest weighted geometric mean of what they give to one object.
    """
    score: Floats = -np.expm1((weights @ said).max(axis=-1))
    return np.clip(score, 0.0, 1.0)


def episode_scores(
    floored: Floats,
    each: Floats,
    log_prior: Floats,
    calibration: SequenceCalibration,
    weights: Floats,
) -> Floats:
    """Return the unknown score after each touch of episodes, (..., n_touches).

    Of floored log-likelihoods (..., n_touches, n_objects) and those of each encoding
    (..., n_touches, n_encodings, n_objects). 0 before any touch said something.
    """
    used = is_informative(floored)
    said, count = _beliefs(used, each, log_prior, calibration)
    return np.where(count > 0, unknown_score(said, weights), 0.0)


@dataclass(frozen=True)
class LeftOut:
    """What is said of training touches that were left out, and how it adds up.

    Log-likelihoods (n_touches, n_objects) and those of `each` encoding (n_touches,
    n_encodings, n_objects), without floor; `codes` (n_touches,), the column of each
    touch's own object; and as in `Judge` the `log_prior`, `floor`, `calibration` and
    `categories`.
    """

    log_likelihood: Floats
    each: Floats
    codes: Array
    log_prior: Floats
    floor: float
    calibration: SequenceCalibration
    weights: Floats
    categories: NDArray[np.str_]


def fit_limits(
    left_out: LeftOut, episodes: list[NDArray[np.intp]], n_units: int, population: str
) -> DecisionLimits:
    """Learn what may be decided.

    Of touches left out, and for each object the touches of its episodes (n_episodes,
    n_touches), -1 where one is over; `n_units` stand for a `population`.
    """
    n_objects = len(left_out.log_prior)
    # Of two objects nothing shows what a third would look like.
    missed = 1 / (n_units + 2) if n_objects > 2 else 0.0
    groups = category_codes(left_out.categories)
    known = _Tracks.together(_tracks(left_out, rows, groups) for rows in episodes)
    never = None
    if missed:
        never = _Tracks.together(
            _tracks(left_out, rows, groups, never=True) for rows in episodes
        )
    naming, wrong = _naming(known, never, missed)
    refusing, quantiles = np.ones(len(LEVELS)), known.scores
    shares = np.full(len(known.scores), 1 / len(known.scores))
    if never is not None:
        quantiles = np.concatenate([known.scores, never.scores])
        shares = np.concatenate([(1 - missed) * shares, missed * shares])
        refusing = _exceeded(quantiles.max(axis=1), shares, _CAUTION)
    naming_category = np.zeros(len(LEVELS))
    if groups is not None:
        of_categories = None if never is None else never.category
        naming_category, _ = _naming(known.category, of_categories, missed)
    return DecisionLimits(
        left_out.weights,
        naming,
        naming_category,
        refusing,
        wrong,
        np.stack([_exceeded(column, shares) for column in quantiles.T]),
        n_units,
        population,
    )


@dataclass
class _Tracks:
    """Scores and doubts after each touch of episodes, and whether the best is right.

    All of shape (n_episodes, n_touches); `category` is the same of categories.
    """

    scores: Floats
    doubt: Floats
    right: NDArray[np.bool_]
    category: Any = None

    @classmethod
    def together(cls, parts: Iterable[_Tracks]) -> _Tracks:
        """Return the tracks of all objects as one."""
        every = list(parts)
        told = every[0].category is not None
        return cls(
            np.concatenate([part.scores for part in every]),
            np.concatenate([part.doubt for part in every]),
            np.concatenate([part.right for part in every]),
            cls.together(part.category for part in every) if told else None,
        )


def _tracks(
    left_out: LeftOut,
    rows: NDArray[np.intp],
    groups: NDArray[np.intp] | None,
    *,
    never: bool = False,
) -> _Tracks:
    """Return what one object's episodes come to, perhaps as if it were not learnt."""
    over, own = rows < 0, int(left_out.codes[rows[0, 0]])
    columns = np.arange(len(left_out.log_prior))
    if never:
        columns = columns[columns != own]
    mine, local = np.unique(rows, return_inverse=True)
    floored = with_floor(left_out.log_likelihood[mine][:, columns], left_out.floor)
    each = with_floor(left_out.each[mine][:, :, columns], left_out.floor)
    local = local.reshape(rows.shape)
    used = is_informative(floored)[local] & ~over
    prior = log_softmax(left_out.log_prior[columns])
    belief, _ = _beliefs(used, floored[local], prior, left_out.calibration)
    said, _ = _beliefs(used, each[local], prior, left_out.calibration)
    result = _ended(belief, said, left_out.weights, columns, own)
    if groups is not None:
        present, names = np.unique(groups[columns]), groups[columns]
        belief, said = (
            summed_by_category(one, names, present) for one in (belief, said)
        )
        args = (left_out.weights, present, int(groups[own]))
        result.category = _ended(belief, said, *args)
    return result


def _ended(
    belief: Floats, said: Floats, weights: Floats, names: Array, own: int
) -> _Tracks:
    right = names[belief.argmax(axis=-1)] == own
    return _Tracks(unknown_score(said, weights), doubts(belief), right)


def _beliefs(
    used: NDArray[np.bool_],
    floored: Floats,
    log_prior: Floats,
    calibration: SequenceCalibration,
) -> tuple[Floats, NDArray[np.intp]]:
    """Return log posteriors after each touch, and the number of those that are `used`.

    `used` (..., n_touches); `floored` has objects last, perhaps encodings before.
    """
    inner = floored.ndim - used.ndim
    wide = used.reshape(used.shape + (1,) * inner)
    total = np.where(wide, floored, 0.0).cumsum(axis=used.ndim - 1)
    count = used.cumsum(axis=-1)
    weight = calibration.weight(count).reshape(wide.shape)
    return log_softmax(total * weight + log_prior, axis=-1), count


def _naming(
    known: _Tracks, never: _Tracks | None, missed: float
) -> tuple[Floats, Floats]:
    """Return for each of `LEVELS` the greatest limit that keeps to it, and the wrong.

    A name to which the encodings together give 1 - error is always allowed: what would
    be taken for its twin could else never be named. The wrong are a share of known
    episodes.
    """
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
                limit = max(level, float(candidate))
                break
        limits.append(limit)
        shares.append(_share_wrong(known, limit, level))
    return np.array(limits), np.array(shares)


def _share_wrong(tracks: _Tracks, limit: float, error: float) -> float:
    """Return the share of episodes that are named, and wrongly."""
    named = (tracks.scores <= limit) & (tracks.doubt <= error)
    first = named.argmax(axis=1)
    episode = np.arange(len(first))
    return float((named[episode, first] & ~tracks.right[episode, first]).mean())


def _exceeded(values: Floats, shares: Floats, caution: float = 1.0) -> Floats:
    """Return for each of `LEVELS` what that share of values exceeds at most.

    Each value counts `caution` times.
    """
    order = np.argsort(-values, kind="stable")
    above = caution * np.cumsum(shares[order])
    places = np.searchsorted(above, LEVELS, side="right")
    return values[order][np.minimum(places, len(values) - 1)]


def _at(level: float, values: Floats) -> float:
    """Return a limit for a level between those that were learnt."""
    return float(np.interp(np.log(level), np.log(LEVELS), values))


def category_codes(categories: NDArray[np.str_]) -> NDArray[np.intp] | None:
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
    """Return log posteriors of the categories with some codes, (..., n_categories)."""
    parts = [log_posterior[..., codes == code] for code in present]
    return np.stack([logsumexp(part, axis=-1) for part in parts], axis=-1)
