"""One episode as it goes: its touches, the belief after each, the decision."""

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..recognition import Belief, ObjectRecogniser
from ..touches import Touches


@dataclass(eq=False)
class LiveTouch:
    """A touch of the episode and what was believed after it.

    `posterior` is empty and `unknown` None where there is no model; `limit` is the
    unknown score above which the object counts as unknown.
    """

    number: int
    image: NDArray[Any]
    time_s: float
    posterior: dict[str, float] = field(default_factory=dict)
    unknown: float | None = None
    limit: float | None = None
    latency_ms: float | None = None

    def told(self) -> dict[str, Any]:
        """Return it as plain values, without the image."""
        return {
            "number": self.number,
            "time_s": self.time_s,
            "posterior": self.posterior,
            "unknown": self.unknown,
            "limit": self.limit,
            "latency_ms": self.latency_ms,
        }


class LiveEpisode:
    """Touches of one object, from the first to the decision and beyond.

    Parameters
    ----------
    number : int
        Its number in this session, from 1.
    recogniser : ObjectRecogniser or None
        What recognises; None collects touches without a belief.
    error : float
        Accepted share of wrong decisions.
    """

    def __init__(
        self, number: int, recogniser: ObjectRecogniser | None, error: float
    ) -> None:
        self.number, self.error = number, error
        self.recogniser = recogniser
        self.belief: Belief | None = None if recogniser is None else recogniser.start()
        self.touches: list[LiveTouch] = []
        self.open = True

    def add(self, image: NDArray[Any]) -> tuple[LiveTouch, NDArray[np.float64] | None]:
        """Take in a touch; return it and its features, None without a model.

        Raises
        ------
        ValueError
            The recogniser cannot take this image; the episode is unchanged.
        """
        touch = LiveTouch(len(self.touches) + 1, image, time.time())
        features = None
        if self.recogniser is not None and self.belief is not None:
            one = Touches(image[np.newaxis])
            evidence = self.recogniser.evidence(one)
            features = evidence.features
            self.belief.update(evidence)
            touch.posterior = self.belief.posterior
            touch.unknown = self.belief.unknown
            touch.limit = self.belief.unknown_limit(self.error)
        self.touches.append(touch)
        return touch, features

    @property
    def decision(self) -> str | None:
        """The object, "unknown", or None, as the belief is now."""
        return None if self.belief is None else self.belief.decide(self.error)

    @property
    def reason(self) -> str:
        """One sentence that says why."""
        if self.belief is None:
            return "Nothing is learnt yet: teach two objects, then learn."
        if not self.touches:
            return "No touch yet."
        return self.belief.reason(self.error)

    def told(self) -> dict[str, Any]:
        """Return it as plain values, without images."""
        return {
            "number": self.number,
            "open": self.open,
            "error": self.error,
            "decision": self.decision,
            "best": None if not self.touches or not self.belief else self.belief.best,
            "reason": self.reason,
            "touches": [touch.told() for touch in self.touches],
        }

    def as_touches(self) -> Touches:
        """Return the touches of the episode, with their times.

        Raises
        ------
        ValueError
            There is none yet.
        """
        if not self.touches:
            raise ValueError("The episode has no touch yet; touch something first.")
        times = np.array([touch.time_s for touch in self.touches])
        episode = np.full(len(times), self.number)
        images = np.stack([touch.image for touch in self.touches])
        return Touches(images, time_s=times, episode=episode)
