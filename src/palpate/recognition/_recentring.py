"""A recogniser that gets used to a session by itself, touch by touch."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from typing import Self

import numpy as np
from scipy.special import softmax

from .._types import Array
from ..touches import Touches
from ._belief import STRANGERS, Belief
from ._contact import NO_CONTACT
from ._evidence import Evidence
from ._recogniser import ObjectRecogniser
from ._remounted_encoder import wrapped
from ._remounting import without_sessions
from ._sessions import SessionSums, shift_unlabelled


class Recentring:
    """Recognises in another session while it finds out what the session adds.

    What `remount` takes off with all touches of a session at once, without labels, is
    taken off with those there were so far: a little at first, more with each touch. The
    beliefs of the episode under way move along.

    Parameters
    ----------
    recogniser : ObjectRecogniser
        As learnt; it stays as it is. Another camera, gain or baseline is for `remount`.

    Attributes
    ----------
    recogniser : ObjectRecogniser
        As it serves in the session by now.
    n_touches : int
        Touches of the session so far that showed contact.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate import Touches
    >>> from palpate.recognition import ObjectRecogniser, Recentring
    >>> images = np.random.default_rng(0).random((40, 3, 24))
    >>> images[:20] += 1
    >>> touches = Touches(images, object=["pen"] * 20 + ["mug"] * 20, geometry="none")
    >>> today = Recentring(ObjectRecogniser().fit(touches))
    >>> today.start().update(touches[:3]).best
    'pen'
    >>> today.start().update(touches[20:23]).best
    'mug'
    """

    def __init__(self, recogniser: ObjectRecogniser) -> None:
        learnt, report = without_sessions(recogniser.learnt())
        self._moves = bool(report.get("centred", True))
        self._as_learnt = copy(recogniser).serve(learnt)
        report |= {"labelled": False}
        self._as_learnt.chosen_ = {**recogniser.chosen_, "remount": report}
        self._taught = learnt.taught
        nothing = np.zeros((0, learnt.memory.features.shape[1]))
        no_names = np.zeros((0, len(learnt.classes)))
        self._sums = SessionSums.of(nothing, no_names, self._taught)
        self.recogniser = self._as_learnt
        self.start()

    def start(
        self, prior: Mapping[str, float] | None = None, strangers: float = STRANGERS
    ) -> Self:
        """Begin an episode, with another object; see `ObjectRecogniser.start`."""
        self._begun = prior, strangers
        self._episode: list[Evidence] = []
        return self

    @property
    def n_touches(self) -> int:
        """Touches of the session so far that showed contact."""
        return self._sums.n_touches

    def update(self, touch: Touches | Array) -> Belief:
        """Take in one touch, or several, of the episode's object; return the belief.

        It is that of all touches of the episode, as what the session adds is known now.
        """
        seen = self._as_learnt.evidence(touch)
        counts = np.array([flag != NO_CONTACT for flag in seen.flags], dtype=bool)
        counts |= self._as_learnt.uses_no_contact_
        taken_for = softmax(seen.log_likelihood[counts], axis=1)
        self._sums = self._sums.plus(
            SessionSums.of(seen.features[counts], taken_for, self._taught)
        )
        self._episode.append(seen)
        if self._moves:
            shift = shift_unlabelled(self._sums, self._taught)
            now = copy(self._as_learnt)
            now.encoder_ = wrapped(now.encoder_).shifted(shift)
            self.recogniser = now
        else:
            shift = np.zeros_like(self._sums.features)
        belief = self.recogniser.start(*self._begun)
        for seen_before in self._episode:
            moved = seen_before.features + shift
            belief.update(
                self.recogniser.evidence_of(moved, seen_before.flags, seen_before.looks)
            )
        return belief
