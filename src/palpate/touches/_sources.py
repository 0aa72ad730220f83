"""Touches of Parquet, some at a time or none held.

Of Parquet that is learnt from without being held, labels and other short columns are
read at once, images block by block: a block is one row group of one file. Workers get
no image but the place of some blocks, which they read themselves; so every machine must
reach them by the same path or address.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._parallel import results_of
from .._types import Array, Floats, Indices
from ._columns import (
    Arrays,
    TouchesError,
    checked_column,
    common_whole,
)
from ._parquet import (
    file_stamp,
    is_parquet,
    parquet_files,
    parquet_index,
    parquet_parts,
    parquet_rows,
    url_of,
)
from ._touches import MAX_BYTES, MAX_PIXELS, Labelled, Touches

# Touches of one task, where row groups are smaller: encoding so few takes as long for
# each as more would, and two workers share them evenly.
_AT_ONCE = 128


@runtime_checkable
class TouchSource(Protocol):
    """Labelled touches whose images are read piece by piece.

    `TouchLibrary.select` returns one; the properties are as in `Touches`. One whose
    recordings have frames of no contact of their own may have `resting_at(frame)`: a
    source of the touches as if all had rested at that frame, or itself where they did.
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
    def subject(self) -> Array | None: ...

    @property
    def touch_id(self) -> NDArray[np.str_] | None: ...

    @property
    def no_contact(self) -> Array | None:
        """The frame of no contact, of several the newest."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, rows: NDArray[np.intp]) -> TouchSource:
        """Pick touches by their rows, which rise; no image is read."""
        ...

    def touches(self, rows: NDArray[np.intp]) -> Touches:
        """Read the touches in these rows, which rise."""
        ...

    def features(self, key: str, encode: Callable[[Touches], Floats]) -> Floats:
        """Return features of all touches, made by `encode` or kept under `key`."""
        ...


def read_parquet(
    path: str | PathLike[str],
    *,
    max_bytes: int = MAX_BYTES,
    max_pixels: int = MAX_PIXELS,
) -> Iterator[Touches]:
    """Read touches from Parquet some at a time, in their order.

    Parameters
    ----------
    path : path
        A file, a folder of them (`object=mug/part-0.parquet`), or an address of a
        store that fsspec knows, such as `s3://bucket/touches`.
    max_bytes : int, default=4 GiB
        Most bytes of one row group.
    max_pixels : int, default=50_000_000
        Largest picture to decode, in pixels.

    Yields
    ------
    Touches
        Up to 512 touches of one recording, with its no-contact image, pads and so on.

    Raises
    ------
    TouchesError
        It is no Parquet, or its columns are not those of touches.
    ImportError
        pyarrow or fsspec is missing; the message names the extra.
    """
    for parts, files in parquet_parts(path, max_bytes, max_pixels):
        yield Touches._parted(*parts)._with_files(files)


class _Blocks(NamedTuple):
    """Some row groups of a file, the first of their touches, and how many they have.

    `stamp` is what the file was like when it was opened.
    """

    name: str
    stamp: tuple[str, ...]
    groups: list[int]
    first: int
    n_rows: int


class ParquetTouches(Labelled):
    """Touches of Parquet without their images: a `TouchSource`.

    Parameters
    ----------
    path : path
        A file, a folder of them, or an address that fsspec knows.
    max_bytes, max_pixels
        As for `read_parquet`.

    Attributes
    ----------
    columns : dict of ndarray
        Columns of short values that all files have, one row per touch.
    whole : dict of ndarray
        What describes all of the touches alike.
    no_contact : ndarray or None
        The frame of no contact, of several that of the last touches.

    Raises
    ------
    TouchesError
        It is no Parquet of touches, or its images differ in size.
    """

    touch_id = None
    is_parquet = staticmethod(is_parquet)

    def __init__(
        self,
        path: str | PathLike[str],
        *,
        max_bytes: int = MAX_BYTES,
        max_pixels: int = MAX_PIXELS,
    ) -> None:
        place = path if url_of(path) is not None else Path(path).resolve()
        names = parquet_files(place)
        stamps = [file_stamp(name) for name in names]
        indices = [parquet_index(name) for name in names]
        n_touches = sum(sum(index.n_rows) for index in indices)
        if not n_touches:
            raise TouchesError(f"{path} must hold at least one touch, got none.")
        kinds = {index.kind: name for name, index in zip(names, indices, strict=True)}
        kinds.pop(None, None)
        if len(kinds) > 1:
            listed = "; ".join(f"{kind} in {name}" for kind, name in kinds.items())
            raise TouchesError(
                f"Images must have one size and type, got {listed}. Give the files of "
                "one sensor."
            )
        self._limits = max_bytes, max_pixels
        files = zip(names, stamps, [index.n_rows for index in indices], strict=True)
        self._blocks = list(_in_blocks(files))
        held = [index.columns for index in indices]
        common = [n for n in held[0] if all(n in others for others in held)]
        joined = {n: np.concatenate([c[n] for c in held]) for n in common}
        self._columns = {n: checked_column(n, c, n_touches) for n, c in joined.items()}
        self._rows = np.arange(n_touches)
        self._whole = [whole for index in indices for whole in index.whole]
        firsts = np.cumsum([0, *(len(index.whole) for index in indices)])
        numbers = zip(firsts, indices, strict=False)
        self._recordings = np.concatenate([n + i.numbers for n, i in numbers])
        self._rest: Array | None = None

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def whole(self) -> Arrays:
        """What describes all of the touches alike, by name; see `Touches`."""
        whole = common_whole([self._whole[key] for key in np.unique(self._recordings)])
        return whole if self._rest is None else {**whole, "no_contact": self._rest}

    @property
    def no_contact(self) -> Array | None:
        """The frame of no contact, of several that of the last touches, or None."""
        if self._rest is not None:
            return self._rest
        last_first = dict.fromkeys(self._recordings[::-1].tolist())
        frames = (self._whole[key].get("no_contact") for key in last_first)
        return next((frame for frame in frames if frame is not None), None)

    def resting_at(self, frame: Array) -> ParquetTouches:
        """Return these touches as if the sensor had rested at a frame in all of them.

        Images are floats: each less the no-contact image of its recording, where that
        has one of this size, and more the `frame`. Where all rest there it is `self`.
        """
        frames = (self._whole[k].get("no_contact") for k in np.unique(self._recordings))
        moves = (self._move(frame, own_frame) for own_frame in frames)
        if not any(move is not None and move.any() for move in moves):
            return self
        other = copy(self)
        other._rest = frame
        return other

    def __getitem__(self, rows: ArrayLike) -> ParquetTouches:
        """Pick touches by their rows, which must rise; no image is read."""
        places = self._rising(rows, len(self))
        other = copy(self)
        other._rows = self._rows[places]
        other._recordings = self._recordings[places]
        other._columns = {name: c[places] for name, c in self._columns.items()}
        return other

    def touches(self, rows: ArrayLike) -> Touches:
        """Read the touches in these rows, which rise; workers pick them."""
        chosen = self[rows]
        return Touches._joined(chosen._results(None), MAX_BYTES)

    def features(self, key: str, encode: Callable[[Touches], Floats]) -> Floats:
        """Return what `encode` makes of all touches, (n_touches, n_features).

        Nothing is kept under `key`.
        """
        parts = [np.asarray(part, np.float64) for part in self._results(encode)]
        return np.concatenate(parts)

    def _results(self, encode: Callable[[Touches], Floats] | None) -> Iterator[Any]:
        """Yield what workers encode, or the touches, some blocks at a time."""
        firsts = [blocks.first for blocks in self._blocks]
        cuts = np.searchsorted(self._rows, [*firsts, self._blocks[-1].first + 2**62])
        tasks: list[tuple[_Blocks, Indices | None]] = []
        for blocks, start, stop in zip(self._blocks, cuts, cuts[1:], strict=False):
            rows = self._rows[start:stop] - blocks.first
            if len(rows):
                tasks.append((blocks, None if len(rows) == blocks.n_rows else rows))
        reading = partial(_read, encode, self._limits, self._rest)
        batches = results_of(reading, len(tasks), tasks.__getitem__)
        return (part for batch in batches for part in batch)


def _in_blocks(
    files: Iterator[tuple[str, tuple[str, ...], list[int]]],
) -> Iterator[_Blocks]:
    """Yield the row groups of files, small ones together."""
    first = 0
    for name, stamp, counts in files:
        groups: list[int] = []
        n_rows = 0
        for number, count in enumerate(counts):
            groups.append(number)
            n_rows += count
            if n_rows >= _AT_ONCE or number == len(counts) - 1:
                yield _Blocks(name, stamp, groups, first, n_rows)
                first += n_rows
                groups, n_rows = [], 0


def _read(
    encode: Callable[[Touches], Floats] | None,
    limits: tuple[int, int],
    rest: Array | None,
    blocks: _Blocks,
    rows: Array | None,
) -> list[Any]:
    """Encode touches of some blocks, or read them, wherever this runs."""
    _refuse_changed(blocks)
    read = parquet_rows(blocks.name, *limits, blocks.groups, rows)
    touches = (_at_rest(Touches._parted(*parts), rest) for parts, _ in read)
    parts = [part if encode is None else encode(part) for part in touches]
    _refuse_changed(blocks)
    return parts


def _at_rest(touches: Touches, rest: Array | None) -> Touches:
    """Return touches as if the sensor had rested at a frame, if there is one."""
    if rest is None:
        return touches
    images = touches.images.astype(np.result_type(touches.images.dtype, np.float32))
    if (move := touches._move(rest, touches.no_contact)) is not None:
        images += move.astype(images.dtype)
    whole = {**touches.whole, "no_contact": rest}
    return Touches._parted(images, dict(touches.columns), whole)


def _refuse_changed(blocks: _Blocks) -> None:
    try:
        stamp = file_stamp(blocks.name)
    except FileNotFoundError as error:
        raise TouchesError(
            f"{blocks.name} must stay where it is while it is learnt from, on every "
            "machine that reads it, got nothing there. Give a path or an address that "
            "all workers reach."
        ) from error
    if stamp != blocks.stamp:
        raise TouchesError(
            f"{blocks.name} must stay as it is while it is learnt from, got one that "
            "was written meanwhile. Learn again when it is complete."
        )
