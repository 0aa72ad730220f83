"""Sessions that never were: how another mounting, day or device might change touches.

Some training touches are seen again as in invented sessions, each of which changes all
of them alike. How their features differ is weighed down for a second set of machines;
how far those are trusted beside the first is told by touches left out: as they are, and
as in the invented sessions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from .._numbers import evenly_rounded, log_softmax
from .._types import Array, Bools, Floats, Indices
from ..classifiers import EncodingPool, KernelRidgeClassifier
from ..touches import Touches, TouchSource
from . import _sessions
from ._encoder import Encoder, TouchEncoder
from ._learning import as_rested, shown_rows, touches_of
from ._memory import Memory

# At most so many touches are seen again in so many invented sessions, of few as many as
# make this many times the training touches: encoding them is what rehearsal costs.
N_TOUCHES, N_SESSIONS, SEEN_AGAIN = 120, 3, 2
# What may be believed of what one confirmed touch tells of a session; a log loss (nats)
# that is larger by less than this costs nothing.
TRUSTS, NO_COST = (1 / 4, 1 / 2, 1.0), 0.05
# A smaller share changes next to nothing, and would double the work of each touch.
LEAST_SHARE = 0.1
# Machines that are asked about invented sessions learn at most so many touches.
_AT_MOST = 500
# No feature moves by more than this, in standard deviations of the training touches.
FARTHEST = 10.0
# Pads and pictures whose zero wanders do so smoothly, over this share of their side.
SMOOTH = 0.25


@dataclass(frozen=True)
class Ranges:
    """How much sessions differ: standard deviations, 0 for what is not invented.

    Of the logarithms of the whole gain, of each taxel's gain (`taxels`) and of the
    channels' (`colours`); of a smooth field on the baseline (`zero`), as a share of the
    usual signal; of the place, as a share of the longer side (`shift`); and of light
    that falls off from one side to the other (`slope`), in shares of the middle's.
    """

    gain: float = 0.0
    taxels: float = 0.0
    colours: float = 0.0
    zero: float = 0.0
    shift: float = 0.0
    slope: float = 0.0


# Of arrays and gels one setting, that of the recordings of others in which it was tried
# (docs/explanation/sessions.md); two mattresses differ by 0.1 to 0.3 in gain and taxels
# (benchmarks/session_ranges.py). A dome's disc is found anew in each session and its
# grey levels are standardised: left are light from one side, as between recordings of a
# BathTip, and a rim that was found a pixel or two off. Of vectors nothing is known.
RANGES = {
    "dome": Ranges(slope=0.07, shift=0.01),
    "array": Ranges(gain=0.3, taxels=0.2, zero=0.1, shift=1 / 30),
    "plane": Ranges(gain=0.3, taxels=0.2, zero=0.1, shift=1 / 30, colours=0.1),
    "none": Ranges(),
}
# What encodings may be blind to, and the range of it.
CHANGES = {"shifts": "shift", "gain": "gain"}


class Drawn(NamedTuple):
    """Touches in invented sessions: features (n_sessions, n_drawn, n_features).

    The first session is that of training, of the training touches `rows` (n_drawn,).
    Of the others the first `n_weighing` tell the share, all of them where it is None.
    """

    features: Floats
    rows: Indices
    n_weighing: int | None = None


def rehearse(
    pool: EncodingPool,
    encoder: TouchEncoder,
    memory: Memory,
    touches: Touches | TouchSource,
    geometry: str,
    seed: int,
) -> tuple[EncodingPool, dict[str, Any]]:
    """Return a pool that knows invented sessions too, and what was found.

    Of what `pool` learnt as `memory` of `touches`.
    """
    ranges = _seen_by(encoder, RANGES[geometry])
    changes = [name for name, size in vars(ranges).items() if size]
    if not changes:
        return pool, {"share": 0.0, "why": "how sessions change vectors is not known"}
    if KernelRidgeClassifier.learns_by_landmarks(len(memory), len(memory.classes)):
        return pool, {"share": 0.0, "why": "too much was taught at once"}
    rows = _rows(memory)
    shown = touches_of(as_rested(encoder, touches, encoder.baseline_), rows)
    drawn = draw_sessions(encoder, shown, ranges, memory, rows, seed)
    n_drawn, _, n_features = drawn.features.shape
    away = drawn.features - drawn.features.mean(axis=0)
    differences = (away * np.sqrt(n_drawn / (n_drawn - 1))).reshape(-1, n_features)
    parts = _sessions.Parts(np.cumsum([0, *encoder.parts_.values()]))
    weighing = _sessions.weighed_down(differences, memory.features, parts)
    sessions_known = "sessions" in memory.units[1]
    moved = _and_confirmed(drawn, memory, parts)
    pool, share, of_all = _rehearsed(pool, memory, weighing, moved, sessions_known)
    right, confirmed = np.split(of_all, [N_SESSIONS + 1])
    report: dict[str, Any] = {
        "share": share,
        "told_by": _left_out_by(memory) if sessions_known else "rehearsed sessions",
    }
    # Of few touches drawn none may be of a group that others are told apart without.
    if is_asked := bool(np.isfinite(of_all).all()):
        report["right"] = [float(share) for share in right]
    report["drawn"] = changes
    # Of a dome less is drawn than another mounting does.
    if is_asked and geometry != "dome":
        report["expected"] = _expected(pool, memory, right[0], right[1:])
        if len(confirmed):
            report["confirmed"] = _expected(pool, memory, right[0], confirmed)
    if pool.takes_weights:
        replays = [*_replays(pool, memory, drawn, parts, seed)]
        report["trust"] = _trust_in_one(replays)
    return pool, report


def _rehearsed(
    pool: EncodingPool,
    memory: Memory,
    weighing: Floats,
    drawn: Drawn,
    sessions_known: bool,
) -> tuple[EncodingPool, float, Floats]:
    """Return a pool whose machines know invented sessions too, and how far they count.

    The plain pool where they count for nothing. Also which share of touches, learnt
    from half of them, is recognised as they are and in each session (n_sessions + 1,).

    `weighing` (n_features, n_features) weighs down how the `drawn` sessions differ,
    part by part. Where the blocks are whole sessions, or persons (`sessions_known`),
    these tell the share, else invented sessions do as well, and count half. It is that
    of the weights of least log loss; a priori both count alike, with a standard
    deviation as large (`EncodingPool.best_weights`).
    """
    X, y, groups = memory.features, memory.labels, memory.blocks
    weighed = EncodingPool(pool.parts, pool.machine, together=pool.together)
    weighed.fit(X @ weighing, y, groups=groups)
    codes = np.searchsorted(pool.classes_, y)
    rows = pool.left_out_rows
    left_out = np.stack([pool.left_out_, weighed.left_out_])
    label_codes, n_ordinary = codes[rows], len(rows)
    of_drawn, is_asked = _answers_of_drawn(pool, weighed, memory, weighing, drawn)
    drawn_codes = codes[drawn.rows]
    if not sessions_known and is_asked.any():
        # As many of each kind, in turn.
        invented = of_drawn[:, 1:][:, : drawn.n_weighing, is_asked]
        names = np.tile(drawn_codes[is_asked], invented.shape[1])
        invented = invented.reshape(2, -1, of_drawn.shape[3])
        n_each = min(n_ordinary, len(names))
        sampled, others = (evenly_rounded(n, n_each) for n in (n_ordinary, len(names)))
        left_out = np.concatenate([left_out[:, sampled], invented[:, others]], axis=1)
        label_codes = np.concatenate([label_codes[sampled], names[others]])
    finite = np.isfinite(left_out).all(axis=(0, 2))
    bounded = np.maximum(left_out[:, finite], -30.0)
    weights = EncodingPool.best_weights(bounded, label_codes[finite])
    share = float(weights[1] / max(weights.sum(), 1e-12))
    if share < LEAST_SHARE:
        share = 0.0
    mixed = (1 - share) * of_drawn[0] + share * of_drawn[1]
    is_right = (mixed.argmax(axis=-1) == drawn_codes)[:, is_asked]
    right = is_right.mean(axis=1) if is_asked.any() else np.full(len(is_right), np.nan)
    if share:
        pool = pool.beside(weighed, weighing, share, codes[rows], groups[rows])
    return pool, share, right


def _answers_of_drawn(
    pool: EncodingPool,
    weighed: EncodingPool,
    memory: Memory,
    weighing: Floats,
    drawn: Drawn,
) -> tuple[Floats, Bools]:
    """Return what both pools say of drawn touches whose group they have not learnt.

    Shape (2, n_sessions, n_drawn, n_classes), of machines that learnt one half of each
    label's groups, with the choices made for all; and which touches could be asked.
    """
    n_sessions, n_drawn, n_features = drawn.features.shape
    answers = np.zeros((2, n_sessions, n_drawn, len(pool.classes_)))
    is_asked = np.zeros(n_drawn, dtype=bool)
    for learnt, left_out in _halves(memory, drawn.rows):
        rows = np.isin(np.arange(n_drawn), left_out)
        is_asked |= rows
        labels, groups = memory.labels[learnt], memory.blocks[learnt]
        test_features = drawn.features[:, rows].reshape(-1, n_features)
        for kind, (machines, matrix) in enumerate(((pool, None), (weighed, weighing))):
            touches, others = memory.features[learnt], test_features
            if matrix is not None:
                touches, others = touches @ matrix, others @ matrix
            refitted = copy(machines).refit(touches, labels, groups=groups)
            columns = np.searchsorted(pool.classes_, refitted.classes_)
            row = np.full((len(others), len(pool.classes_)), -30.0)
            row[:, columns] = refitted.log_likelihood(others)
            answers[kind][:, rows] = row.reshape(n_sessions, int(rows.sum()), -1)
    return log_softmax(answers, axis=-1), is_asked


def _halves(memory: Memory, drawn: Indices) -> Iterator[tuple[Indices, Indices]]:
    """Yield touches to learn, of half of each label's groups, and to ask of the rest.

    Those are some of the touches `drawn`, by their place in it, of labels that are
    learnt; nothing where fewer than two labels are, or none can be asked.
    """
    y, groups = memory.labels, memory.blocks
    half = np.zeros(len(y), dtype=np.intp)
    for name in np.unique(y):
        of_label = y == name
        half[of_label] = np.unique(groups[of_label], return_inverse=True)[1] % 2
    for k in range(2):
        learnt = _thinned(np.flatnonzero(half != k), y)
        left_out = (half[drawn] == k) & np.isin(y[drawn], y[learnt])
        if len(np.unique(y[learnt])) > 1 and left_out.any():
            yield learnt, np.flatnonzero(left_out)


def _thinned(rows: Indices, y: Array) -> Indices:
    """Return at most so many rows, of each label its share, at least four."""
    if len(rows) <= _AT_MOST:
        return rows
    kept = []
    for name in np.unique(y[rows]):
        of_label = rows[y[rows] == name]
        count = len(of_label)
        n_kept = min(count, max(4, round(count * _AT_MOST / len(rows))))
        kept.append(of_label[evenly_rounded(count, n_kept)])
    return np.sort(np.concatenate(kept))


def _seen_by(encoder: TouchEncoder, ranges: Ranges) -> Ranges:
    """Return ranges without that which all encodings in use are blind to."""
    blind = [encoder.blind_to(name) for name in encoder.encodings]
    of_all = frozenset.intersection(*blind)
    return replace(ranges, **{CHANGES[name]: 0.0 for name in CHANGES.keys() & of_all})


def _left_out_by(memory: Memory) -> str:
    """Return what is left out whole: persons, where blocks are theirs, or sessions."""
    pairs = np.unique(np.stack([memory.blocks.astype(str), memory.subjects]), axis=1)
    n_blocks, n_persons = (len(np.unique(names)) for names in pairs)
    one_each = n_blocks == n_persons == len(pairs[0])
    return f"{'persons' if one_each else 'sessions'} left out"


def _and_confirmed(drawn: Drawn, memory: Memory, parts: _sessions.Parts) -> Drawn:
    """Return drawn touches, and again as moved by a confirmed one of each label.

    Its training touches are those that are not confirmed; not again where each label
    has one alone.
    """
    codes = np.searchsorted(memory.classes, memory.labels)
    drawn_codes = codes[drawn.rows]
    first = np.unique(drawn_codes, return_index=True)[1]
    first = first[np.bincount(codes)[drawn_codes[first]] > 1]
    rest = np.delete(np.arange(len(codes)), drawn.rows[first])
    taught = _sessions.Taught(memory.features[rest], codes[rest], parts)
    moved = [drawn.features]
    for session in drawn.features[1:] if len(first) else ():
        shift = _sessions.shift_by_labels(session[first], drawn_codes[first], taught)
        moved.append((session + shift)[np.newaxis])
    return Drawn(np.concatenate(moved), drawn.rows, len(drawn.features) - 1)


@dataclass(frozen=True)
class _Replay:
    """A rehearsed session in which one touch is confirmed, and the others are asked.

    `pool` has learnt `features` and `labels`, in `groups`; of the touches `session`
    (n_asked, n_features), labels `of`, the first one is confirmed.
    """

    pool: EncodingPool
    taught: tuple[Floats, Array, Indices]
    session: Floats
    of: Array
    shift: Floats

    def loss(self, trust: float) -> float:
        """Return the log loss (nats) of those asked, as far as the one is believed."""
        pool, session = self.pool, self.session + trust * self.shift
        if trust:
            features, labels, groups = self.taught
            weights = np.append(np.ones(len(labels)), trust**2)
            pool = copy(pool).refit(
                np.vstack([features, session[:1]]),
                np.append(labels, self.of[:1]),
                groups=np.append(groups, groups.max() + 1),
                weights=weights,
                keep_shape=True,
            )
        log_posterior = log_softmax(pool.log_likelihood(session[1:]), axis=1)
        codes = np.searchsorted(pool.classes_, self.of[1:])
        return float(-log_posterior[np.arange(len(codes)), codes].mean())


def _replays(
    pool: EncodingPool, memory: Memory, drawn: Drawn, parts: _sessions.Parts, seed: int
) -> Iterator[_Replay]:
    """Yield each rehearsed session twice, asked of machines that learnt one half."""
    rng = np.random.default_rng(seed)
    for learnt, left_out in _halves(memory, drawn.rows):
        taught = memory.features[learnt], memory.labels[learnt], memory.blocks[learnt]
        refitted = copy(pool).refit(*taught)
        codes = np.searchsorted(refitted.classes_, taught[1])
        to_compare = _sessions.Taught(taught[0], codes, parts)
        for session in drawn.features[1:] if len(left_out) > 1 else ():
            order = rng.permutation(left_out)
            features, true_labels = session[order], memory.labels[drawn.rows[order]]
            code = np.searchsorted(refitted.classes_, true_labels[:1])
            shift = _sessions.shift_by_labels(features[:1], code, to_compare)
            yield _Replay(refitted, taught, features, true_labels, shift)


def _trust_in_one(replays: Sequence[_Replay]) -> float:
    """Return how far what one confirmed touch tells of its session is to be believed.

    It is moved by this share of what the touch tells, which then counts the square of
    it: as much as does not cost, by more than `NO_COST` and one standard error.
    """
    trust, before = 0.0, np.array([replay.loss(0.0) for replay in replays])
    for more in TRUSTS if len(replays) > 1 else ():
        lost = np.array([replay.loss(more) for replay in replays]) - before
        if lost.mean() > max(NO_COST, lost.std(ddof=1) / np.sqrt(len(lost))):
            break
        trust = more
    return trust


def _expected(
    pool: EncodingPool, memory: Memory, right_now: float, right: Floats
) -> list[float]:
    """Return between what shares a touch is expected to be right in another session.

    Of touches left out as they are, what rehearsed sessions, learnt from half of the
    touches, leave: the worst and the best of them, of `right_now` in training's own.
    """
    names = pool.classes_[pool.left_out_.argmax(axis=1)]
    today = float((names == memory.labels[pool.left_out_rows]).mean())
    left = np.minimum(right / max(float(right_now), 1e-9), 1.0)
    return [today * float(left.min()), today * float(left.max())]


def rehearsal_message(rehearsal: dict[str, Any]) -> str:
    """Return what `rehearse` found as a sentence for people."""
    if "why" in rehearsal:
        return f"no sessions were rehearsed: {rehearsal['why']}"
    what = "invented sessions (another day, light or mounting)"
    tested = f"as tests on {rehearsal['told_by']} showed"
    if not rehearsal["share"]:
        return f"learning from {what} too does not help, {tested}"
    share = f"{100 * rehearsal['share']:.0f} %"
    return f"it also learnt from {what}; that counts {share}, {tested}"


def _rows(memory: Memory) -> Indices:
    """Return touches to see again, evenly of each label, with contact if possible."""
    good = np.flatnonzero(~memory.nothing)
    if len(np.unique(memory.labels[good])) < len(memory.classes):
        good = np.arange(len(memory))
    at_most = min(N_TOUCHES, -(-SEEN_AGAIN * len(memory) // N_SESSIONS))
    rows = good[shown_rows(memory.labels[good], at_most)]
    return rows[evenly_rounded(len(rows), at_most)]


def draw_sessions(
    encoder: Encoder,
    touches: Touches,
    ranges: Ranges,
    memory: Memory,
    rows: Indices,
    seed: int,
) -> Drawn:
    """Return the features of touches in their own session and in invented ones."""
    rng = np.random.default_rng(seed)
    as_recorded = memory.features[rows]
    spread = FARTHEST * memory.features.std(axis=0)
    sessions, rest = [as_recorded], at_rest(touches)
    # Encoding looks at nothing else.
    looked_at = {n: getattr(touches, n) for n in ("channels", "pads", "geometry")}
    for _ in range(N_SESSIONS):
        images = in_another_session(touches, ranges, rng, rest)
        moved = encoder.transform(Touches(images, **looked_at)) - as_recorded
        sessions.append(as_recorded + np.clip(moved, -spread, spread))
    return Drawn(np.stack(sessions), rows)


def at_rest(touches: Touches) -> tuple[Floats, float]:
    """Return the frame of no contact, or the median, and how far touches go from it."""
    images = np.nan_to_num(touches.images)
    rest = touches.no_contact
    if rest is None:
        rest = np.median(images, axis=0)
    rest = np.nan_to_num(np.asarray(rest, dtype=np.float64))
    return rest, float(np.percentile(np.abs(images - rest), 99)) or 1.0


def in_another_session(
    touches: Touches,
    ranges: Ranges,
    rng: np.random.Generator,
    rest: tuple[Floats, float],
) -> Array:
    """Return images as an invented session would show them, in their own type.

    `rest` is what `at_rest` returns for them.
    """
    dead, kind = np.isnan(touches.images), touches.images.dtype
    images = np.nan_to_num(touches.images.astype(np.float64), copy=False)
    shape, colours = images.shape[1:3], images.shape[3:]
    still, signal = rest
    gains = np.exp(rng.normal(0, ranges.gain) + rng.normal(0, ranges.taxels, shape))
    slope = rng.normal(0, 1, 2) * ranges.slope
    down, across = (np.linspace(-1, 1, n) for n in shape)
    light = gains * (1 + slope[0] * down[:, np.newaxis] + slope[1] * across)
    zero = ranges.zero * signal * _smooth(shape, rng)
    where = rng.normal(0, ranges.shift, 2)
    if colours:
        light, zero = light[..., np.newaxis], zero[..., np.newaxis]
        light = light * np.exp(rng.normal(0, ranges.colours, colours))
    images = images * light
    if ranges.shift:
        images = np.stack([_shifted(i, where, touches.pads) for i in images])
    images = images + np.where(still != 0, zero, 0.0)
    if kind.kind in "ui":
        limits = np.iinfo(kind)
        return np.clip(np.rint(images), limits.min, limits.max).astype(kind)
    return np.where(dead, np.nan, images)


def _smooth(shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    """Return a smooth random field of standard deviation 1."""
    from scipy.ndimage import gaussian_filter

    field = rng.normal(size=shape)
    field = gaussian_filter(field, SMOOTH * np.array(shape), mode="nearest")
    return np.asarray(field / max(float(field.std()), 1e-12))


def _shifted(image: Floats, share: Floats, pads: Array | None) -> Floats:
    """Return an image moved by a share of its longer side, of a hand pad by pad."""
    import cv2

    whole = np.array([[0, 0, *image.shape[:2]]])
    result = image.copy()
    for row, col, n_rows, n_cols in whole if pads is None else pads:
        down, right = share * max(n_rows, n_cols)
        move = np.array([[1, 0, right], [0, 1, down]])
        pad = slice(row, row + n_rows), slice(col, col + n_cols)
        part = np.ascontiguousarray(image[pad])
        size = int(n_cols), int(n_rows)
        moved = cv2.warpAffine(part, move, size, borderMode=cv2.BORDER_REPLICATE)
        result[pad] = moved.reshape(part.shape)
    return result
