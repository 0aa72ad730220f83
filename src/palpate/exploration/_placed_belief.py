"""A belief over objects and how they are turned, from touches and where they were."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_softmax, logsumexp

from .._checks import check_number
from ..recognition import doubts
from ..touches import Touches
from ._places import Floats, places_of
from ._touch_map import TouchMap


class PlacedBelief:
    """A posterior over objects that also knows from where each touch was made.

    Made by `TouchMap.start`. It offers what `Belief` offers; how the object is turned
    is believed along with what it is, and summed out.

    Attributes
    ----------
    touch : Belief
        What the touches say without their places; it decides what is unknown.
    log_joint : ndarray of shape (n_objects, n_turns)
        Log posterior of each object and turn.
    posterior : dict of str to float
        Probability of each known object; sums to one.
    best : str
        The most probable object.
    unknown : float
        The probability outside `best`.
    touches_used : int
        Number of touches that entered so far.
    """

    def __init__(self, touch_map: TouchMap) -> None:
        self._map = touch_map
        self._names = [str(name) for name in touch_map.recogniser.classes_]
        self.touch = touch_map.recogniser.start()
        n_turns = touch_map.n_turns
        self._log_prior = touch_map.recogniser.log_prior()[:, None] - np.log(n_turns)
        self.evidence = np.zeros((touch_map.n_objects, n_turns))
        self.log_joint = np.repeat(self._log_prior, n_turns, axis=1)

    def update(self, touches: Touches, places: ArrayLike | None = None) -> PlacedBelief:
        """Take in touches, in order, and return this belief.

        Parameters
        ----------
        touches : Touches
            With the column `direction`, unless `places` are given.
        places : array-like of shape (n_touches, n_dimensions), optional
            Where they were made, as in `TouchMap.fit`.
        """
        where = places_of(touches, places, self._map.n_turns)
        recogniser = self._map.recogniser
        features, likelihood = recogniser.features_and_log_likelihood(touches)
        self.touch.update_from_log_likelihood(likelihood, features=features)
        ratio = self._map.placed_ratio(features, where)
        weighed = self._map.weighed(log_softmax(likelihood, axis=1), ratio)
        self.evidence += weighed.sum(axis=0)
        total = self.evidence * self._map.discount(self.touches_used)
        joint = total + self._log_prior
        self.log_joint = joint - logsumexp(joint)
        return self

    @property
    def touches_used(self) -> int:
        """Number of touches that entered so far."""
        return self.touch.touches_used

    @property
    def log_posterior(self) -> Floats:
        """Log posterior of each object, (n_objects,)."""
        return np.asarray(logsumexp(self.log_joint, axis=1))

    @property
    def posterior(self) -> dict[str, float]:
        """Probability of each known object."""
        values = map(float, np.exp(self.log_posterior))
        return dict(zip(self._names, values, strict=True))

    @property
    def best(self) -> str:
        """The most probable object."""
        return self._names[int(self.log_posterior.argmax())]

    @property
    def doubt(self) -> float:
        """Probability outside `best`."""
        return float(doubts(self.log_posterior))

    @property
    def unknown(self) -> float:
        """Unknown score of the touches without their places."""
        return self.touch.unknown

    def decide(self, error: float = 0.01) -> str | None:
        """Return the object, "unknown", or None while more touches are needed.

        "unknown" is said when the touches without their places say it; else an
        object is named when its probability is at least 1 - error, and the touches
        alone look known.
        """
        error = check_number("error", error, low=1e-6, high=0.5)
        if self.touches_used == 0:
            return None
        if self.touch.decide(error) == "unknown":
            return "unknown"
        named = self.doubt <= error and self.touch.looks_known()
        return self.best if named else None

    def reason(self, error: float = 0.01) -> str:
        """Return one sentence that says why `decide(error)` answers as it does."""
        decision = self.decide(error)
        if decision == "unknown":
            return self.touch.reason(error)
        touches = f"{self.touches_used} touch{'es' * (self.touches_used != 1)}"
        sure = f"{self.best} has probability {1 - self.doubt:.4f} after {touches}"
        if decision is None and self.doubt <= error:
            return self.touch.reason(error)
        if decision is None:
            return f"Undecided: {sure} and their places, less than {1 - error:g}."
        return f"Decided for {decision}: {sure} and their places."

    def __repr__(self) -> str:
        order = np.argsort(self.log_posterior)[::-1][:3]
        shares = np.exp(self.log_posterior[order])
        pairs = zip(order, shares, strict=True)
        listed = ", ".join(f"{self._names[code]} {share:.2f}" for code, share in pairs)
        return f"<PlacedBelief after {self.touches_used} touches: {listed}>"
