"""`Touches`, the one currency of the library: images and what is known of each.

Columnar: arrays of equal length side by side, validated once. The raw images and
the no-contact image are kept as the sensor gave them; differences are derived.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import BytesIO
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import listed, nearest_path
from .._extras import needed
from .._types import FILMS, PICTURES, Array, Floats
from . import _columns
from ._archive import read_archive, write_archive
from ._columns import (
    LABELS,
    Arrays,
    TouchesError,
    check_layout,
    frame_summaries,
    frozen,
    trimmed,
)
from ._containers import CONTAINERS, RAW, container_arrays, raw_arrays
from ._folder import folder_arrays, no_contact_picture, shows_colour
from ._parquet import ENDINGS, is_parquet, parquet_parts
from ._tables import (
    CLOCK,
    COLUMN_NAMES,
    TABLES,
    TEXT_ENDINGS,
    csv_arrays,
    load_levels,
    table_arrays,
)

MAX_PIXELS = 50_000_000  # of one picture: any camera's
MAX_BYTES = 4 * 2**30  # of all images, 4 GiB: what a laptop holds
_LINE = 88  # columns of a terminal
# What is read, by the endings of files, and which of it each option is for.
_FOLDER, _PICTURE, _PARQUET = "a folder", "a picture", "Parquet"
_ARCHIVE, _ARRAY, _TABLE = "an archive", "an array", "a table"
_BARE, _OTHER = "bare frames", "a file of another program"
_KINDS = {
    **dict.fromkeys(PICTURES, _PICTURE),
    **dict.fromkeys((*TABLES, *TEXT_ENDINGS), _TABLE),
    **dict.fromkeys(CONTAINERS, _OTHER),
    **dict.fromkeys(RAW, _BARE),
    ".npy": _ARRAY,
    ".npz": _ARCHIVE,
}
_TAKEN_BY = {
    **dict.fromkeys(("name_pattern", "skip_bad", "colour"), (_FOLDER, _PICTURE)),
    "levels": (_FOLDER,),
    "shape": (_TABLE, _BARE),
    "dtype": (_BARE,),
    "channels": (_TABLE, _ARRAY, _BARE, _OTHER),
}


class Episode(NamedTuple):
    """The touches of one object in one session.

    `object` is its label or None, `session` its session or None, and `rows` the
    numbers of its touches in the order of the set.
    """

    object: str | None
    session: Any
    rows: NDArray[np.intp]


class Labelled:
    """Columns with one row per touch, some of them by their own names."""

    __slots__ = ()
    _columns: Arrays

    @staticmethod
    def _rising(rows: ArrayLike, n_touches: int) -> NDArray[np.intp]:
        """Return the places of touches that are picked, also by a mask."""
        places = np.arange(n_touches)[_columns.picked_rows(rows, n_touches)]
        if (np.diff(places) <= 0).any():
            raise TouchesError(
                "rows must be increasing indices of the touches, got others. "
                "Sort them and drop those that come twice."
            )
        return places

    @staticmethod
    def _move(rest: Array, own_rest: Array | None) -> Floats | None:
        """Return what brings images that rest at `own_rest` to rest at another frame.

        None where they have no such frame of that size.
        """
        if own_rest is None or own_rest.shape != rest.shape:
            return None
        # A taxel that was dead at rest stays as it is.
        return np.asarray(np.nan_to_num(rest.astype(float) - own_rest))

    @property
    def columns(self) -> Mapping[str, Array]:
        """Arrays with one row per touch, by name."""
        return MappingProxyType(self._columns)

    @property
    def object(self) -> NDArray[np.str_] | None:
        """Label of each touch, shape (n_touches,), or None."""
        return self.columns.get("object")

    @property
    def category(self) -> NDArray[np.str_] | None:
        """Category of each touch, shape (n_touches,), or None."""
        return self.columns.get("category")

    @property
    def order(self) -> Array | None:
        """Position of each touch in its recording, shape (n_touches,), or None."""
        return self.columns.get("order")

    @property
    def session(self) -> Array | None:
        """Session of each touch, shape (n_touches,), or None."""
        return self.columns.get("session")

    @property
    def subject(self) -> Array | None:
        """Person or unit of each touch, shape (n_touches,), or None."""
        return self.columns.get("subject")

    @property
    def no_contact(self) -> Array | None:
        """The frame of no contact, where one is known."""
        return None


class Touches(Labelled):
    """A set of touches: one image each, with columns of what is known of them.

    Parameters
    ----------
    images : array-like of shape (n_touches, n_rows, n_cols[, n_channels])
        Integers or floats in the sensor's own unit, negative values included. NaN
        marks a dead taxel, or a gap between pads, and is kept; infinity is refused.
    object : array-like of shape (n_touches,), optional
        What was touched: text, or integers, which become text.
    category : array-like of shape (n_touches,), optional
        The kind of thing it is.
    no_contact : array-like of shape (n_rows, n_cols[, n_channels]), optional
        The image of the sensor touching nothing.
    geometry : {"dome", "array", "plane", "none"}, optional
        How taxels lie; "none" says that their places mean nothing. Absent means
        find out.
    channels : array-like of shape (n_channels,), optional
        What the last axis of images holds, in its order: ["r", "g", "b"] for colour,
        ["x", "y", "z"] for forces. Needed where images have that axis.
    pads : array-like of shape (n_pads, 4), optional
        Arrays that lie side by side in one picture, in taxels: first row, first
        column, rows, columns. They must not overlap or leave the picture.
    pad_names : array-like of shape (n_pads,), optional
        What the pads are called, such as ["thumb", "index"].
    **columns : array-like
        `order`, `session`, `position_mm`, `position_raw`, `force_n`, `time_s`,
        `sensor`, `episode`, `press`, `frame` and `source_path` must have n_touches
        rows, and so must `press_frames` (n_touches, n_frames, n_rows, n_cols[,
        n_channels]), the frames of each press. `frame_index` and names beginning with
        `set_` belong to the whole set; `set_channels`, `set_pads` and `set_pad_names`
        are read as `channels`, `pads` and `pad_names`. Any other array is a column when
        it has n_touches rows, else it belongs to the whole set. None counts as absent.

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

    __slots__ = ("_columns", "_files", "_images", "_whole")
    _images: Array
    _whole: Arrays
    _files: Array | None

    def __init__(
        self,
        /,
        images: ArrayLike,
        *,
        object: ArrayLike | None = None,
        category: ArrayLike | None = None,
        no_contact: ArrayLike | None = None,
        geometry: ArrayLike | None = None,
        channels: ArrayLike | None = None,
        pads: ArrayLike | None = None,
        pad_names: ArrayLike | None = None,
        **columns: ArrayLike | None,
    ) -> None:
        by_name = {"object": object, "category": category, **columns}
        by_name.update(no_contact=no_contact, geometry=geometry)
        by_name.update(channels=channels, pads=pads, pad_names=pad_names)
        self._images = _columns.checked_images(images)
        self._columns, self._whole = _columns.sorted_out(by_name, self._images)
        check_layout(self._images, self._columns, self._whole)
        self._files = None

    @classmethod
    def _parted(cls, images: Array, columns: Arrays, whole: Arrays) -> Self:
        """Return touches of columns and of what describes them all, told apart."""
        checked = _columns.checked_images(images)
        parts = _columns.sorted_out({**columns, **whole}, checked, [*whole])
        check_layout(checked, *parts)
        return cls._of(checked, *parts)

    @classmethod
    def load(
        cls,
        path: str | PathLike[str],
        *,
        name_pattern: str | None = None,
        no_contact: str | PathLike[str] | None = None,
        levels: str | None = None,
        colour: bool = False,
        skip_bad: bool = False,
        shape: tuple[int, int] | None = None,
        dtype: str | None = None,
        channels: Sequence[str] | None = None,
        max_pixels: int = MAX_PIXELS,
        max_bytes: int = MAX_BYTES,
        progress: bool | None = None,
    ) -> Self:
        r"""Read a touch archive, a folder, a picture, an array or a table.

        Pictures of a folder, and of the folders in it, come in natural order of their
        paths (`img_2` before `img_10`), upright as their Exif orientation says; 16 bits
        stay 16 bits. Hidden files and files of other kinds are skipped.

        Parameters
        ----------
        path : path
            An archive (`.npz`; of plain arrays too, if one alone can be the images), a
            folder of pictures, of `.npy` or of CSV files, one touch each; a picture; an
            array (`.npy`), one touch if it has two axes; a CSV file or a text of
            columns (`.txt`, `.tsv`), one touch a line; Parquet (`.parquet`, `.pq`);
            HDF5 (`.h5`, `.hdf5`), `.zarr`, TIFF (one touch a page), `.mat` of MATLAB,
            `.bmp`, `.webp`; frames without a header (`.raw`, `.bin`, `.dat`).
        name_pattern : str, optional
            Of a folder, a regular expression, searched in each file name, else in its
            path within the folder. Named groups become columns: `object`, `category`
            and `session` (text), `n` or `order` (`order`, integers), `x`, `y`, `z`
            (`position_raw`), `x_mm`, `y_mm`, `z_mm` (`position_mm`), any other name
            (numbers where all are numbers, else text). Where it has no group `object`,
            folders give labels as they do without a pattern: one level of folders is
            the object; of more, the first is the category and the whole path the
            object; pictures that lie in no folder have no labels. A level of sessions
            (`mug/dataset_0`) is the session, and a last level that is the same
            everywhere (`frames`) is left out.
        no_contact : path, optional
            Picture of the sensor touching nothing, as large and deep as the others; it
            takes the place of one in the archive, and is no touch when it lies in the
            folder.
        levels : str, optional
            What each level of folders is, such as "object/session"; "-" skips a level,
            "=gel" reads its folder `gel` alone.
        colour : bool, default=False
            Read pictures in colour, as channels "r", "g" and "b"; one in grey is
            refused. Else colour becomes grey.
        skip_bad : bool, default=False
            Leave out pictures that cannot be read, differ from most or get no label,
            with a warning that names them.
        shape : (int, int), optional
            Of a CSV file, the rows and columns of its taxels; of frames without a
            header, theirs.
        dtype : str, optional
            Of frames without a header, the type of their numbers: "uint16", "<f4".
        channels : sequence of str, optional
            Of a table, frames without a header and files of other programs, what each
            taxel measures: its numbers follow each other, as ("x", "y", "z").
        max_pixels : int, default=50_000_000
            Largest picture to decode, in pixels.
        max_bytes : int, default=4 GiB
            Most memory that all images may take; of an archive before anything is
            inflated.
        progress : bool, optional
            Show a bar on standard error when decoding takes over two seconds; by
            default where standard error is a terminal.

        Raises
        ------
        TouchesError
            The file or folder cannot be read as touches; it names the file and fix. A
            picture is damaged, unlike the others or of a kind that is not read; a name
            does not match; folders label some pictures only, or hold the parts of a set
            (`train`, `test`) or the pictures of several cameras. Nothing is returned in
            part.

        Notes
        -----
        The path of each picture within a folder is kept as `source_path`. A JPEG has
        no checksum: one that is cut short is refused, flipped bits inside it may not
        be.

        Examples
        --------
        >>> pattern = r"img_(?P<n>\d+)_name_(?P<object>\w+?)_at_(?P<x>\d+)_"
        >>> touches = Touches.load("originals", name_pattern=pattern)  # doctest: +SKIP
        """
        kind, place = _kind_of(path), Path(path)
        channels = list(channels) if channels else None
        of_folders = {"name_pattern": name_pattern, "levels": levels, "colour": colour}
        of_tables = {"shape": shape, "dtype": dtype, "channels": channels}
        _refuse_options(path, kind, **of_folders, skip_bad=skip_bad, **of_tables)
        if kind in (_FOLDER, _PICTURE):
            how = (name_pattern, levels, no_contact, colour, skip_bad)
            arrays, files = folder_arrays(place, *how, max_pixels, max_bytes, progress)
            return cls(**arrays)._with_files(files)
        if kind == _PARQUET:
            parts = parquet_parts(path, max_bytes, max_pixels)
            held = (cls._parted(*part)._with_files(files) for part, files in parts)
            touches = cls._joined(held, max_bytes, warns=no_contact is None)
        elif kind == _ARCHIVE:
            touches = cls._of(*read_archive(place, max_bytes))
        elif kind == _BARE:
            touches = cls(**raw_arrays(place, shape, dtype, max_bytes, channels))
        elif kind == _TABLE:
            touches = cls(**csv_arrays(place, shape, max_bytes, channels))
        elif kind == _ARRAY:
            array = load_levels(place, max_bytes)
            touches = cls(array[None] if array.ndim == 2 else array, channels=channels)
        else:
            arrays = container_arrays(place, max_bytes, max_pixels)
            named = {"channels": np.array(channels)} if channels else {}
            touches = cls(**trimmed({**arrays, **named}))
        return touches.with_no_contact(no_contact, max_pixels)

    @classmethod
    def _joined(
        cls, parts: Iterable[Touches], max_bytes: int, *, warns: bool = False
    ) -> Self:
        """Put parts of one set together, with what describes all of them alike.

        It can warn where they have frames of no contact that differ.
        """
        held: list[Touches] = []
        n_bytes = 0
        for part in parts:
            held.append(part)
            n_bytes += part.images.nbytes
            _columns.refuse_large("Touches held at once", n_bytes, max_bytes)
        same = _columns.common_whole([part._whole for part in held])
        plain = [part.without(*(part._whole.keys() - same.keys())) for part in held]
        differ = "no_contact" not in same
        if warns and differ and any("no_contact" in part._whole for part in held):
            warnings.warn(
                "Touches have one frame of no contact, got several in Parquet, which "
                "are left out. Read one recording at a time by read_parquet, or learn "
                "from ParquetTouches, which know all of them.",
                stacklevel=3,
            )
        joined = Touches.concatenate(plain)
        return cls._of(joined._images, joined._columns, joined._whole, joined._files)

    def with_no_contact(
        self, picture: str | PathLike[str] | None, max_pixels: int = MAX_PIXELS
    ) -> Self:
        """Return these touches with a picture of no contact, a JPEG or PNG.

        It must be as large and deep as they are, of at most `max_pixels`. None leaves
        them as they are.
        """
        if picture is None:
            return self
        like = self.images, self.channels, max_pixels
        return self.with_columns(no_contact=no_contact_picture(Path(picture), *like))

    @classmethod
    def from_frame(cls, frame: Any, shape: tuple[int, int] | None = None) -> Self:
        """Return the touches of a pandas data frame, one a row.

        Columns that `Touches` knows by name (also in capitals; `label` or `class` is
        the object where none is called so), or that hold text or times, are columns;
        all other numbers are taxels, in their order, `shape` (n_rows, n_cols) of them
        or else `TouchesError`. Text that lacks is empty. Names of columns must differ.
        Levels of the index called `object`, `category`, `session` or `subject` are too.
        """
        names = [*frame.index.names, *frame.columns]
        texts = (*LABELS, "session", "subject")
        levels = [n for n in frame.index.names if n in texts and names.count(n) == 1]
        frame = frame.reset_index(level=levels) if levels else frame
        counts = Counter(str(name) for name in frame.columns)
        if twice := [name for name, count in counts.items() if count > 1]:
            raise TouchesError(
                "frame must have columns of names that differ, got several called "
                f"{listed(twice, 3)}. Name them apart, such as with add_prefix."
            )
        table = {}
        for name in frame.columns:
            column, lacks = np.asarray(frame[name]), np.asarray(frame[name].isna())
            if column.dtype.kind == "O":  # texts; what else there is is refused by name
                texts = column[~lacks].tolist()
                if texts and all(isinstance(text, str) for text in texts):
                    column = np.where(lacks, "", column)
                column = np.asarray(column.tolist())
            table[str(name)] = column
        return cls(**trimmed(table_arrays(table, shape)))

    def to_frame(self) -> Any:
        """Return the columns as a pandas data frame, one row per touch.

        Of a column with several values a touch each has a name with its number.
        """
        pandas = needed("pandas", "frame", "A data frame")
        flat: Arrays = {}
        for name, column in self._columns.items():
            parts = column.reshape(len(self), -1).T
            numbered = [f"{name}_{n}" for n in range(len(parts))]
            flat |= zip(numbered if column.ndim > 1 else [name], parts, strict=True)
        return pandas.DataFrame(flat)

    def save(self, path: str | PathLike[str]) -> None:
        """Write a touch archive (`.npz`): all of it or nothing.

        Raises
        ------
        TouchesError
            The name does not end in `.npz`, or the file cannot be written; an archive
            that was there before stays whole.
        """
        write_archive(Path(path), self._images, self._columns, self._whole)

    @staticmethod
    def concatenate(sets: Iterable[Any]) -> Touches:
        """Put sets of touches after one another, or name what keeps them apart.

        They need images of one size and type, the same columns, and the same
        entries for the whole set.
        """
        parts = list(sets)
        if not parts:
            raise TouchesError("concatenate must be given touches, got an empty list.")
        odd = [type(part).__name__ for part in parts if not isinstance(part, Touches)]
        if odd:
            raise TypeError(f"concatenate must be given Touches, got {odd[0]}.")
        images = _columns.joined_images([part.images for part in parts])
        columns = _columns.joined_columns([part._columns for part in parts])
        whole = _columns.joined_whole([part._whole for part in parts])
        files = [part._files for part in parts if part._files is not None]
        joined = np.concatenate(files) if len(files) == len(parts) else None
        return Touches._of(images, columns, whole, joined)

    @classmethod
    def _of(
        cls, images: Array, columns: Arrays, whole: Arrays, files: Array | None = None
    ) -> Self:
        touches = cls.__new__(cls)
        touches._files = files
        touches._images = frozen(images)
        touches._columns = {name: frozen(column) for name, column in columns.items()}
        touches._whole = {name: frozen(array) for name, array in whole.items()}
        return touches

    def __reduce__(self) -> tuple[Any, ...]:
        return self._of, (self._images, self._columns, self._whole, self._files)

    @property
    def images(self) -> Array:
        """Images (n_touches, n_rows, n_cols[, n_channels]), as the sensor gave them."""
        return self._images

    @property
    def files(self) -> Array | None:
        """Bytes of the JPEG or PNG that each image was decoded from, or None.

        Shape (n_touches,), of objects; a library keeps these instead of the images.
        """
        return self._files

    @property
    def unknown_names(self) -> list[str]:
        """Names of columns of numbers that are no clocks, nor known to palpate."""
        numbers = [n for n, c in self._columns.items() if c.dtype.kind in "iuf"]
        return [n for n in numbers if n not in COLUMN_NAMES and not CLOCK.fullmatch(n)]

    def hides_colour(self) -> bool:
        """Tell whether the first picture shows colour, and was read in grey."""
        if self._files is None or self.channels is not None:
            return False
        return shows_colour(BytesIO(self._files[0]))

    def _with_files(self, files: Sequence[bytes] | None) -> Self:
        """Return the touches with the files they were decoded from."""
        kept = None
        if files is not None:
            kept = np.empty(len(self), dtype=np.object_)
            kept[:] = files
        return self._of(self._images, self._columns, self._whole, kept)

    @property
    def whole(self) -> Mapping[str, Array]:
        """Arrays that describe the whole set, by name."""
        return MappingProxyType(self._whole)

    @property
    def touch_id(self) -> NDArray[np.str_] | None:
        """Id of each touch in a library, shape (n_touches,), or None."""
        return self._columns.get("touch_id")

    @property
    def no_contact(self) -> Array | None:
        """Image of no contact, shape (n_rows, n_cols[, n_channels]), or None."""
        return self._whole.get("no_contact")

    @property
    def geometry(self) -> str | None:
        """Arrangement of taxels ("dome", "array", "plane" or "none"), or None."""
        geometry = self._whole.get("geometry")
        return None if geometry is None else str(geometry)

    @property
    def channels(self) -> tuple[str, ...] | None:
        """Names of the last axis of images, in its order, or None without one."""
        names = self._whole.get("channels")
        return None if names is None else tuple(names.tolist())

    @property
    def pads(self) -> Array | None:
        """First row, first column, rows, columns of each pad, (n_pads, 4), or None."""
        return self._whole.get("pads")

    @property
    def pad_names(self) -> tuple[str, ...] | None:
        """Names of the pads, or None."""
        names = self._whole.get("pad_names")
        return None if names is None else tuple(names.tolist())

    def __len__(self) -> int:
        return len(self._images)

    def __getitem__(self, index: int | slice | ArrayLike) -> Self:
        """Pick touches by number, slice, mask or array of numbers."""
        rows = _columns.picked_rows(index, len(self))
        columns = {name: column[rows] for name, column in self._columns.items()}
        files = None if self._files is None else self._files[rows]
        return self._of(self._images[rows], columns, self._whole, files)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        """Return the images, so that `np.asarray(touches)` gives them."""
        return np.array(self._images, dtype, copy=copy)

    def __iter__(self) -> Iterator[Self]:
        return (self[touch] for touch in range(len(self)))

    def __repr__(self) -> str:
        size = " x ".join(map(str, self._images.shape[1:]))
        counted = {"object": "objects", "category": "categories", "session": "sessions"}
        kinds = [
            f"{n} {column if n == 1 else many}"
            for column, many in counted.items()
            if column in self._columns and (n := len(np.unique(self._columns[column])))
        ]
        line = f"<Touches: {len(self)} of {size} {self._images.dtype}; "
        line += ", ".join(kinds) or "no labels"
        held = {"columns": self._columns, "whole set": self._whole}
        held = {what: names for what, names in held.items() if names}
        listed = "".join(f"; {what}: {', '.join(held[what])}" for what in held)
        if len(line + listed) >= _LINE or not listed.isprintable():
            listed = "".join(f"; {what}: {len(held[what])}" for what in held)
        return f"{line}{listed}>"

    def _repr_html_(self) -> str:
        """Return a table of what is in the set, and the first few pictures."""
        from ._html import touches_html

        return touches_html(self._images, self._columns, self._whole)

    def plot(self, most: int = 12) -> Array:
        """Draw the first touches, at most so many.

        Returns matplotlib's axes (extra `plot`), shape (n_rows, n_cols), one a touch;
        those of the last row that stay empty are off. Dead taxels (NaN) are white.
        """
        from ._html import touches_axes

        return touches_axes(self._images, self._columns, self._whole, most)

    def with_columns(self, **columns: ArrayLike) -> Self:
        """Return these touches with columns added or replaced.

        Names of the whole set (`no_contact`, `geometry`, `pads`, `set_...`) are
        welcome.
        """
        if "images" in columns:
            raise TouchesError(
                "images must not be given as a column. "
                "Build Touches(images, **touches.columns, **touches.whole)."
            )
        added, changed = _columns.sorted_out(columns, self._images, None)
        kept = {name: a for name, a in self._whole.items() if name not in added}
        parts = {**self._columns, **added}, {**kept, **changed}
        check_layout(self._images, *parts)
        return self._of(self._images, *parts, self._files)

    def without(self, *names: str) -> Self:
        """Return these touches without the columns or whole-set entries named."""
        held = {**self._columns, **self._whole}
        if odd := [name for name in names if name not in held]:
            raise TouchesError(
                f"without must be given names of this set "
                f"({', '.join(held) or 'it has none'}), got {odd[0]!r}."
            )
        columns = {n: a for n, a in self._columns.items() if n not in names}
        whole = {n: a for n, a in self._whole.items() if n not in names}
        check_layout(self._images, columns, whole)
        return self._of(self._images, columns, whole, self._files)

    def with_frame_summaries(self) -> Self:
        """Return these touches with summaries of `press_frames` as their images.

        Images get a channel for each summary: "peak", the frame of greatest total load
        (in the sensor's unit); "hold", the mean of the frames whose load above that of
        the first frame is at least 80 % of the peak's; "loading", the peak frame minus
        the first one, per frame between them, 0 where the peak is the first. Of images
        with channels each gets its own ("peak r"). NaN stays NaN. `no_contact` becomes
        that of touching nothing all along; `press_frames` are left out.

        Raises
        ------
        TouchesError
            The touches have no `press_frames`.
        """
        frames = self._columns.get("press_frames")
        if frames is None:
            raise TouchesError(
                "with_frame_summaries must have press_frames, got touches without. "
                "Give them: touches.with_columns(press_frames=frames)."
            )
        names = [f" {name}" for name in self.channels or ()] or [""]
        channels = [f"{what}{name}" for what in _columns.SUMMARIES for name in names]
        whole: dict[str, Any] = {**self._whole, "channels": channels}
        if self.no_contact is not None:
            whole["no_contact"] = frame_summaries(self.no_contact[None, None])[0]
        columns = {n: a for n, a in self._columns.items() if n != "press_frames"}
        return type(self)(frame_summaries(frames), **columns, **whole)

    def differences(self) -> Array:
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
        lacks = [None] * len(self)
        objects = lacks if self.object is None else self.object.tolist()
        sessions = lacks if self.session is None else self.session.tolist()
        rows: dict[tuple[Any, Any], list[int]] = {}
        for row, (name, session) in enumerate(zip(objects, sessions, strict=True)):
            key = session if session == session else "NaN"  # which equals nothing
            rows.setdefault((name, key), []).append(row)
        return [
            Episode(name, sessions[places[0]], np.array(places))
            for (name, _), places in rows.items()
        ]


