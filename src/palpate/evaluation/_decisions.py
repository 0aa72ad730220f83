"""When the recogniser stops, and how often it is then wrong."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from ..recognition import ObjectRecogniser, doubts
from ._episodes import Episodes

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Decisions:
    """How the episodes of known objects ended.

    Attributes
    ----------
    touches : ndarray of int, shape (n_episodes,)
        Touches used; the full length where no decision was reached.
    decided, right, refused : ndarray of bool, shape (n_episodes,)
        Whether an object was named or "unknown" was said; whether the right
        object was named; whether "unknown" was said.
    objects : ndarray of str, shape (n_episodes,)
        Whose touches they were: episodes of one object are not independent.
    """

    touches: NDArray[np.intp]
    decided: NDArray[np.bool_]
    right: NDArray[np.bool_]
    refused: NDArray[np.bool_]
    objects: NDArray[np.str_]

    @classmethod
    def pooled(cls, parts: Sequence[Self]) -> Self:
        """Return the decisions of several folds together."""
        names = ("touches", "decided", "right", "refused", "objects")
        return cls(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))

    def figures(self, error: float) -> dict[str, Any]:
        """Return plain values; `accuracy` is over decided episodes.

        `error_at_most` is an upper bound, at 95 % confidence, on the error of decided
        episodes of new objects: each object counts once, as wrong as its episodes
        were (Clopper and Pearson 1934, doi:10.1093/biomet/26.4.404). `verified` says
        whether it is within `error`; with n objects it cannot be below
        1 - 0.05^(1/n), whatever happens.
        """
        decided = self.decided
        n_objects, bound = self._bound()
        least = 1 - (1 - CONFIDENCE) ** (1 / max(n_objects, 1))
        return {
            "error": error,
            "accuracy": float(self.right[decided].mean()) if decided.any() else None,
            "mean_touches": float(self.touches.mean()),
            "undecided": float((~decided).mean()),
            "refused_as_unknown": float(self.refused.mean()),
            "wrong": int((decided & ~self.right).sum()),
            "n_episodes": len(decided),
            "n_objects": n_objects,
            "error_at_most": bound,
            "verified": bound <= error,
            "can_be_verified": least <= error,
        }

    def _bound(self) -> tuple[int, float]:
        """Return the number of objects with decided episodes, and the bound."""
        shares = []
        for name in np.unique(self.objects):
            rows = (self.objects == name) & self.decided
            if rows.any():
                shares.append(1 - self.right[rows].mean())
        n_objects, wrong = len(shares), float(np.sum(shares))
        if n_objects == 0 or wrong >= n_objects:
            return n_objects, 1.0
        return n_objects, float(beta.ppf(CONFIDENCE, wrong + 1, n_objects - wrong))


def decide_episodes(
    recogniser: ObjectRecogniser, episodes: Episodes, error: float
) -> Decisions:
    """Stop each episode where `Belief.decide(error)` would."""
    parts = []
    longest = max(int(counts.max()) for counts in episodes.n_told)
    limits = np.array(
        [
            recogniser.unknown_scale_.refusal_threshold(k, error)
            for k in range(1, longest + 1)
        ]
    )
    # Before any touch said something there is no limit to exceed.
    limits = np.concatenate([[np.inf], limits])
    scale = recogniser.unknown_scale_
    naming = np.array([scale.naming_threshold(k) for k in range(longest + 1)])
    per_object = zip(
        episodes.objects,
        episodes.truth,
        episodes.beliefs,
        episodes.n_told,
        episodes.unknown,
        strict=True,
    )
    for name, truth, log_posterior, counts, unknown in per_object:
        n_orders, n_touches, _ = log_posterior.shape
        refuse = unknown > limits[counts]
        fits = unknown <= naming[counts]
        stop = refuse | (fits & (doubts(log_posterior) <= error))
        decided = np.asarray(stop.any(axis=1))
        last = np.where(decided, stop.argmax(axis=1), n_touches - 1)
        rows = np.arange(n_orders)
        refused = decided & refuse[rows, last]
        right = log_posterior[rows, last].argmax(axis=1) == truth
        whose = np.full(n_orders, name)
        ended = (last + 1, decided, right & decided & ~refused, refused, whose)
        parts.append(Decisions(*ended))
    return Decisions.pooled(parts)
