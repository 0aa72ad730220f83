"""The alarm: whether touches come from a session like those it was taught in.

Another mounting moves the features and the looks of all touches alike. Compared is how
far the mean of some touches lies from that of what they are taken for, and how far they
are from the nearest training touches, with how far as many training touches of one part
of their recordings do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse import csr_array
from scipy.special import softmax
from scipy.stats import entropy
from scipy.stats import norm as normal
from scipy.stats import t as student

from .._types import Floats, Indices
from ..images import DomeCrop
from ..touches import Touches
from ._calibration import left_out_log_likelihood
from ._evidence import Evidence
from ._learnt import AnyEncoder, Learnt, wrapped
from ._sentences import OTHER_SESSION
from ._sessions import N_LOOKS, effective_number

# Of mountings that are as they were when it was taught, so many raise an alarm.
FALSE_ALARMS = 0.05
# Draws of training touches, and those of about as many objects that are compared with.
N_DRAWS, N_LIKE = 600, 150
# Of more training touches so many, evenly spread, are drawn from.
MOST_DRAWN_FROM = 2000
# A draw is of at most this share of them.
MOST_OF_ALL = 5
# It is of one block of each recording, and of its neighbours if it has too few.
NEIGHBOURS = 2
# Variance within objects that is added in all directions of features, and of looks, as
# a share of its mean: later touches stray more in those that training hardly used.
ADDED, ADDED_LOOKS = 3.0, 0.1
# A rim that lies this share of its radius off where it was has moved.
RIM_MOVED = 0.03


@dataclass(frozen=True)
class MountingCheck:
    """Whether a sensor is mounted, lit and covered as it was when it was taught.

    Attributes
    ----------
    changed : bool
        Whether `distance` is above what 95 % of draws of training touches show.
    distance, usual : float
        How unlike training touches these are, and that limit, in standard deviations
        above the mean of draws of about as many objects: by how far the mean of their
        features lies from that of what they are taken for, or that of spectrum and
        load, or how far the nearest training touches are, whichever is most.
    reasons : list of str
        What was seen, in sentences.
    """

    changed: bool
    distance: float
    usual: float
    reasons: list[str]

    def message(self, more: str = "") -> str:
        """Return what that means and what to do, "" where nothing has changed.

        `more` follows the advice to get used to it with a few touches.
        """
        if not self.changed:
            return ""
        return (
            "This does not look like the sensor, mounting or light that was learnt "
            f"with, or not like things it knows. {OTHER_SESSION} Take the baseline "
            f"anew, or get used to it with a few touches{more}."
        )


def check_mounting(
    learnt: Learnt, evidence: Evidence, rim: list[str], seed: int
) -> MountingCheck:
    """Tell whether touches are of another mounting, by the evidence of them.

    Of what was seen of the `rim`; see `ObjectRecogniser.check_mounting`.
    """
    counts = evidence.shows_contact
    if not counts.any():
        return MountingCheck(False, -np.inf, np.inf, [*rim, "Nothing was touched."])
    usual, n_touches = _Usual.of(learnt), int(counts.sum())
    posterior = softmax(evidence.log_likelihood[counts], axis=1)
    looks = evidence.looks if usual.has_looks else np.zeros_like(evidence.looks)
    seen = np.column_stack([evidence.features, looks])[counts]
    away = (seen - posterior @ usual.means).mean(axis=0)
    draws = usual.draws(n_touches, effective_number(posterior.mean(axis=0)), seed)
    near = float(evidence.log_distances[counts].min(axis=1).mean())
    drawn = _means(usual.kinds, *draws)
    lengths = usual.lengths(np.vstack([usual.drawn(*draws), away]))
    signs = np.column_stack([lengths, np.append(drawn[:, 0], near)])
    unlike = signs - signs[:-1].mean(axis=0)
    unlike /= np.maximum(signs[:-1].std(axis=0), 1e-9)
    unlike_now, of_draws = unlike[-1], unlike[:-1].max(axis=1)
    distance, limit = float(unlike_now.max()), usual.limit(of_draws, n_touches)
    if distance <= limit:
        return MountingCheck(False, distance, limit, rim)
    change = np.append(near, seen[:, -N_LOOKS:].mean(axis=0)) - usual.kinds.mean(axis=0)
    beyond = change / np.maximum(drawn.std(axis=0), 1e-9)
    times = float(signs[-1, 0] / max(np.median(signs[:-1, 0]), 1e-9))
    by_features = bool(unlike_now[0] > unlike_now[1:].max())
    reason = _why(change, beyond, limit, times if by_features else None)
    reason = f"These {n_touches} touches {reason}"
    return MountingCheck(True, distance, limit, [reason, *rim])


@dataclass(frozen=True)
class _Usual:
    """How training touches lie from what they are taken for, each block left out.

    `means` (n_objects, n_values) of features and looks; of each touch how far it is
    `away` from those of what it is taken for (`posterior`), the log distance to the
    nearest touch of another block and its looks (`kinds`), its label's column
    (`codes`), its block, and the place of that in the label's recordings (`runs`); sums
    and numbers of touches by label and by block; `roots` of the covariances of features
    and looks within objects; whether looks were kept (`has_looks`).
    """

    means: Floats
    away: Floats
    posterior: Floats
    kinds: Floats
    codes: Indices
    blocks: Indices
    runs: Indices
    sums: tuple[Floats, Floats]
    sums_of_blocks: tuple[Floats, Floats]
    roots: tuple[Floats, Floats]
    has_looks: bool

    @classmethod
    def of(cls, learnt: Learnt) -> _Usual:
        """Return how what was learnt lies; of very many touches some."""
        memory, rows = learnt.memory, learnt.classifier.left_out_rows
        sampled = np.flatnonzero(learnt.counted[rows])
        sampled = sampled[:: -(-len(sampled) // MOST_DRAWN_FROM)]
        left_out = left_out_log_likelihood(learnt.classifier)[sampled]
        posterior, rows = softmax(left_out, axis=1), rows[sampled]
        has_looks = not bool(np.isnan(memory.looks).any())
        looks = memory.looks if has_looks else np.zeros_like(memory.looks)
        blocks, distances = memory.block_distances
        all_rows, parts = np.flatnonzero(learnt.counted), (memory.features, looks)
        sums = _sums(learnt.codes, all_rows, *parts)
        means, codes = sums[0] / sums[1][:, np.newaxis], learnt.codes[rows]
        values = np.column_stack([memory.features[rows], looks[rows]])
        within = values - means[codes]
        first = np.full(len(means), blocks.max())
        np.minimum.at(first, learnt.codes, blocks)
        return cls(
            means=means,
            away=values - posterior @ means,
            posterior=posterior,
            kinds=np.column_stack([distances, looks])[rows],
            codes=codes,
            blocks=blocks[rows],
            runs=blocks[rows] - first[codes],
            sums=sums,
            sums_of_blocks=_sums(blocks, all_rows, *parts),
            roots=(
                _root(within[:, :-N_LOOKS], ADDED),
                _root(within[:, -N_LOOKS:], ADDED_LOOKS),
            ),
            has_looks=has_looks,
        )

    def n_drawn(self, n_touches: int) -> int:
        """Return of how many touches a draw is, to compare so many touches with."""
        return min(n_touches, max(2, len(self.away) // MOST_OF_ALL))

    def drawn(self, rows: Indices, counts: Floats) -> Floats:
        """Return how far the means of draws lie away, (n_draws, n_values).

        The blocks of a draw are left out of the means of its own objects.
        """
        away, n_labels = _means(self.away, rows, counts), len(self.means)
        of_own = counts * self.posterior[rows, self.codes[rows]]
        draw = np.arange(len(rows))[:, np.newaxis]
        pairs, pair_codes = np.unique(
            draw * n_labels + self.codes[rows], return_inverse=True
        )
        pair_codes, label = pair_codes.reshape(rows.shape), pairs % n_labels
        used = counts > 0
        met = np.unique(np.stack([pair_codes[used], self.blocks[rows][used]]), axis=1)
        of_blocks, in_blocks = self.sums_of_blocks
        which = csr_array(
            (np.ones(met.shape[1]), (met[0], met[1])), (len(pairs), len(in_blocks))
        )
        rest = self.sums[1][label] - which @ in_blocks
        others = self.sums[0][label] - which @ of_blocks
        others /= np.maximum(rest, 1)[:, np.newaxis]
        change = np.where(rest[:, np.newaxis] > 0, others - self.means[label], 0.0)
        weight = np.bincount(pair_codes.ravel(), of_own.ravel(), len(pairs))
        np.subtract.at(away, pairs // n_labels, weight[:, np.newaxis] * change)
        return away

    def limit(self, unlike: Floats, n_touches: int) -> float:
        """Return what `FALSE_ALARMS` of sessions exceed, of draws in their deviations.

        Draws share touches and blocks: they tell as much as the few that would share
        none, and what few draws tell is widened as in Student's t.
        """
        few = min(len(self.away) / self.n_drawn(n_touches), len(np.unique(self.runs)))
        few = max(few, 2)
        wider = student.ppf(1 - FALSE_ALARMS, few - 1) / normal.ppf(1 - FALSE_ALARMS)
        usual = float(np.quantile(unlike, 1 - FALSE_ALARMS))
        return usual * float(wider * np.sqrt(1 + 1 / few))

    def draws(
        self, n_touches: int, n_objects: float, seed: int
    ) -> tuple[Indices, Floats]:
        """Return draws of so many touches that look to be of about so many objects.

        Each is of one block of the recordings of one to all objects, and of those
        beside it where it has too few touches. Rows (N_LIKE, n_drawn), and what each
        counts in the mean of its draw.
        """
        rng = np.random.default_rng(seed)
        names, object_codes = np.unique(self.codes, return_inverse=True)
        count = np.exp(rng.uniform(0, np.log(len(names)), (N_DRAWS, 1))).round()
        chosen = (rng.random((N_DRAWS, len(names))).argsort(axis=1) < count)[
            :, object_codes
        ]
        begin = (chosen * rng.random(chosen.shape)).argmax(axis=1)
        place = np.abs(self.runs - self.runs[begin, np.newaxis])
        near = chosen & (place < NEIGHBOURS)
        place = np.where(near, place + rng.random(chosen.shape), np.inf)
        rows = np.argpartition(place, self.n_drawn(n_touches) - 1, axis=1)
        rows = rows[:, : self.n_drawn(n_touches)]
        counts = np.isfinite(np.take_along_axis(place, rows, axis=1)).astype(float)
        counts /= counts.sum(axis=1, keepdims=True)
        taken_for = _means(self.posterior, rows, counts)
        numbers = entropy(taken_for, axis=1)
        like = np.argsort(np.abs(numbers - np.log(n_objects)), kind="stable")[:N_LIKE]
        return rows[like], counts[like]

    def lengths(self, away: Floats) -> Floats:
        """Return how far features and looks lie away, (n, 2), in units of objects'."""
        parts = away[:, :-N_LOOKS], away[:, -N_LOOKS:]
        units = [
            np.linalg.norm(solve_triangular(root, part.T, lower=True), axis=0)
            for root, part in zip(self.roots, parts, strict=True)
        ]
        return np.column_stack(units)


