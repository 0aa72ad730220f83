"""What training touches left out tell: how evidence adds up, and what tells a stranger.

Every training touch is recognised by a model that never met its block of the recording
(a session, where there are several). Episodes drawn from those answers show how a sum
of log-likelihoods adds up; a stranger shows in the same episodes as if their object had
never been learnt. What is counted of those is how many of each kind *ever* come to a
level: someone who stops at a level meets those, and a stranger has as many chances as
touches. Nothing here looks at a test touch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import norm
from sklearn.isotonic import isotonic_regression

from .._numbers import evenly_spaced, log_loss, log_softmax, with_floor, without_gaps
from .._types import Array, Floats, Indices
from ..classifiers import EncodingPool, TouchClassifier
from ._evidence import SequenceCalibration, is_informative
from ._memory import rows_of_each
from ._strangers import (
    FLAT,
    LEAST_SCORE,
    Curve,
    EpisodeState,
    StrangerModel,
    Track,
    category_codes,
    episode_state,
    evidence_of,
    log_nats,
    summed_by_category,
    track_of,
)

# Touches of an episode: who asks after every touch has stopped by then.
LONGEST = 20
# The numbers of touches after which it should be as sure as it is right.
LENGTHS = (1, 2, 3, 5, 8, 12, 20)
# Episodes of all objects together, and so many of their answers, one for each object
# that is known.
IN_ALL, ANSWERS = 1000, 2_000_000
_LEAST_CORRELATION = 6e-6
# Deviations are a tenth at least.
_LEAST_SPREAD = 0.1
# Of episodes of more of an object's touches nothing is known of how far they spread.
_MOST_OF_ALL = 2 / 3
# Levels that a curve is kept at.
_N_LEVELS = 129
# No height speaks for a stranger by more than 100,000 to one (nats).
_MOST_EVIDENCE = 11.5
# Episodes of strangers that stand for those of which two objects show nothing.
_N_UNSEEN = 1000


def left_out_log_likelihood(classifier: TouchClassifier) -> Floats:
    """Return log-likelihoods of training touches, each with its group left out.

    Shape (n_touches, n_classes). A label whose touches are all left out at once gets
    the least likelihood that any label got for the touch.
    """
    return without_gaps(classifier.left_out_log_likelihood())


def draw_episodes(
    objects: Array, seed: int, n_known: int = 1, blocks: Indices | None = None
) -> list[Indices]:
    """Draw episodes of each object, (n_episodes, n_touches), -1 after their end.

    As many touches as the object has, up to `LONGEST`, in random order; with `blocks`
    those of one block come first, then those of its neighbours, as in a visit to the
    object. `IN_ALL` episodes of all objects together, fewer where very many are known
    (`n_known`); of very many objects, of some.
    """
    rng, each = np.random.default_rng(seed), rows_of_each(objects)
    in_all = min(IN_ALL, ANSWERS // n_known)
    spread = evenly_spaced(len(each), in_all)
    each = [each[k] for k in spread]
    longest = min(LONGEST, max(map(len, each)))
    drawn = []
    for rows in each:
        place = rng.random((in_all // len(each), len(rows)))
        if blocks is not None:
            block_codes = np.unique(blocks[rows], return_inverse=True)[1]
            n_blocks = block_codes.max() + 1
            begin = rng.integers(n_blocks, size=(len(place), 1))
            place += (block_codes - begin) % n_blocks
        order = rows[np.argsort(place, axis=1)[:, :longest]]
        over = ((0, 0), (0, longest - order.shape[1]))
        drawn.append(np.pad(order, over, constant_values=-1))
    return drawn


def fit_sequence_calibration(
    floored: Floats, codes: Indices, episodes: list[Indices], log_prior: Floats
) -> SequenceCalibration:
    """Return the calibration of least log loss over episodes of all lengths.

    Of log-likelihoods of touches left out, with their floor (n_touches, n_objects),
    and the column of each touch's own label (n_touches,).
    """
    drawn, used = np.concatenate(episodes), is_informative(floored)
    total, count = np.zeros((len(drawn), floored.shape[1])), np.zeros(len(drawn))
    ends = []
    for n_touches, rows in enumerate(drawn.T, start=1):
        there = rows >= 0
        tells = there & used[rows]
        total[tells] += floored[rows[tells]]
        count += tells
        if n_touches in LENGTHS:
            ends.append((total[there], count[there], codes[drawn[there, 0]]))
    totals, counts, truth = (np.concatenate(v) for v in zip(*ends, strict=True))
    # Every length counts the same.
    each = np.array([len(counts) for _, counts, _ in ends])
    share = np.repeat(1 / each / len(each), each)
    return _of_least_loss(totals, counts, truth, share, log_prior)


def _of_least_loss(
    total: Floats, count: Floats, truth: Indices, share: Floats, log_prior: Floats
) -> SequenceCalibration:
    """Return the calibration under which sums of `count` touches tell the truth best.

    `share` (n_episodes,) is that of each in the log loss.
    """
    others = np.maximum(count - 1, 0)

    def loss(raw: Floats) -> tuple[float, Floats]:
        calibration = SequenceCalibration(float(np.exp(raw[0])), float(raw[1]))
        weight = calibration.weight(count)
        logits = total * weight[:, np.newaxis] + log_prior
        value, pull = log_loss(logits, truth, share)
        by_strength = np.einsum("eo,eo->e", pull, total) * weight
        by_correlation = -by_strength * others / (1 + others * raw[1])
        return value, np.array([by_strength.sum(), by_correlation.sum()])

    # Posteriors of single touches are calibrated already, and no strength above 1 may
    # undo their floor: training touches that are all told apart would ask for any.
    bounds = [(np.log(0.05), 0.0), (_LEAST_CORRELATION, 1 - _LEAST_CORRELATION)]
    fit = minimize(
        loss,
        [-0.1, 0.1],
        jac=True,
        bounds=bounds,
        options={"ftol": 1e-13, "gtol": 1e-9},
    )
    return SequenceCalibration(float(np.exp(fit.x[0])), float(fit.x[1]))


@dataclass(frozen=True)
class LeftOut:
    """What training touches that were left out tell, and how it adds up.

    Log-likelihoods (n_touches, n_objects) and those of `each` encoding (n_touches,
    n_encodings, n_objects), without floor; `log_distances` (n_touches, n_objects) as of
    `Nearest`; `codes` (n_touches,), the column of each touch's own object; and as in
    `BeliefModel` the `log_prior`, `floor`, `calibration` and `categories`. Where a
    `pool` corrects the log-likelihoods, they are `uncorrected` before that.
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
    uncorrected: Floats | None = None
    pool: EncodingPool | None = None


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
    no_scale, no_limits = np.ones((1, 2)), np.zeros(len(far))
    flat = FLAT, FLAT, FLAT, no_limits, n_units, population
    model = StrangerModel(left_out.weights, usual, far, no_scale, *flat)
    known_track, known_categories = _tracks(
        left_out, model, episodes, groups, never=False
    )
    # Two objects do not show what a third looks like: as often as a level says it is
    # taken to get there, and what goes higher than both ever did, for a stranger.
    stranger_track, heights = _unseen(len(usual)), np.full(_N_UNSEEN, np.inf)
    stranger_categories = None
    logs = log_nats(known_track.score)
    mean = logs.mean(axis=0)
    spread = _of_new_touches(logs.std(axis=0), left_out.codes) + _LEAST_SPREAD
    if len(usual) > 2:
        stranger_track, stranger_categories = _tracks(
            left_out, model, episodes, groups, never=True
        )
        heights = ((log_nats(stranger_track.score) - mean) / spread).max(axis=1)
    model = replace(
        model,
        high=np.stack([mean, spread], axis=1),
        low_curve=_low_curve(known_track, stranger_track, len(usual)),
        high_curve=_high_curve(((logs - mean) / spread).max(axis=1), heights),
    )
    if known_categories is not None and stranger_categories is not None:
        of_categories = _low_curve(known_categories, stranger_categories, 1)
        model = replace(model, low_category_curve=of_categories)
    nats = evidence_of(model, known_track, len(usual))
    return replace(model, exceeded=np.quantile(nats, 0.95, axis=0))