def _kind_of(path: str | PathLike[str]) -> str:
    """Return what is to be read; refuse what is no touches, or not there."""
    place = Path(path)
    ending = place.suffix.lower()
    if is_parquet(path):
        return _PARQUET
    if place.is_dir() and ending != ".zarr":
        return _FOLDER
    if ending in _KINDS and (place.is_file() or place.is_dir()):
        return _KINDS[ending]
    if not place.exists():
        raise TouchesError(
            f"{place} must be a file or folder of touches, got nothing there. "
            f"{nearest_path(place) or 'Check the path.'}"
        )
    if ending in FILMS:
        raise TouchesError(
            f"{place} must be cut into touches, got a film. Read it by "
            "sensors.TouchDetector().touches_in."
        )
    others = [kind for kind in (*_KINDS, *ENDINGS) if kind != ".npz"]
    raise TouchesError(
        f"{place} must be a touch archive (.npz), a folder, or one of "
        f"{', '.join(others)}, got another kind of file. Convert it."
    )


def _refuse_options(path: str | PathLike[str], kind: str, **options: Any) -> None:
    """Refuse options that say nothing to a kind of file."""
    for name, value in options.items():
        if value is not None and value is not False and kind not in _TAKEN_BY[name]:
            raise TouchesError(
                f"{name} must be left out for {kind}, got {value!r} with {path}. "
                f"It is for {' and '.join(_TAKEN_BY[name])}."
            )
