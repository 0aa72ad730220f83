"""What a recogniser has learnt of touches, before beliefs are made of it.

Its encoder may serve in another session: what that does to touches is taken off.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from .._parallel import on_one_thread
from .._types import Array, Bools, Floats, Indices
from ..classifiers import TouchClassifier
from ..touches import Touches
from . import _sessions
from ._contact import ContactCheck
from ._encoder import Encoder, TouchEncoder
from ._memory import Memory


@dataclass(frozen=True)
class RemountedEncoder(Encoder):
    """An encoder, wrapped in what takes a session off: of images, features and looks.

    Another camera before the dome, another zero, gain or broken taxels are undone on
    the images; what else the session adds is taken off the features.

    Attributes
    ----------
    encoder : TouchEncoder
        As learnt; its clean-up cuts the images of this session.
    broken : ndarray of bool of the shape of a touch, or None
        Which taxels are stuck since it was learnt: they are filled from their
        neighbours.
    gain : float
        What images are multiplied by, to take off a sensor's other gain.
    drift : ndarray of the shape of a touch, or None
        What is added to images then: by how much the baseline was higher.
    look_offset : ndarray of shape (7,) or None
        What is added to looks, so that this session does not look like another one.
    weighing : ndarray of shape (n_features, n_features) or None
        What features are multiplied by, to weigh down how sessions differ.
    offset : ndarray of shape (n_features,) or None
        What is added to them then, to take off what this session adds.
    """

    encoder: TouchEncoder
    broken: Bools | None = None
    gain: float = 1.0
    drift: Array | None = None
    look_offset: Floats | None = None
    weighing: Floats | None = None
    offset: Floats | None = None

    @classmethod
    def of(cls, before: AnyEncoder, touches: Touches, gain: float = 1.0) -> Self:
        """Return an encoder for the session of `touches`, of one for another session.

        Where the rim is, what has broken since and how far rest has drifted is found
        anew; what is done to features stays.
        """
        earlier = wrapped(before)
        taught = earlier.encoder
        taught.check_channels(touches.images, touches.channels)
        if taught.clean_up_ is None:  # nothing finds the sensor in other images
            taught.check_size(touches.images)
        broken, drift = taught.stuck(touches), None
        if taught.baseline_ is not None and touches.no_contact is not None:
            now = taught.living(touches.no_contact[np.newaxis], broken)[0]
            drift = taught.baseline_ - gain * now.astype(np.float64)
        return cls(
            encoder=taught.before_another_camera(touches),
            broken=broken,
            gain=gain,
            drift=drift,
            weighing=earlier.weighing,
            offset=earlier.offset,
        )

    def weighed(self, weighing: Floats) -> Self:
        """Return this with its features multiplied by a matrix."""
        before, offset = self.weighing, self.offset
        return replace(
            self,
            weighing=weighing if before is None else before @ weighing,
            offset=None if offset is None else offset @ weighing,
        )

    def shifted(self, shift: Floats) -> Self:
        """Return this with (n_features,) added to its features."""
        before = self.offset
        return replace(self, offset=shift if before is None else shift + before)

    def clean(self, touches: Touches) -> Array:
        """Return the images as in the session of learning, after the clean-up."""
        images = touches.images
        self.encoder.check_size(images, touches.channels, touches.pads)
        images = self.encoder.living(images, self.broken)
        if self.gain != 1:
            images = self.gain * images
        if self.drift is not None:
            images = images + self.drift
        return self.encoder.cleaned(images)

    def encode_fully(self, cleaned: Array) -> tuple[Floats, Floats]:
        """Return features and what components leave out; see `Encoder`."""
        features, unexplained = self.encoder.encode_fully(cleaned)
        if self.weighing is not None:
            features = features @ self.weighing
        if self.offset is not None:
            features = features + self.offset
        return features, unexplained

    def look(self, touches: Touches) -> Floats:
        """Return looks, brought to those of the touches it was learnt from."""
        looks = self.encoder.look(touches, self.broken)
        return looks if self.look_offset is None else looks + self.look_offset

    def blank_touch(self) -> Touches:
        """Return one touch of zeros of this session's size."""
        return self.encoder.blank_touch()

    @property
    def image_shape_(self) -> tuple[int, ...]:
        """The size of this session's images."""
        return self.encoder.image_shape_

    @property
    def clean_up_(self) -> Any:
        """The clean-up, of this session's images."""
        return self.encoder.clean_up_

    @property
    def channels_(self) -> tuple[str, ...] | None:
        """What the channels are called."""
        return self.encoder.channels_

    @property
    def encodings_(self) -> dict[str, list[Any]]:
        """The encodings as learnt."""
        return self.encoder.encodings_

    @property
    def parts_(self) -> dict[str, int]:
        """Number of features of each encoding."""
        return self.encoder.parts_


AnyEncoder = TouchEncoder | RemountedEncoder


def wrapped(encoder: AnyEncoder) -> RemountedEncoder:
    """Return an encoder as one of another session, in which nothing is taken off."""
    return RemountedEncoder(encoder) if isinstance(encoder, TouchEncoder) else encoder


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
        refitted, blocks = copy(self.classifier), memory.blocks
        more = {}
        if self.takes_weights and (memory.weights != 1).any():
            more["weights"] = memory.weights
        with on_one_thread():
            return refitted.refit(memory.features, memory.labels, groups=blocks, **more)

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
        features, counts = self.memory.features, self.counted
        return _sessions.Taught(features[counts], self.codes[counts], self.parts)