def _of_new_touches(spread: Floats, codes: Indices) -> Floats:
    """Return how far episodes of new touches would spread, (n_lengths,).

    Left-out episodes repeat no touch: those that hold nearly all of an object's are all
    alike. Longer than `_MOST_OF_ALL` of the touches that a middling object has, they
    are taken to spread as far as there.
    """
    counts = np.bincount(codes)
    longest = max(1, int(_MOST_OF_ALL * np.median(counts[counts > 0])))
    least = np.zeros_like(spread)
    least[longest:] = spread[:longest][-1]
    return np.maximum(spread, least)


def _low_curve(known_track: Track, strangers: Track, n_names: int) -> Curve:
    """Return the curves of the least level at which a kind is, or would be, named.

    A row for each of `n_names`: strangers get low as one object and not as another.
    What is counted of one name weighs as much as what is counted of all. A stranger
    counts where its best name is wrong: its category may be right.
    """
    level = known_track.level
    others = np.where(strangers.right, np.inf, strangers.level)
    lows = np.concatenate([level.min(axis=1), others.min(axis=1)])
    levels = _spread(lows[np.isfinite(lows)])
    reached = _named_at(level, known_track.best, levels, n_names)
    of_others = _named_at(others, strangers.best, levels, n_names)
    ratios = np.log(of_others / reached)
    # Reached by all, a level tells nothing, whatever the name.
    ratios = np.minimum(ratios - ratios[:, -1:], 0.0)
    # Names that were never best have all the same.
    different, rows = np.unique(ratios, axis=0, return_inverse=True)
    curves = np.stack([isotonic_regression(row) for row in different])
    return Curve(levels, curves[rows.reshape(-1)])


