"""A belief that also knows from where each touch was made."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_softmax, logsumexp

from .._types import Array, Floats
from ..recognition import Belief, Evidence, Judge, SequenceCalibration, as_touches
from ..touches import Touches
from ._place_geometry import places_of


class PlaceKnowledge(Protocol):
    """What is known of places; `TouchMap` is one."""

    n_turns: int

    @property
    def sequence_calibration(self) -> SequenceCalibration:
        """How touches and their places add up."""
        ...

    def evidence_at(self, evidence: Evidence, places: Floats) -> Floats:
        """Return the evidence of touches, (n_touches, n_objects, n_turns) (nats)."""
        ...


class PlacedBelief(Belief):
    """A posterior over objects that also knows from where each touch was made.

    Made by `TouchMap.start`, and used as a `Belief` is. How the object is turned is
    believed along with what it is, and summed out. What is unknown is decided by the
    touches without their places. A touch without contact moves nothing, nor does its
    place.

    Attributes
    ----------
    log_joint : ndarray of shape (n_objects, n_turns)
        Log posterior of each object and turn (nats).
    """

    _basis = " and their places"

    def __init__(
        self,
        judge: Judge,
        evidence_of: Callable[[Touches | Array], Evidence],
        log_prior: Floats | None,
        places: PlaceKnowledge,
    ) -> None:
        super().__init__(judge, evidence_of, log_prior)
        self._places = places
        self._placed = np.zeros((len(judge.classes), places.n_turns))
        self._weigh()

    def update(
        self,
        touch: Touches | Array | Evidence,
        places: ArrayLike | None = None,
    ) -> Self:
        """Take in touches, in order, and return this belief.

        Parameters
        ----------
        touch : Touches
            With the column `direction`, unless `places` are given.
        places : array-like of shape (n_touches, n_dimensions), optional
            Where they were made, as in `TouchMap.fit`.

        Raises
        ------
        ValueError
            The touches have no places, or the recogniser cannot take their images;
            the belief is then unchanged.
        TypeError
            They are no `Touches`.
        """
        where = places_of(touch, places, self._places.n_turns)
        evidence = self._evidence_of(as_touches(touch))
        placed = self._places.evidence_at(evidence, where)
        self._placed = self._placed + placed.sum(axis=0)
        return super().update(evidence)

    @property
    def log_posterior(self) -> Floats:
        """Log posterior of each known object (nats), shape (n_objects,)."""
        return np.asarray(logsumexp(self.log_joint, axis=1))

    @property
    def best_without_places(self) -> str:
        """The object that is most probable by the touches alone."""
        return str(self._judge.classes[self._touch_log_posterior.argmax()])

    def _weigh(self) -> None:
        super()._weigh()
        prior = log_softmax(self._prior_and_senses()) - np.log(self._places.n_turns)
        weight = self._places.sequence_calibration.weight(self._n_informative)
        joint = self._placed * weight + prior[:, np.newaxis]
        self.log_joint: Floats = joint - logsumexp(joint)
