"""What a recogniser has learnt of touches, before beliefs are made of it."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, Self

import numpy as np

from .._parallel import on_one_thread
from .._types import Array, Bools, Indices
from ..classifiers import TouchClassifier
from . import _sessions
from ._contact import ContactCheck
from ._memory import Memory
from ._remounted_encoder import AnyEncoder


@dataclass(frozen=True)
class Learnt:
    """What a recogniser has learnt of touches; it never changes.

    Attributes
    ----------
    encoder : TouchEncoder or RemountedEncoder
        Touches -> features.
    contact : ContactCheck
        Tells touches without contact.
    classifier : TouchClassifier
        Features -> log-likelihoods.
    memory : Memory
        What is kept of the training touches.
    uses_no_contact : bool
        Whether touches without contact count.
    """

    encoder: AnyEncoder
    contact: ContactCheck
    classifier: TouchClassifier
    memory: Memory
    uses_no_contact: bool

    def relearnt(self, memory: Memory) -> Self:
        """Return this with a memory that the classifier has learnt anew."""
        return replace(self, memory=memory, classifier=self.refitted(memory))

    def refitted(self, memory: Memory) -> TouchClassifier:
        """Return the classifier, learnt anew from a memory; its choices stay."""
        again, blocks = copy(self.classifier), memory.blocks
        more = {}
        if self.takes_weights and (memory.weights != 1).any():
            more["weights"] = memory.weights
        with on_one_thread():
            return again.refit(memory.features, memory.labels, groups=blocks, **more)

    @property
    def takes_weights(self) -> bool:
        """Whether the classifier learns what each touch counts."""
        return bool(getattr(self.classifier, "takes_weights", False))

    @property
    def classes(self) -> Array:
        """The labels, sorted."""
        return self.memory.classes

    @cached_property
    def codes(self) -> Indices:
        """The column of each training touch's label."""
        return np.searchsorted(self.classes, self.memory.labels)

    @cached_property
    def counted(self) -> Bools:
        """Which training touches count; all of objects that show no contact."""
        labels = self.memory.labels
        counts = ~self.memory.nothing | self.uses_no_contact
        return np.asarray(counts | ~np.isin(labels, labels[counts]))

    @property
    def parts(self) -> _sessions.Parts:
        """Where the features of each encoding begin."""
        return _sessions.Parts(np.cumsum([0, *self.encoder.parts_.values()]))

    @cached_property
    def taught(self) -> _sessions.Taught:
        """The training touches that count, for comparing a session with them."""
        memory, counts = self.memory, self.counted
        return _sessions.Taught(
            memory.features[counts],
            self.codes[counts],
            self.parts,
        )


class HasLearnt(Protocol):
    """A recogniser, as far as what it has learnt of touches is asked for."""

    def learnt(self) -> Learnt:
        """Return what it has learnt of touches."""