def _spread(values: Floats) -> Floats:
    """Return levels that are spread evenly over values; 0 where no touch tells any."""
    values = values if len(values) else np.zeros(1)
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
    np.add.at(counts, (names, np.arange(len(levels))), reached[:, -1])
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
    codes, n_objects = left_out.codes, len(left_out.log_prior)
    own_distances = left_out.log_distances[np.arange(len(codes)), codes]
    is_known = ~np.isnan(own_distances)
    codes, own_distances = codes[is_known], own_distances[is_known]
    everywhere = own_distances.mean() if len(codes) else 0.0
    counts = np.bincount(codes, minlength=n_objects)
    sums = np.bincount(codes, own_distances, minlength=n_objects)
    return np.where(counts > 0, sums / np.maximum(counts, 1), everywhere)


def _far(left_out: LeftOut, usual: Floats, episodes: list[Indices]) -> Floats:
    """Return mean and spread, after each touch, of how far known episodes are."""
    parts = []
    for rows in episodes:
        truth = int(left_out.codes[rows[0, 0]])
        farther = left_out.log_distances[rows, truth] - usual[truth]
        used = (rows >= 0) & ~np.isnan(farther)
        total = np.where(used, farther, 0.0).cumsum(axis=1)
        parts.append(total / np.maximum(used.cumsum(axis=1), 1))
    together = np.concatenate(parts)
    spread = np.maximum(together.std(axis=0), _LEAST_SPREAD)
    return np.stack([together.mean(axis=0), spread], axis=1)


def _tracks(
    left_out: LeftOut,
    model: StrangerModel,
    episodes: list[Indices],
    groups: Indices | None,
    *,
    never: bool,
) -> tuple[Track, Track | None]:
    """Return tracks of objects, and of categories, perhaps as if `never` learnt."""
    objects, categories = [], []
    for rows in episodes:
        truth = int(left_out.codes[rows[0, 0]])
        columns = np.arange(len(left_out.log_prior))
        if never:
            columns = np.delete(columns, truth)
        state = _state_of_episodes(left_out, model, rows, columns)
        objects.append(track_of(model, state, columns, truth))
        if groups is not None:
            present, codes = np.unique(groups[columns]), groups[columns]
            of_categories = state._replace(
                log_posterior=summed_by_category(state.log_posterior, codes, present),
                by_encoding=summed_by_category(state.by_encoding, codes, present),
            )
            categories.append(
                track_of(model, of_categories, present, int(groups[truth]))
            )
    return _joined(objects), _joined(categories) if categories else None


def _state_of_episodes(
    left_out: LeftOut, model: StrangerModel, rows: Indices, columns: Indices
) -> EpisodeState:
    """Return what episodes come to by some of the objects."""
    touches, local = np.unique(rows, return_inverse=True)
    # `take` keeps objects next to each other, as sums over them want it.
    tables = left_out.each, left_out.log_distances
    each, distances = (t[touches].take(columns, axis=-1) for t in tables)
    pooled = _pooled(left_out, touches, columns)
    pooled, each = (with_floor(table, left_out.floor) for table in (pooled, each))
    local = local.reshape(rows.shape)
    used = is_informative(pooled)[local] & (rows >= 0)
    prior = log_softmax(left_out.log_prior[columns])
    present = replace(model, usual=model.usual[columns])
    parts = pooled[local], each[local], distances[local]
    return episode_state(used, *parts, prior, left_out.calibration, present)


def _pooled(left_out: LeftOut, touches: Indices, columns: Indices) -> Floats:
    """Return log-likelihoods of some of the objects, as if others were never learnt."""
    pool, uncorrected = left_out.pool, left_out.uncorrected
    is_whole = len(columns) == len(left_out.log_prior)
    if pool is None or uncorrected is None or is_whole:
        return left_out.log_likelihood[touches].take(columns, axis=-1)
    uncorrected = uncorrected[touches].take(columns, axis=-1)
    corrected = pool.corrected(uncorrected, columns)
    return np.where(is_informative(uncorrected)[:, np.newaxis], corrected, 0.0)


def _joined(tracks: list[Track]) -> Track:
    return Track(*map(np.concatenate, zip(*tracks, strict=True)))


def _unseen(n_names: int) -> Track:
    """Return tracks that get as low as each level says, as each name alike."""
    lowest = np.linspace(LEAST_SCORE, 1, _N_UNSEEN)[:, np.newaxis]
    best = np.arange(_N_UNSEEN)[:, np.newaxis] % n_names
    return Track(np.log(lowest), lowest, best, best < 0, np.ones_like(best))
