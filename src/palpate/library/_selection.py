"""Touches chosen from a library, read piece by piece."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..touches import Touches
from ._database import Database
from ._errors import LibraryError
from ._features import Encode, Floats, stored_features, touch_ids
from ._reading import common_shape, read_columns, read_touches, read_whole

_NO_LIMIT = 2**62


class Selection:
    """Touches of a library without their images, in the order added.

    Made by `TouchLibrary.select`; the library must stay open. What is added later is
    not in it.

    Attributes
    ----------
    columns : dict of ndarray
        Columns of short values, one row per touch.
    """

    def __init__(
        self, database: Database, folder: Path, numbers: NDArray[np.int64]
    ) -> None:
        self._database, self._folder, self._numbers = database, folder, numbers
        common_shape(database, numbers)
        self.columns = read_columns(database, folder, numbers, wide=False)

    def __len__(self) -> int:
        return len(self._numbers)

    def __repr__(self) -> str:
        return f"<Selection: {len(self)} touches of {str(self._folder)!r}>"

    @property
    def object(self) -> NDArray[np.str_] | None:
        """Label of each touch, shape (n_touches,), or None."""
        return self.columns.get("object")

    @property
    def category(self) -> NDArray[np.str_] | None:
        """Category of each touch, shape (n_touches,), or None."""
        return self.columns.get("category")

    @property
    def order(self) -> NDArray[Any] | None:
        """Position of each touch in its recording, shape (n_touches,), or None."""
        return self.columns.get("order")

    @property
    def session(self) -> NDArray[Any] | None:
        """Session of each touch, shape (n_touches,), or None."""
        return self.columns.get("session")

    @property
    def touch_id(self) -> NDArray[np.str_]:
        """Id of each touch, shape (n_touches,): 32 hexadecimal digits."""
        return touch_ids(self._database, self._numbers)

    @property
    def whole(self) -> dict[str, NDArray[Any]]:
        """What describes all of the touches alike, by name; see `Touches`."""
        return read_whole(self._database, self._folder, self._numbers)

    def __getitem__(self, rows: ArrayLike) -> "Selection":
        """Pick touches by their places, which must rise; no image is read."""
        return Selection(self._database, self._folder, self._picked(rows))

    def touches(self, rows: ArrayLike) -> Touches:
        """Read some of the touches, given by their places in the selection.

        Places must rise; each is read once.
        """
        chosen = self._picked(rows)
        return read_touches(self._database, self._folder, chosen, _NO_LIMIT)

    def features(self, key: str, encode: Encode) -> Floats:
        """Return features of all touches, (n_touches, n_features).

        Parameters
        ----------
        key : str
            Letters and digits that stand for the encoder and all it has learnt;
            features under one key are computed once and then read.
        encode : callable
            Makes features (n, n_features) of `Touches`; called for what is new, some
            hundreds at a time, through joblib: see `stored_features`.
        """
        return stored_features(self._database, self._folder, self._numbers, key, encode)

    def _picked(self, rows: ArrayLike) -> NDArray[np.int64]:
        places = np.asarray(rows)
        if places.ndim != 1 or (len(places) > 1 and (np.diff(places) <= 0).any()):
            raise LibraryError(
                "rows must be places in the selection that rise, got others. "
                "Sort them and drop those that come twice."
            )
        return self._numbers[places]
