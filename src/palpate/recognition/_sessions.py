"""What a session (a mounting, a baseline, a day) does to features, and taking it off.

A session moves the features of all touches in much the same way. How far is told by
what was met in it: by labels where there are some, else by what the touches are taken
for, all of them together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Self

import numpy as np

from .._types import Array, Floats, Indices

# Variance between sessions that no pair showed, as a share of the mean of those shown.
UNSEEN = 0.3
# How many touches the belief that all objects are asked about alike is worth.
ALL_ALIKE = 3.0
# Few objects may lie twice as far from the middle as what they are taken for: touches
# that are mistaken are mistaken for many things.
FARTHER = 2.0
# A touch's look: the power of its image, at most so many taxels wide, in so many
# octaves, and its load.
LOOK_SIDE, N_OCTAVES = 64, 6
N_LOOKS = N_OCTAVES + 1


@dataclass(frozen=True)
class Parts:
    """Where the features of each encoding begin, shape (n_parts + 1,)."""

    cuts: Indices

    def sums(self, values: Floats) -> Floats:
        """Return the sums over each part of the last axis."""
        return np.add.reduceat(values, self.cuts[:-1], axis=-1)

    def spread(self, factors: Floats) -> Floats:
        """Return a factor of each part for each of its features."""
        return np.repeat(factors, np.diff(self.cuts))


@dataclass(frozen=True)
class Taught:
    """Training touches, each with its label's column, to compare a session with."""

    features: Floats
    codes: Indices
    parts: Parts

    @cached_property
    def means(self) -> Floats:
        """The mean touch of each object, shape (n_objects, n_features)."""
        return group_means(self.features, self.codes)

    @cached_property
    def within(self) -> Floats:
        """The variance of touches about their object's mean, (n_parts,), all alike."""
        counts = np.bincount(self.codes)
        strays = self.features - self.means[self.codes]
        variances = group_means(strays**2, self.codes)[counts > 1]
        if not len(variances):
            return np.zeros(len(self.parts.cuts) - 1)
        counts = counts[counts > 1, np.newaxis]
        sums = self.parts.sums(variances * counts / (counts - 1))
        return np.asarray(sums.mean(axis=0))


@dataclass(frozen=True)
class SessionSums:
    """What the touches of a session sum up to.

    Their number, the sums of their features (n_features,) and of the squared lengths of
    each part (n_parts,), and of what they are taken for as they are (n_objects,).
    """

    n_touches: int
    features: Floats
    squares: Floats
    posteriors: Floats

    @classmethod
    def of(cls, features: Floats, posteriors: Floats, taught: Taught) -> Self:
        """Return the sums of touches (n_touches, n_features), taken for (..., n)."""
        squares = taught.parts.sums(features**2).sum(axis=0)
        sums = features.sum(axis=0), squares, posteriors.sum(axis=0)
        return cls(len(features), *sums)

    def plus(self, other: Self) -> Self:
        """Return the sums of these touches and others."""
        names = "n_touches", "features", "squares", "posteriors"
        return type(self)(*(getattr(self, n) + getattr(other, n) for n in names))

    @property
    def shares(self) -> Floats:
        """The mean of what the touches are taken for, (n_objects,)."""
        return np.asarray(self.posteriors / max(self.n_touches, 1))


def group_means(values: Floats, codes: Indices) -> Floats:
    """Return the mean row of each code, shape (n_codes, n_features)."""
    one_hot = np.eye(codes.max() + 1)[codes]
    return np.asarray(one_hot.T @ values / one_hot.sum(axis=0)[:, np.newaxis])


