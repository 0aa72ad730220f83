"""The current belief over objects, and what to make of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._checks import check_number
from ..touches import Touches
from ._sequence import log_posteriors, unknown_scores, with_floor

if TYPE_CHECKING:
    from ._recogniser import ObjectRecogniser


class Belief:
    """A posterior over objects that moves with every touch.

    Made by `ObjectRecogniser.start`. The touches of one belief are one episode:
    touches of one object, in any order.

    Attributes
    ----------
    posterior : dict of str to float
        Probability of each known object; sums to one.
    best : str
        The most probable object.
    unknown : float
        How little the touches agree on one known object: the probability outside
        `best`, between 0 and 1; higher is less known.
    touches_used : int
        Number of touches that entered so far.
    """

    def __init__(self, recogniser: ObjectRecogniser) -> None:
        self._recogniser = recogniser
        self._log_prior = recogniser.log_prior()
        n_objects = len(recogniser.classes_)
        self._floored = np.empty((0, n_objects))
        self._log_posterior = self._log_prior

    def update(self, touch: Touches | NDArray) -> Belief:
        """Take in one touch (or several, in order) and return this belief.

        Parameters
        ----------
        touch : Touches or ndarray of shape (n_rows, n_cols)
            A touch of the same sensor as the training touches.

        Raises
        ------
        ValueError
            If the image has another size than the training touches, or holds
            NaN or infinity where the recogniser cannot take it; the belief is
            then unchanged.
        """
        log_likelihood = self._recogniser.log_likelihood(as_touches(touch))
        return self.update_from_log_likelihood(log_likelihood)

    def update_from_log_likelihood(self, log_likelihood: NDArray) -> Belief:
        """Take in touches by their log-likelihoods, shape (n_touches, n_objects)."""
        floored = with_floor(np.atleast_2d(log_likelihood), self._recogniser.floor_)
        self._floored = np.vstack([self._floored, floored])
        self._log_posterior = log_posteriors(
            self._floored, self._log_prior, self._recogniser.trust_
        )[-1]
        return self

    @property
    def touches_used(self) -> int:
        """Number of touches that entered so far."""
        return len(self._floored)

    @property
    def posterior(self) -> dict[str, float]:
        """Probability of each known object."""
        probabilities = np.exp(self._log_posterior)
        names = map(str, self._recogniser.classes_)
        return dict(zip(names, map(float, probabilities), strict=True))

    @property
    def best(self) -> str:
        """The most probable object; ties go to the first in sorted order."""
        return str(self._recogniser.classes_[self._log_posterior.argmax()])

    @property
    def unknown(self) -> float:
        """Probability outside `best`; higher is less known."""
        return float(unknown_scores(self._log_posterior))

    def decide(self, error: float = 0.01) -> str | None:
        """Return the object, "unknown", or None while more touches are needed.

        Parameters
        ----------
        error : float, default=0.01
            Accepted share of wrong decisions: an object is named when its
            probability is at least 1 - error; "unknown" is said when the
            touches agree less than those of all but this share of known
            episodes of the same length (learnt from left-out training touches).
            Asked after every touch, the refusals of known objects add up to more
            than this share.

        Returns
        -------
        str or None
            A known object, "unknown", or None.
        """
        error = check_number("error", error, low=1e-6, high=0.5)
        if self.touches_used == 0:
            return None
        if self.unknown <= error:
            return self.best
        limit = self._recogniser.unknown_threshold(self.touches_used, refused=error)
        return "unknown" if self.unknown > limit else None

    def reason(self, error: float = 0.01) -> str:
        """Return one sentence that says why `decide(error)` answers as it does."""
        decision = self.decide(error)
        touches = f"{self.touches_used} touch{'es' * (self.touches_used != 1)}"
        sure = f"{self.best} has probability {1 - self.unknown:.4f} after {touches}"
        if decision is None:
            return f"Undecided: {sure}, less than {1 - error:g}."
        if decision != "unknown":
            return f"Decided for {decision}: {sure}, at least {1 - error:g}."
        limit = self._recogniser.unknown_threshold(self.touches_used, refused=error)
        return (
            f"Unknown: after {touches} the probability outside the best object "
            f"({self.best}) is {self.unknown:.3f}; for all but {error:g} of known "
            f"episodes it is at most {limit:.3f}."
        )

    def __repr__(self) -> str:
        order = np.argsort(self._log_posterior)[::-1][:3]
        names = self._recogniser.classes_[order]
        shares = np.exp(self._log_posterior[order])
        listed = ", ".join(f"{n} {p:.2f}" for n, p in zip(names, shares, strict=True))
        return f"<Belief after {self.touches_used} touches: {listed}>"


def as_touches(touch: Touches | NDArray) -> Touches:
    """Return one image or a set of touches as `Touches`, or explain."""
    if isinstance(touch, Touches):
        return touch
    image = np.asarray(touch)
    if image.ndim != 2:
        raise ValueError(
            "touch must be Touches or one image (n_rows, n_cols), "
            f"got an array of shape {image.shape}."
        )
    return Touches(image[np.newaxis])
