"""A belief over objects and how they are turned, from touches and where they were."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_softmax, logsumexp

from .._checks import check_number, check_option
from ..recognition import doubts
from ..touches import Touches
from ._places import Floats, places_of
from ._touch_map import TouchMap

Costs = Mapping[str, Mapping[str, float]]


class PlacedBelief:
    """A posterior over objects that also knows from where each touch was made.

    Made by `TouchMap.start`. It is used as a `Belief` is, other senses apart; how the
    object is turned is believed along with what it is, and summed out.

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
    doubt : float
        Probability outside `best`.
    unknown : float
        How little the touches, without their places, look like those of any known
        object, between 0 and 1; see `Belief`.
    touches_used : int
        Number of touches that entered so far, those without contact among them.
    flags : list of str
        What was wrong with each touch, "" for most; see `ObjectRecogniser.flags`. A
        touch without contact moves nothing, nor does its place.
    """

    def __init__(
        self, touch_map: TouchMap, prior: Mapping[str, float] | None = None
    ) -> None:
        self._map = touch_map
        self._names = [str(name) for name in touch_map.recogniser.classes_]
        self.touch = touch_map.recogniser.start(prior)
        n_turns = touch_map.n_turns
        log_prior = np.log([self.touch.posterior[name] for name in self._names])
        self._log_prior = log_prior[:, None] - np.log(n_turns)
        self._n_heard = 0
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

        Raises
        ------
        ValueError
            The touches have no places, or the recogniser cannot take their images;
            the belief is then unchanged.
        """
        where = places_of(touches, places, self._map.n_turns)
        evidence = self._map.recogniser.evidence(touches)
        heard = evidence.log_likelihood.any(axis=1)
        ratio = self._map.placed_ratio(evidence.features, where)
        ratio[~heard] = 0.0
        weighed = self._map.weighed(log_softmax(evidence.log_likelihood, axis=1), ratio)
        self.touch.update(evidence)
        self._n_heard += int(heard.sum())
        self.evidence += weighed.sum(axis=0)
        total = self.evidence * self._map.discount(self._n_heard)
        joint = total + self._log_prior
        self.log_joint = joint - logsumexp(joint)
        return self

    @property
    def flags(self) -> list[str]:
        """What was wrong with each touch."""
        return self.touch.flags

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

    def decide(self, error: float = 0.01, costs: Costs | None = None) -> str | None:
        """Return the object, "unknown", or None while more touches are needed.

        "unknown" is said when the touches without their places say it; else an
        object is named when its probability is at least 1 - error, and the touches
        alone look known. With `costs` it is the object of least expected cost that is
        named, once that cost is at most `error`; see `Belief.decide`.
        """
        error = check_number("error", error, low=1e-6, high=0.5)
        expected = self._expected_costs(costs or {})
        if self.touches_used == 0:
            return None
        if self.touch.decide(error) == "unknown":
            return "unknown"
        if expected.min() > error or not self.looks_known():
            return None
        return self._names[int(expected.argmin())]

    def looks_known(self) -> bool:
        """Whether the touches without their places fit a known object."""
        return self.touch.looks_known()

    def unknown_limit(self, error: float = 0.01) -> float | None:
        """Return the unknown score above which `decide(error)` says "unknown"."""
        return self.touch.unknown_limit(error)

    def explain(self, n_touches: int = 3, n_nearest: int = 3) -> list[dict[str, Any]]:
        """Return the touches that moved `touch` most, and what they resemble.

        See `Belief.explain`. Places are left out: `best` and `rival` are those of the
        touches without them.
        """
        return self.touch.explain(n_touches, n_nearest)

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

    def _expected_costs(self, costs: Costs) -> Floats:
        """Return what naming each object is expected to cost; 1 for a mistake."""
        share = np.exp(self.log_posterior)
        expected = np.full(len(share), share.sum()) - share
        for truth, row in costs.items():
            code = self._names.index(check_option("costs", truth, self._names))
            for named, cost in row.items():
                column = self._names.index(check_option("costs", named, self._names))
                usual = float(code != column)
                price = check_number("costs", cost, low=0.0)
                expected[column] += (price - usual) * share[code]
        return expected

    def __repr__(self) -> str:
        order = np.argsort(self.log_posterior)[::-1][:3]
        shares = np.exp(self.log_posterior[order])
        pairs = zip(order, shares, strict=True)
        listed = ", ".join(f"{self._names[code]} {share:.2f}" for code, share in pairs)
        return f"<PlacedBelief after {self.touches_used} touches: {listed}>"
