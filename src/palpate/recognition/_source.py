"""Touches that are read as they are needed: learning from more than memory holds."""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ..touches import Touches
from ._choice import choose_encoder
from ._encoder import TouchEncoder
from ._known import KNOWN_CLASSES
from ._model_file import state_digest
from ._presets import Preset
from ._sequence import Floats

# An encoding is learnt from this many touches of a source, the same number of each
# label where there are enough.
SHOWN = 2000


@runtime_checkable
class TouchSource(Protocol):
    """Labelled touches whose images are read piece by piece.

    `palpate.library.Selection` is one; the properties are as in `Touches`.
    """

    @property
    def object(self) -> NDArray[np.str_] | None: ...

    @property
    def category(self) -> NDArray[np.str_] | None: ...

    @property
    def order(self) -> NDArray[Any] | None: ...

    @property
    def session(self) -> NDArray[Any] | None: ...

    def __len__(self) -> int: ...

    def touches(self, rows: NDArray[np.intp]) -> Touches:
        """Read the touches in these rows, which rise."""
        ...

    def features(self, key: str, encode: Callable[[Touches], Floats]) -> Floats:
        """Return features of all touches, made by `encode` or kept under `key`."""
        ...


def shown_rows(labels: NDArray, n_shown: int = SHOWN) -> NDArray[np.intp]:
    """Return rows spread evenly over each label, at most about `n_shown` in all."""
    codes, counts = np.unique(labels, return_inverse=True, return_counts=True)[1:]
    share = max(2, n_shown // len(counts))
    by_label = np.split(np.argsort(codes, kind="stable"), np.cumsum(counts)[:-1])
    chosen = [
        rows[np.unique(np.linspace(0, len(rows) - 1, share).round().astype(int))]
        for rows in by_label
    ]
    return np.sort(np.concatenate(chosen))


def fit_encoder(
    preset: Preset,
    touches: Touches | TouchSource,
    labels: NDArray,
    group: NDArray,
    seed: int,
) -> tuple[TouchEncoder, dict[str, Any], Floats]:
    """Choose and learn an encoding; return it, the reasons, and all features.

    Of a source, some touches of each label are shown to the encoder and the rest
    only pass through it; see `choose_encoder`.
    """
    if isinstance(touches, Touches):
        encoder, chosen = choose_encoder(preset, touches, labels, group, seed)
        return encoder, chosen, encoder.fit_transform(touches)
    rows = shown_rows(labels)
    shown = touches.touches(rows)
    encoder, chosen = choose_encoder(preset, shown, labels[rows], group[rows], seed)
    return encoder, chosen, encoded(encoder.fit(shown), touches)


def encoded(encoder: TouchEncoder, touches: Touches | TouchSource) -> Floats:
    """Return the features of touches or of all touches of a source."""
    if isinstance(touches, Touches):
        return encoder.transform(touches)
    key = state_digest(encoder, KNOWN_CLASSES)
    return touches.features(key, encoder.transform)
