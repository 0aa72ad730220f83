"""The alarm: whether touches come from a session like those it was taught in.

Another mounting moves the features and the looks of all touches alike. Compared is how
far the mean of some touches lies from that of what they are taken for, with how far it
does for as many training touches of one part of their recordings.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse import csr_array
from scipy.special import softmax
from scipy.stats import entropy

from .._types import Floats, Indices
from ..images import DomeCrop
from ..touches import Touches
from ._calibration import left_out_log_likelihood
from ._contact import NO_CONTACT
from ._evidence import Evidence
from ._learnt import Learnt
from ._remounted_encoder import AnyEncoder, wrapped
from ._sessions import N_LOOKS, effective_number

# Of mountings that are as they were when it was taught, so many raise an alarm.
FALSE_ALARMS = 0.05
# Draws of training touches, and those of about as many objects that are compared with.
N_DRAWS, N_LIKE = 600, 150
# Of more training touches so many, evenly spread, are drawn from.
MOST_DRAWN_FROM = 2000
# A draw is of at most this share of them.
MOST_OF_ALL = 5
# Variance within objects that is added in all directions of features, as a share of its
# mean: in those that training touches hardly use, later touches stray more than they.
ADDED = 3.0
# A rim that lies this share of its radius off where it was has moved.
RIM_MOVED = 0.03

OTHER_MOUNTING = (
    "This does not look like the sensor, mounting or light that was learnt with, or "
    "not like things it knows: names may be wrong, and more often than probabilities "
    "say. Take the baseline anew, or get used to it with a few touches{}."
)


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
        load, whichever is more.
    reasons : list of str
        What was seen, in sentences.
    """

    changed: bool
    distance: float
    usual: float
    reasons: list[str]


def check_mounting(
    learnt: Learnt, evidence: Evidence, rim: list[str], seed: int
) -> MountingCheck:
    """Tell whether touches are of another mounting, by the evidence of them.

    Of what was seen of the `rim`; see `ObjectRecogniser.check_mounting`.
    """
    counts = np.array([flag != NO_CONTACT for flag in evidence.flags])
    if not counts.any():
        return MountingCheck(False, -np.inf, np.inf, [*rim, "Nothing was touched."])
    usual, n_touches = _Usual.of(learnt), int(counts.sum())
    posterior = softmax(evidence.log_likelihood[counts], axis=1)
    seen = np.column_stack([evidence.features, usual.as_known(evidence.looks)])[counts]
    away = (seen - posterior @ usual.means).mean(axis=0)
    draws = usual.draws(n_touches, effective_number(posterior.mean(axis=0)), seed)
    drawn = _means(usual.away, *draws)
    signs = usual.lengths(np.vstack([usual.widened(drawn, n_touches), away]))
    unlike = signs - signs[:-1].mean(axis=0)
    unlike = (unlike / np.maximum(signs[:-1].std(axis=0), 1e-9)).max(axis=1)
    distance, limit = (
        float(unlike[-1]),
        float(np.quantile(unlike[:-1], 1 - FALSE_ALARMS)),
    )
    if distance <= limit:
        return MountingCheck(False, distance, limit, rim)
    near = float(evidence.log_distances[counts].min(axis=1).mean())
    apart = _means(usual.apart[:, np.newaxis], *draws)
    kinds = np.column_stack([apart, drawn[:, -N_LOOKS:]])
    times = float(signs[-1, 0] / max(np.median(signs[:-1, 0]), 1e-9))
    reason = _why(kinds, np.append(near, away[-N_LOOKS:]), limit, times)
    reason = f"These {n_touches} touches {reason}"
    return MountingCheck(True, distance, limit, [reason, *rim])