def _sums(
    group_codes: Indices, rows: Indices, features: Floats, looks: Floats
) -> tuple[Floats, Floats]:
    """Return the sums of rows' features and looks by `group_codes`, and counts."""
    counts = np.bincount(group_codes[rows], minlength=group_codes.max() + 1)
    which = csr_array(
        (np.ones(len(rows)), (group_codes[rows], rows)),
        shape=(len(counts), len(group_codes)),
    )
    sums = [np.asarray(which @ part) for part in (features, looks)]
    return np.hstack(sums), counts.astype(float)


def _means(values: Floats, rows: Indices, counts: Floats) -> Floats:
    """Return the means of draws of rows (n_draws, n_drawn), (n_draws, n_values)."""
    starts = np.arange(0, rows.size + 1, rows.shape[1])
    parts = counts.ravel(), rows.ravel(), starts
    which = csr_array(parts, shape=(len(rows), len(values)))
    return np.asarray(which @ values)


def _root(within: Floats, added: float) -> Floats:
    """Return the root of the covariance of how touches stray within objects."""
    covariance = within.T @ within / len(within)
    mean = np.trace(covariance) / max(min(within.shape), 1)
    more = max(added * mean, 1e-12)
    root = cholesky(covariance + more * np.eye(len(covariance)), lower=True)
    return np.asarray(root)


