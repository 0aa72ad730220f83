"""What a session adds to features, without labels: one move that grows touch by touch.

A session moves the features of all touches alike. What its touches tell of it are a few
sums, so that nothing has to be chosen and nothing jumps: from the first touch on the
move is what the mean of the session says, less what chance and the objects that were
asked about may have done to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from .._types import Floats
from ._sessions import Taught, group_means

# How many touches the belief that all objects are asked about alike is worth.
ALL_ALIKE = 3.0
# Few objects may lie twice as far from the middle as what they are taken for: touches
# that are mistaken are mistaken for many things.
FARTHER = 2.0


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
    away = middle - mean
    squared = np.maximum(parts.sums(away**2), 1e-300)
    left = np.maximum(0, 1 - noise / squared)
    return np.asarray(away * parts.spread(left))
