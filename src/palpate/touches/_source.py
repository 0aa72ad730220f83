"""Touches that are read as they are needed: learning from more than memory holds."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from .._types import Array, Floats
from ._touches import Touches


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
    def order(self) -> Array | None: ...

    @property
    def session(self) -> Array | None: ...

    @property
    def touch_id(self) -> NDArray[np.str_] | None: ...

    def __len__(self) -> int: ...

    def __getitem__(self, rows: NDArray[np.intp]) -> "TouchSource":
        """Pick touches by their rows, which rise; no image is read."""
        ...

    def touches(self, rows: NDArray[np.intp]) -> Touches:
        """Read the touches in these rows, which rise."""
        ...

    def features(self, key: str, encode: Callable[[Touches], Floats]) -> Floats:
        """Return features of all touches, made by `encode` or kept under `key`."""
        ...