def session_effects(features: Floats, codes: Array, sessions: Array) -> Floats:
    """Return what each touch's session adds to its features, (n_touches, n_features).

    By least squares features = object + session, the shortest solution, so that
    sessions in which nothing was met that others met add nothing; their mean over
    touches is 0.
    """
    session_codes = np.unique(sessions, return_inverse=True)[1].ravel()
    which = np.unique(codes, return_inverse=True)[1].ravel()
    counts = np.zeros((which.max() + 1, session_codes.max() + 1))
    np.add.at(counts, (which, session_codes), 1.0)
    n_each = counts.sum(axis=1, keepdims=True)
    # What objects explain is taken out of the normal equations of the sessions, as they
    # are linked: one of several that were met with others apart from all else is free.
    share = counts / n_each
    normal = np.diag(counts.sum(axis=0)) - counts.T @ share
    sums = np.zeros((session_codes.max() + 1, features.shape[1]))
    np.add.at(sums, session_codes, features - group_means(features, which)[which])
    effects = np.linalg.pinv(normal, rcond=1e-10, hermitian=True) @ sums
    effects = effects[session_codes]
    return np.asarray(effects - effects.mean(axis=0))


def between_sessions(
    features: Floats, codes: Array, sessions: Array, subjects: Array
) -> Floats:
    """Return how the same thing differs between sessions, (n_things, n_features).

    An object, of one person where `subjects` tell them, met in several sessions: the
    means of its sessions less their mean; no rows where nothing was met twice.
    """
    things = np.stack([codes.astype(str), subjects.astype(str)])
    thing = np.unique(things, axis=1, return_inverse=True)[1].ravel()
    rows = []
    for number in range(thing.max() + 1):
        rows_of_thing = np.flatnonzero(thing == number)
        session_codes = np.unique(sessions[rows_of_thing], return_inverse=True)[1]
        if session_codes.max():
            means = group_means(features[rows_of_thing], session_codes)
            rows.append(
                (means - means.mean(axis=0)) * np.sqrt(len(means) / session_codes.max())
            )
    return np.concatenate(rows) if rows else np.empty((0, features.shape[1]))


def weighed_down(differences: Floats, features: Floats, parts: Parts) -> Floats:
    """Return the matrix that weighs down how sessions differ, part by part.

    Within-class covariance normalisation [1]_: the inverse root of the covariance of
    `differences`, to which `UNSEEN` of its mean is added; each part keeps its variance.
    Shape (n_features, n_features).

    References
    ----------
    .. [1] A. O. Hatch, S. Kajarekar and A. Stolcke, "Within-class covariance
       normalization for SVM-based speaker recognition", Interspeech 2006.
    """
    whole = np.zeros((features.shape[1],) * 2)
    for start, end in zip(parts.cuts[:-1], parts.cuts[1:], strict=True):
        part, columns = differences[:, start:end], features[:, start:end]
        values, axes = np.linalg.eigh(part.T @ part)
        values = np.maximum(values, 0)
        scale = values.mean() or 1.0
        matrix = (axes / np.sqrt(values / scale + UNSEEN)) @ axes.T
        factor = np.sqrt(columns.var(axis=0).sum())
        factor /= np.sqrt((columns @ matrix).var(axis=0).sum()) or 1.0
        whole[start:end, start:end] = factor * matrix
    return whole


def shift_by_labels(features: Floats, codes: Indices, taught: Taught) -> Floats:
    """Return what to add to a session's features, by the labels of its touches.

    Each object weighs the same; of what so many objects would give by themselves, each
    touched at one place of it, nothing is left (James and Stein).
    """
    names, which = np.unique(codes, return_inverse=True)
    shift = group_means(taught.means[codes] - features, which).mean(axis=0)
    return _less_noise(shift, taught.within / len(names), taught.parts)