def _why(change: Floats, beyond: Floats, usual: float, times: float | None) -> str:
    """Say what is most unlike: nearness, detail, load, or the features alone.

    By how much logarithms of the distance to training touches, of powers in octaves and
    of the load (1 + N_LOOKS,) changed, and how many standard deviations that is. Where
    features raised the alarm they lie so many `times` as far as usual from what they
    are taken for.
    """
    size = np.abs(change)
    size[1:N_LOOKS] /= 2  # of powers
    sure = np.abs(beyond)
    sure[0] = max(beyond[0], 0)  # nearer than usual is no sign
    if size[N_LOOKS] < 0.5 * size[1:N_LOOKS].max():
        sure[N_LOOKS] = 0  # another gain changes load and detail alike
    clear = [k for k in (0, N_LOOKS) if sure[k] > usual]
    most = clear[0] if clear else int(sure.argmax())
    if sure[most] <= usual and times is not None:
        return (
            "all lie to one side of what they are taken for, "
            f"{times:.1f} times as far as training touches do."
        )
    times = float(np.exp(size[most]))
    if most == 0:
        return (
            f"lie {times:.1f} times as far from training touches as those from each "
            "other."
        )
    way = "weaker" if beyond[most] < 0 else "stronger"
    if most == N_LOOKS:
        return f"press {times:.1f} times {way} than training touches."
    detail = "coarse" if most <= N_LOOKS // 2 else "fine"
    return f"show {detail} detail {times:.1f} times {way} than training touches."


def rim_moved(encoder: AnyEncoder, touches: Touches) -> list[str]:
    """Return a sentence where a dome's rim lies elsewhere than it was learnt."""
    crop = encoder.clean_up_
    if not isinstance(crop, DomeCrop) or not crop.has_rim_:
        return []
    crop_now: Any = wrapped(encoder).encoder.before_another_camera(touches).clean_up_
    away = np.hypot(
        crop_now.rim_row_ - crop.rim_row_, crop_now.rim_col_ - crop.rim_col_
    )
    larger = crop_now.rim_radius_ / crop.rim_radius_ - 1
    if max(away / crop.rim_radius_, abs(larger)) <= RIM_MOVED:
        return []
    size = f"{100 * abs(larger):.0f} % {'larger' if larger > 0 else 'smaller'}"
    where = f"{away:.0f} pixels from where it was learnt"
    return [f"The rim lies {where}, and is {size}."]