@dataclass(frozen=True)
class _Usual:
    """How training touches lie from what they are taken for, each block left out.

    `means` (n_objects, n_values) of features and looks; of each touch `away`
    (n_touches, n_values), what it is taken for (`posterior`), how far the nearest touch
    of another block is (`apart`), its label's column (`codes`) and its block's place in
    the recordings of that label (`runs`); `roots` of the covariances of features and
    looks within objects; whether looks were kept (`has_looks`).
    """

    means: Floats
    away: Floats
    posterior: Floats
    apart: Floats
    codes: Indices
    runs: Indices
    roots: tuple[Floats, Floats]
    has_looks: bool

    @classmethod
    def of(cls, learnt: Learnt) -> _Usual:
        """Return how what was learnt lies; of very many touches some."""
        memory, rows = learnt.memory, learnt.classifier.left_out_rows
        asked = np.flatnonzero(learnt.counted[rows])
        asked = asked[:: -(-len(asked) // MOST_DRAWN_FROM)]
        left_out = left_out_log_likelihood(learnt.classifier)[asked]
        posterior, rows = softmax(left_out, axis=1), rows[asked]
        has_looks = not bool(np.isnan(memory.looks).any())
        looks = memory.looks if has_looks else np.zeros_like(memory.looks)

        labels, every = learnt.codes, np.flatnonzero(learnt.counted)
        sums, sizes = _sums(labels, every, memory.features, looks)
        means, codes = sums / sizes[:, np.newaxis], labels[rows]
        values = np.column_stack([memory.features[rows], looks[rows]])
        away, within = values - posterior @ means, values - means[codes]
        blocks, apart = memory.apart
        # Of its own object what is left without the block, where anything is.
        of_block, in_block = _sums(blocks, every, memory.features, looks)
        rest = np.maximum(sizes[codes] - in_block[blocks[rows]], 1e-9)[:, np.newaxis]
        others = (sums[codes] - of_block[blocks[rows]]) / rest
        own = posterior[np.arange(len(rows)), codes] * (rest[:, 0] > 0.5)
        away -= own[:, np.newaxis] * (others - means[codes])
        first = np.full(len(means), blocks.max())
        np.minimum.at(first, learnt.codes, blocks)
        roots = _root(within[:, :-N_LOOKS], ADDED), _root(within[:, -N_LOOKS:], 0.0)
        runs = blocks[rows] - first[codes]
        return cls(means, away, posterior, apart[rows], codes, runs, roots, has_looks)

    @property
    def objects(self) -> tuple[Indices, Indices]:
        """The labels that were left out, and which of them each touch is."""
        names, of = np.unique(self.codes, return_inverse=True)
        return names, of

    def as_known(self, looks: Floats) -> Floats:
        """Return looks, or zeros where training touches kept none."""
        return looks if self.has_looks else np.zeros_like(looks)

    def n_drawn(self, n_touches: int) -> int:
        """Return of how many touches a draw is, to compare so many touches with."""
        return min(n_touches, max(2, len(self.away) // MOST_OF_ALL))

    def widened(self, drawn: Floats, n_touches: int) -> Floats:
        """Return draws as far from the means as touches that are none of them."""
        of_draw, of_all = 1 / self.n_drawn(n_touches), 1 / len(self.away)
        wider = np.sqrt((of_draw + of_all) / max(of_draw - of_all, 1e-9))
        return np.asarray(drawn * wider)

    def draws(
        self, n_touches: int, n_objects: float, seed: int
    ) -> tuple[Indices, Floats]:
        """Return draws of so many touches that look to be of about so many objects.

        Each is of one block of the recordings of one to all objects, and of the nearest
        blocks where it has too few touches. Rows (N_LIKE, n_drawn), and what each
        counts in the mean of its draw.
        """
        rng, (names, of) = np.random.default_rng(seed), self.objects
        count = np.exp(rng.uniform(0, np.log(len(names)), (N_DRAWS, 1))).round()
        chosen = (rng.random((N_DRAWS, len(names))).argsort(axis=1) < count)[:, of]
        begin = (chosen * rng.random(chosen.shape)).argmax(axis=1)
        place = np.abs(self.runs - self.runs[begin, np.newaxis])
        place = np.where(chosen, place + rng.random(chosen.shape), np.inf)
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
    of: Indices, rows: Indices, features: Floats, looks: Floats
) -> tuple[Floats, Floats]:
    """Return the sums of rows' features and looks by what they are `of`, and counts."""
    counts = np.bincount(of[rows], minlength=of.max() + 1)
    which = csr_array(
        (np.ones(len(rows)), (of[rows], rows)), shape=(len(counts), len(of))
    )
    sums = [np.asarray(which @ part) for part in (features, looks)]
    return np.hstack(sums), counts.astype(float)


def _means(values: Floats, rows: Indices, counts: Floats) -> Floats:
    """Return the means of draws of rows (n_draws, n_drawn), (n_draws, n_values)."""
    which = csr_array(
        (
            counts.ravel(),
            rows.ravel(),
            np.arange(0, rows.size + 1, rows.shape[1]),
        ),
        shape=(len(rows), len(values)),
    )
    return np.asarray(which @ values)


def _root(within: Floats, added: float) -> Floats:
    """Return the root of the covariance of how touches stray within objects."""
    covariance = within.T @ within / len(within)
    mean = np.trace(covariance) / max(min(within.shape), 1)
    more = max(added * mean if added else 1e-4, 1e-12)
    root = cholesky(covariance + more * np.eye(len(covariance)), lower=True)
    return np.asarray(root)


def _why(drawn: Floats, now: Floats, usual: float, times: float) -> str:
    """Say what is most unlike: nearness, detail, load, or nothing but the features.

    Of draws (n_draws, 1 + N_LOOKS) of log distances and looks, and of these touches;
    features lie so many `times` as far from those of what they are taken for.
    """
    beyond = (now - drawn.mean(axis=0)) / np.maximum(drawn.std(axis=0), 1e-9)
    beyond[0] = max(beyond[0], 0)  # nearer than usual is no sign
    change = np.abs(now - np.median(drawn, axis=0))
    change[1:N_LOOKS] /= 2  # of powers
    # Another gain changes load and detail alike.
    of_load = change[N_LOOKS] > 0.5 * change[1:N_LOOKS].max()
    clear = [k for k in (0, N_LOOKS) if abs(beyond[k]) > usual and (of_load or not k)]
    most = clear[0] if clear else int(np.abs(beyond).argmax())
    if abs(beyond[most]) <= usual:
        return (
            "all lie to one side of what they are taken for, "
            f"{times:.1f} times as far as training touches do."
        )
    times = float(np.exp(change[most]))
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
    there: Any = wrapped(encoder).encoder.before_another_camera(touches).clean_up_
    away = np.hypot(there.rim_row_ - crop.rim_row_, there.rim_col_ - crop.rim_col_)
    larger = there.rim_radius_ / crop.rim_radius_ - 1
    if max(away / crop.rim_radius_, abs(larger)) <= RIM_MOVED:
        return []
    size = f"{abs(larger):.0%} {'larger' if larger > 0 else 'smaller'}"
    where = f"{away:.0f} pixels from where it was learnt"
    return [f"The rim lies {where}, and is {size}."]
