"""When the recogniser stops, and how often it is then wrong."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..recognition import ObjectRecogniser, unknown_scores
from ._episodes import Episodes


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
    """

    touches: NDArray[np.intp]
    decided: NDArray[np.bool_]
    right: NDArray[np.bool_]
    refused: NDArray[np.bool_]

    @classmethod
    def pooled(cls, parts: Sequence[Self]) -> Self:
        """Return the decisions of several folds together."""
        names = ("touches", "decided", "right", "refused")
        return cls(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))

    def figures(self, error: float) -> dict[str, Any]:
        """Return plain values; `accuracy` is over decided episodes."""
        decided = self.decided
        return {
            "error": error,
            "accuracy": float(self.right[decided].mean()) if decided.any() else None,
            "mean_touches": float(self.touches.mean()),
            "undecided": float((~decided).mean()),
            "refused_as_unknown": float(self.refused.mean()),
        }


def decide_episodes(
    recogniser: ObjectRecogniser, episodes: Episodes, error: float
) -> Decisions:
    """Stop each episode where `Belief.decide(error)` would."""
    parts = []
    for truth, log_posterior in zip(episodes.truth, episodes.beliefs, strict=True):
        n_orders, n_touches, _ = log_posterior.shape
        unknown = unknown_scores(log_posterior)
        limits = np.array(
            [
                recogniser.unknown_threshold(k + 1, refused=error)
                for k in range(n_touches)
            ]
        )
        refuse = unknown > np.maximum(limits, error)
        stop = refuse | (unknown <= error)
        decided = np.asarray(stop.any(axis=1))
        last = np.where(decided, stop.argmax(axis=1), n_touches - 1)
        rows = np.arange(n_orders)
        refused = decided & refuse[rows, last]
        right = log_posterior[rows, last].argmax(axis=1) == truth
        parts.append(Decisions(last + 1, decided, right & decided & ~refused, refused))
    return Decisions.pooled(parts)
