"""`Touches`, the one currency of the library: images and what is known of each.

Columnar: arrays of equal length side by side, validated once. The raw images and
the no-contact image are kept as the sensor gave them; differences are derived.
"""

from collections.abc import Iterable, Iterator, Mapping
from os import PathLike
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._columns import (
    Arrays,
    belongs_to_whole,
    checked_column,
    checked_images,
    frozen,
    plain_array,
    sorted_out,
)
from ._errors import TouchesError
from ._joining import joined_columns, joined_images, joined_whole
from ._picking import picked_rows

MAX_PIXELS = 50_000_000
MAX_BYTES = 4 * 2**30


class Episode(NamedTuple):
    """The touches of one object in one session.

    `object` is its label or None, `session` its session or None, and `rows` the
    numbers of its touches in the order of the set.
    """

    object: str | None
    session: Any
    rows: NDArray[np.intp]


class Touches:
    """A set of touches: one image each, with columns of what is known of them.

    Parameters
    ----------
    images : array-like of shape (n_touches, n_rows, n_cols)
        Integers or floats in the sensor's own unit, negative values included. NaN
        marks a dead taxel and is kept; infinity is refused.
    object : array-like of shape (n_touches,), optional
        What was touched: text, or integers, which become text.
    category : array-like of shape (n_touches,), optional
        The kind of thing it is.
    no_contact : array-like of shape (n_rows, n_cols), optional
        The image of the sensor touching nothing.
    geometry : {"dome", "array", "plane", "none"}, optional
        How taxels lie; "none" says that their places mean nothing. Absent means
        find out.
    **columns : array-like
        `order`, `session`, `position_mm`, `position_raw`, `force_n`, `time_s`,
        `sensor`, `episode`, `press`, `frame` and `source_path` must have n_touches
        rows. `frame_index` and names beginning with `set_` belong to the whole set.
        Any other array is a column when it has n_touches rows, else it belongs to
        the whole set. None counts as absent.

    Raises
    ------
    TouchesError
        An array is not what its name promises; the message names it and the fix.

    Notes
    -----
    The arrays are read-only views of what was given, not copies: do not write to
    the originals afterwards. `Touches(images, **t.columns, **t.whole)` makes the
    same set with other images.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate import Touches
    >>> Touches(np.ones((2, 10, 10)), object=["cup", "cup"], force_n=[0.7, 0.8])
    <Touches: 2 of 10 x 10 float64; 1 object; columns: object, force_n>
    """

    __slots__ = ("_columns", "_images", "_whole")
    _images: NDArray[Any]
    _columns: Arrays
    _whole: Arrays

    def __init__(
        self,
        /,
        images: ArrayLike,
        *,
        object: ArrayLike | None = None,
        category: ArrayLike | None = None,
        no_contact: ArrayLike | None = None,
        geometry: ArrayLike | None = None,
        **columns: ArrayLike | None,
    ) -> None:
        given = {"object": object, "category": category, **columns}
        given.update(no_contact=no_contact, geometry=geometry)
        self._images = checked_images(images)
        self._columns, self._whole = sorted_out(given, self._images)

    @classmethod
    def load(
        cls,
        path: str | PathLike[str],
        *,
        name_pattern: str | None = None,
        no_contact: str | PathLike[str] | None = None,
        max_pixels: int = MAX_PIXELS,
        max_bytes: int = MAX_BYTES,
        progress: bool | None = None,
    ) -> "Touches":
        """Read a touch archive (`.npz`) or a folder of pictures.

        Parameters
        ----------
        path : path
            The archive or the folder.
        name_pattern : str, optional
            For folders: see `read_folder`.
        no_contact : path, optional
            Picture of the sensor touching nothing; it takes the place of one in
            the archive, and is no touch when it lies in the folder.
        max_pixels : int, default=50_000_000
            Largest picture to decode, in pixels.
        max_bytes : int, default=4 GiB
            Most memory that the arrays may take.
        progress : bool, optional
            Show a bar on standard error when decoding takes over two seconds; by
            default where standard error is a terminal.

        Raises
        ------
        TouchesError
            The file or folder cannot be read as touches; it names the file and fix.
        """
        from ._loading import load

        return load(path, name_pattern, no_contact, max_pixels, max_bytes, progress)

    def save(self, path: str | PathLike[str]) -> None:
        """Write a touch archive (`.npz`): all of it or nothing."""
        from ._archive import write_archive

        write_archive(path, self)

    @staticmethod
    def concatenate(sets: Iterable[Any]) -> "Touches":
        """Put sets of touches after one another, or name what keeps them apart.

        They need images of one size and type, the same columns, and the same
        entries for the whole set.
        """
        parts = list(sets)
        if not parts:
            raise TouchesError("concatenate must be given touches, got an empty list.")
        for part in parts:
            if not isinstance(part, Touches):
                kind = type(part).__name__
                raise TypeError(f"concatenate must be given Touches, got {kind}.")
        images = joined_images([part.images for part in parts])
        columns = joined_columns([part._columns for part in parts])
        return Touches._of(images, columns, joined_whole([p._whole for p in parts]))

    @classmethod
    def _of(cls, images: NDArray[Any], columns: Arrays, whole: Arrays) -> Self:
        """Make a set of arrays that are known to be right."""
        touches = cls.__new__(cls)
        touches._images = frozen(images)
        touches._columns = {name: frozen(column) for name, column in columns.items()}
        touches._whole = {name: frozen(array) for name, array in whole.items()}
        return touches

    def __reduce__(self) -> tuple[Any, ...]:
        return self._of, (self._images, self._columns, self._whole)

    @property
    def images(self) -> NDArray[Any]:
        """Images of shape (n_touches, n_rows, n_cols), as the sensor gave them."""
        return self._images

    @property
    def columns(self) -> Mapping[str, NDArray[Any]]:
        """Arrays with one row per touch, by name."""
        return MappingProxyType(self._columns)

    @property
    def whole(self) -> Mapping[str, NDArray[Any]]:
        """Arrays that describe the whole set, by name."""
        return MappingProxyType(self._whole)

    @property
    def object(self) -> NDArray[np.str_] | None:
        """Label of each touch, shape (n_touches,), or None."""
        return self._columns.get("object")

    @property
    def category(self) -> NDArray[np.str_] | None:
        """Category of each touch, shape (n_touches,), or None."""
        return self._columns.get("category")

    @property
    def order(self) -> NDArray[Any] | None:
        """Position of each touch in its recording, shape (n_touches,), or None."""
        return self._columns.get("order")

    @property
    def session(self) -> NDArray[Any] | None:
        """Session of each touch, shape (n_touches,), or None."""
        return self._columns.get("session")

    @property
    def touch_id(self) -> NDArray[np.str_] | None:
        """Where each touch lies in a library, shape (n_touches,), or None."""
        return self._columns.get("touch_id")

    @property
    def no_contact(self) -> NDArray[Any] | None:
        """Image of no contact, shape (n_rows, n_cols), or None."""
        return self._whole.get("no_contact")

    @property
    def geometry(self) -> str | None:
        """How taxels lie ("dome", "array", "plane" or "none"), or None."""
        geometry = self._whole.get("geometry")
        return None if geometry is None else str(geometry)

    def __len__(self) -> int:
        return len(self._images)

    def __getitem__(self, index: int | slice | ArrayLike) -> Self:
        """Pick touches by number, slice, mask or array of numbers."""
        rows = picked_rows(index, len(self))
        columns = {name: column[rows] for name, column in self._columns.items()}
        return self._of(self._images[rows], columns, self._whole)

    def __iter__(self) -> Iterator[Self]:
        return (self[touch] for touch in range(len(self)))

    def __repr__(self) -> str:
        n_rows, n_cols = self._images.shape[1:]
        parts = [f"{len(self)} of {n_rows} x {n_cols} {self._images.dtype}"]
        counted = {"object": "objects", "category": "categories", "session": "sessions"}
        kinds = [
            f"{n} {one if n == 1 else many}"
            for one, many in counted.items()
            if one in self._columns and (n := len(np.unique(self._columns[one])))
        ]
        parts += [", ".join(kinds)] if kinds else ["no labels"]
        parts += [f"columns: {', '.join(self._columns)}"] if self._columns else []
        parts += [f"whole set: {', '.join(self._whole)}"] if self._whole else []
        return f"<Touches: {'; '.join(parts)}>"

    def with_columns(self, **columns: ArrayLike) -> Self:
        """Return these touches with columns added or replaced.

        Names of the whole set (`no_contact`, `geometry`, `set_...`) are welcome.
        """
        for name, value in columns.items():
            if name == "images":
                raise TouchesError(
                    "images must not be given as a column. "
                    "Build Touches(images, **touches.columns, **touches.whole)."
                )
            if not belongs_to_whole(name):
                checked_column(name, plain_array(name, value), len(self))
        added, changed = sorted_out(columns, self._images)
        kept = {name: a for name, a in self._whole.items() if name not in added}
        return self._of(self._images, {**self._columns, **added}, {**kept, **changed})

    def without(self, *names: str) -> Self:
        """Return these touches without the columns or whole-set entries named."""
        held = {**self._columns, **self._whole}
        for name in names:
            if name not in held:
                raise TouchesError(
                    f"without must be given names of this set "
                    f"({', '.join(held) or 'it has none'}), got {name!r}."
                )
        columns = {n: a for n, a in self._columns.items() if n not in names}
        whole = {n: a for n, a in self._whole.items() if n not in names}
        return self._of(self._images, columns, whole)

    def differences(self) -> NDArray[Any]:
        """Return images minus the no-contact image, signed floats of the same shape.

        float32 holds 8- and 16-bit images exactly; wider ones give float64.
        """
        no_contact = self.no_contact
        if no_contact is None:
            raise TouchesError(
                "differences must have a no_contact image, got none. "
                "Give one: touches.with_columns(no_contact=image)."
            )
        dtype = np.result_type(self._images.dtype, no_contact.dtype, np.float32)
        return np.subtract(self._images, no_contact, dtype=dtype)

    def episodes(self) -> list[Episode]:
        """Group the touches by object and session, in the order of the set.

        Touches without labels are one episode per session, their object None.
        """
        groups = np.zeros(len(self), dtype=np.intp)
        for labels in (self.object, self.session):
            if labels is not None:
                codes = np.unique(labels, return_inverse=True)[1]
                groups = groups * (codes.max() + 1) + codes
        by_group = np.argsort(groups, kind="stable")
        cuts = np.flatnonzero(np.diff(groups[by_group])) + 1
        return [
            Episode(
                None if self.object is None else str(self.object[rows[0]]),
                None if self.session is None else self.session[rows[0]].item(),
                rows,
            )
            for rows in sorted(np.split(by_group, cuts), key=lambda rows: rows[0])
        ]
