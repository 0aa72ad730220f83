"""Touches that are read as they are needed: learning from more than memory holds."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..touches import Touches, TouchSource
from ._choice import choose_encoder
from ._contact import NO_CONTACT, ContactCheck
from ._encoder import BATCH, TouchEncoder
from ._known import KNOWN_CLASSES
from ._model_file import state_digest
from ._presets import Preset
from ._sequence import Floats

# An encoding is learnt from this many touches of a source, the same number of each
# label where there are enough.
SHOWN = 2000


def shown_rows(labels: NDArray, n_shown: int = SHOWN) -> NDArray[np.intp]:
    """Return all rows, of many about `n_shown`, spread evenly over each label."""
    if len(labels) <= n_shown:
        return np.arange(len(labels))
    codes, counts = np.unique(labels, return_inverse=True, return_counts=True)[1:]
    share = max(2, n_shown // len(counts))
    by_label = np.split(np.argsort(codes, kind="stable"), np.cumsum(counts)[:-1])
    chosen = [
        rows[np.unique(np.linspace(0, len(rows) - 1, share).round().astype(int))]
        for rows in by_label
    ]
    return np.sort(np.concatenate(chosen))


@dataclass
class Learnt:
    """An encoding learnt from touches, and what it makes of them.

    `chosen` are the reasons for it; `features` (n_touches, n_features), `unexplained`
    and `nothing` (n_touches,) tell of all the touches, also where only some were shown
    to it.
    """

    encoder: TouchEncoder
    contact: ContactCheck
    chosen: dict[str, Any]
    features: Floats
    unexplained: Floats
    nothing: NDArray[np.bool_]


def learn_encoding(
    preset: Preset,
    touches: Touches | TouchSource,
    labels: NDArray,
    group: NDArray,
    seed: int,
) -> Learnt:
    """Choose and learn an encoding, and what contact looks like.

    Of a source, some touches of each label are shown to the encoder and the rest
    only pass through it; see `choose_encoder`.
    """
    if isinstance(touches, Touches):
        encoder, chosen = choose_encoder(preset, touches, labels, group, seed)
        cleaned = encoder.fit_clean(touches)
        contact = ContactCheck().fit(touches, encoder)
        nothing = contact.no_contact(touches, cleaned)
        both = encoder.fit_encode(cleaned, group)
        return Learnt(encoder, contact, chosen, *both, nothing)
    rows = shown_rows(labels)
    shown = touches.touches(rows)
    encoder, chosen = choose_encoder(preset, shown, labels[rows], group[rows], seed)
    left_out = encoder.fit_encode(encoder.fit_clean(shown), group[rows])[1]
    contact = ContactCheck().fit(shown, encoder)
    features, unexplained, nothing = encoded(encoder, contact, touches)
    unexplained[rows] = left_out
    return Learnt(encoder, contact, chosen, features, unexplained, nothing)


def encoded(
    encoder: TouchEncoder, contact: ContactCheck, touches: Touches | TouchSource
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return features of all touches, what is unexplained, and where is no contact."""

    def encode(some: Touches) -> Floats:
        features, unexplained, flags = encoded_and_flagged(encoder, contact, some)
        nothing = np.array(flags) == NO_CONTACT
        return np.column_stack([features, unexplained, nothing])

    if isinstance(touches, Touches):
        table = encode(touches)
    else:
        known = KNOWN_CLASSES
        key = state_digest(encoder, known) + state_digest(contact, known)
        table = touches.features(key, encode)
    return np.ascontiguousarray(table[:, :-2]), table[:, -2].copy(), table[:, -1] > 0


def encoded_and_flagged(
    encoder: TouchEncoder, contact: ContactCheck, touches: Touches
) -> tuple[Floats, Floats, list[str]]:
    """Clean once for all; so many at a time that memory stays bounded."""
    parts: list[tuple[Floats, Floats]] = []
    flags: list[str] = []
    for start in range(0, len(touches), BATCH):
        some = touches[start : start + BATCH]
        cleaned = encoder.clean(some)
        parts.append(encoder.encode_fully(cleaned))
        flags += contact.flags(some, cleaned)
    features, unexplained = zip(*parts, strict=True)
    return np.concatenate(features), np.concatenate(unexplained), flags