def shift_unlabelled(sums: SessionSums, taught: Taught) -> Floats:
    """Return what to add to a session's features, (n_features,), of its touches' sums.

    The mean of the session goes to that of all objects alike, less what may be due to
    its touches and to the objects they are of: part by part James and Stein [1]_. That
    a few objects alone are asked about is told by how little their touches stray from
    each other, and by being taken for few things: neither alone is enough, since a
    session may press less hard, and shifted touches are taken for one wrong thing.

    References
    ----------
    .. [1] W. James and C. Stein, "Estimation with quadratic loss", Proc. Fourth
       Berkeley Symposium, 1961.
    """
    parts, n = taught.parts, sums.n_touches
    if not n:
        return np.zeros_like(sums.features)
    middle, mean = taught.means.mean(axis=0), sums.features / n
    between = np.maximum(parts.sums((taught.means - middle) ** 2).mean(axis=0), 1e-300)
    strays = taught.features - taught.means[taught.codes]
    within = parts.sums(group_means(strays**2, taught.codes)).mean(axis=0)
    spread = np.maximum(sums.squares - n * parts.sums(mean**2), 0) / max(n - 1, 1)
    by_spread = (spread - within) / between
    shares = sums.shares
    taken_for = shares @ taught.means
    by_names = parts.sums(shares @ (taught.means - taken_for) ** 2) / between
    # Whatever encoding looks, the objects are the same.
    evidence = np.clip(max(by_spread.mean(), by_names.mean()), 0, 1)
    all_alike = (ALL_ALIKE + (n - 1) * evidence) / (ALL_ALIKE + n - 1)
    of_few = FARTHER**2 * parts.sums((taken_for - middle) ** 2)
    noise = (between + within) / n + (1 - all_alike) * of_few
    return _less_noise(middle - mean, noise, parts)


def effective_number(shares: Floats) -> float:
    """Return the exponential of the entropy of shares."""
    return float(np.exp(-(shares * np.log(np.maximum(shares, 1e-300))).sum()))


def looks(images: Array, rest: Array | None) -> Floats:
    """Return what light, rubber and gain alone would change, (n_touches, N_LOOKS).

    The logarithm of the power in octaves of the spectrum of images (n_touches, n_rows,
    n_cols), the coarsest first, and of the mean difference from `rest`, a frame of no
    contact (0 where it is None).
    """
    import cv2

    small = levels = np.ascontiguousarray(images, dtype=np.float32)
    shrink = LOOK_SIDE / max(small.shape[1:])
    if shrink < 1:
        size = tuple(max(1, round(shrink * side)) for side in small.shape[:0:-1])
        area = cv2.INTER_AREA
        small = np.stack(
            [cv2.resize(picture, size, interpolation=area) for picture in levels]
        )
    window, octaves = _window_and_octaves(*small.shape[1:])
    waves = np.fft.rfft2((small - small.mean(axis=(1, 2), keepdims=True)) * window)
    sums = (np.abs(waves) ** 2).reshape(len(small), -1) @ octaves
    sums = np.maximum(sums, 1e-6 * sums.sum(axis=1, keepdims=True))
    still = np.zeros_like(levels[0])
    if rest is not None:
        still[:] = rest
    away = [cv2.norm(picture, still, cv2.NORM_L1) / still.size for picture in levels]
    return np.asarray(np.log(np.maximum(np.column_stack([sums, away]), 1e-12)))


@lru_cache(maxsize=16)
def _window_and_octaves(n_rows: int, n_cols: int) -> tuple[Floats, Floats]:
    """Return a Hann window, and which wave is in which octave, (n_waves, N_OCTAVES)."""
    window = np.outer(np.hanning(n_rows + 2)[1:-1], np.hanning(n_cols + 2)[1:-1])
    across, down = np.fft.rfftfreq(n_cols), np.fft.fftfreq(n_rows)
    octave = np.log2(np.maximum(np.hypot(down[:, np.newaxis], across), 1e-9) * 2)
    octave = np.clip(N_OCTAVES + np.ceil(octave).astype(int) - 1, 0, N_OCTAVES - 1)
    return window, np.eye(N_OCTAVES)[octave.ravel()]


def _less_noise(shift: Floats, noise: Floats, parts: Parts) -> Floats:
    """Return a shift less what chance would move, part by part."""
    squared = np.maximum(parts.sums(shift**2), 1e-300)
    return shift * parts.spread(np.maximum(0, 1 - noise / squared))
