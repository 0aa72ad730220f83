"""What the node does with frames, without ROS: touches found, recognised or learnt."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate import Belief, ObjectRecogniser, Touches
from palpate.sensors import Frame, TouchDetector

REST = 10


class Said(NamedTuple):
    """After one touch: posterior and log-likelihood per object, decision or ""."""

    objects: tuple[str, ...]
    posterior: NDArray[np.float64]
    evidence: NDArray[np.float64]
    decision: str


class Touching:
    """Frames one after the other; the first ten are the baseline.

    Parameters
    ----------
    model : path
        A model file (.palpate); what is learnt is written there.
    error : float
        Accepted share of wrong names.
    """

    def __init__(self, model: str | Path, error: float = 0.01) -> None:
        self._path, self._error = Path(model), error
        self.recogniser = ObjectRecogniser.load(self._path)
        self.teaching = ""
        self._taught: dict[str, list[NDArray[Any]]] = {}
        self.start_session()

    def start_session(self) -> None:
        """Take the baseline anew from the next frames, and begin an episode."""
        self._rest: list[NDArray[Any]] = []
        self._detector = TouchDetector()
        self._number = 0
        self.start_episode()

    def start_episode(self) -> None:
        """Forget what was touched: another object comes."""
        self._belief: Belief = self.recogniser.start()

    def take(self, image: NDArray[Any], time_s: float) -> Said | None:
        """Take in a frame; return what is believed once a touch has ended."""
        frame = Frame(image, time_s, self._number)
        self._number += 1
        if self._detector.baseline is None:
            self._rest.append(image)
            if len(self._rest) == REST:
                rest, self._rest = self._rest, []
                self._detector.take_baseline(rest)
            return None
        touch = self._detector.update(frame)
        if touch is None:
            return None
        if self.teaching:
            self._taught.setdefault(self.teaching, []).append(touch.image)
            return None
        return self._recognised(touch.image)

    def learn(self) -> str:
        """Learn what was taught, write the model, begin an episode; say what was."""
        taught = {name: len(images) for name, images in self._taught.items()}
        if not taught:
            raise ValueError("learn must come after touches that teach, got none.")
        for name, images in self._taught.items():
            touches = Touches(np.stack(images), no_contact=self._detector.baseline)
            known = name in self.recogniser.classes_
            add = self.recogniser.extend_object if known else self.recogniser.add_object
            add(name, touches)
        self.recogniser.save(self._path)
        self._taught = {}
        self.start_episode()
        return ", ".join(f"{n} touches of {name}" for name, n in taught.items())

    def _recognised(self, image: NDArray[Any]) -> Said:
        touch = Touches(image[None], no_contact=self._detector.baseline)
        self._belief = self._belief.update(touch)
        objects = tuple(map(str, self.recogniser.classes_))
        posterior = np.array([self._belief.posterior[name] for name in objects])
        evidence = np.asarray(self.recogniser.log_likelihood(touch)[0], np.float64)
        decision = self._belief.decide(error=self._error) or ""
        return Said(objects, posterior, evidence, str(decision))
