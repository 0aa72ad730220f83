"""What a set of touches may hold besides its images, and the checks on it.

A name decides first: `no_contact`, `frame_index`, `geometry` and names beginning
with `set_` belong to the whole set; the names in `COLUMNS` are columns and must
have one row per touch. Any other array is a column when it has one row per
touch, and belongs to the whole set when it does not.
"""

from collections.abc import Collection, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import check_option
from ._errors import TouchesError

Arrays = dict[str, NDArray[Any]]

LABELS = ("object", "category")
NUMBERS = ("order", "position_mm", "position_raw", "force_n", "time_s")
FLAT = (*LABELS, "order", "session", "time_s", "sensor", "episode", "press", "frame")
COLUMNS = frozenset((*FLAT, *NUMBERS, "source_path"))
WHOLE = frozenset(("no_contact", "frame_index", "geometry"))
GEOMETRIES = ("dome", "array", "plane", "none")
PLAIN_KINDS = "biufcSUMm"
_TAXELS_AT_ONCE = 2**22


def belongs_to_whole(name: str) -> bool:
    """Tell whether `name` alone says that an array describes the whole set."""
    return name in WHOLE or name.startswith("set_")


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view; the caller's own array stays as it is."""
    view = array.view()
    view.flags.writeable = False
    return view


def checked_images(images: ArrayLike) -> NDArray[Any]:
    """Return images (n_touches, n_rows, n_cols) read-only, or explain."""
    array = plain_array("images", images)
    if array.dtype.kind not in "biuf":
        raise TouchesError(
            f"images must be integers or floats, got {array.dtype}. "
            "Convert them first, for example images.astype(np.float32)."
        )
    if array.ndim != 3:
        hint = " For one touch pass images[np.newaxis]." if array.ndim == 2 else ""
        raise TouchesError(
            "images must have shape (n_touches, n_rows, n_cols), "
            f"got {array.shape}.{hint}"
        )
    if 0 in array.shape:
        raise TouchesError(
            "images must hold at least one touch of at least one taxel, "
            f"got shape {array.shape}. Leave empty recordings out."
        )
    _refuse_infinity("images", array)
    return frozen(array)


def sorted_out(
    given: Mapping[str, Any],
    images: NDArray[Any],
    whole_names: Collection[str] = (),
) -> tuple[Arrays, Arrays]:
    """Split `given` into checked columns and checked entries of the whole set.

    None counts as absent. `whole_names` are arrays of no settled name that belong
    to the whole set even where their length happens to be the number of touches.
    """
    columns: Arrays = {}
    whole: Arrays = {}
    for name, value in given.items():
        if value is None:
            continue
        array = plain_array(name, value)
        long = array.ndim > 0 and len(array) == len(images) and name not in whole_names
        if belongs_to_whole(name):
            whole[name] = frozen(_checked_whole(name, array, images))
        elif name in COLUMNS or long:
            columns[name] = frozen(checked_column(name, array, len(images)))
        else:
            whole[name] = frozen(array)
    return columns, whole


def plain_array(name: str, value: ArrayLike) -> NDArray[Any]:
    """Return `value` as an array of plain numbers, text or times, or explain."""
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise TouchesError(
            f"{name} must be one array, got rows of unequal length. Pad or cut them."
        ) from error
    if array.dtype.kind == "T":  # numpy's own variable-width text has no plain file
        array = np.array(array.tolist())
    if array.dtype.kind not in PLAIN_KINDS:
        raise TouchesError(
            f"{name} must hold plain numbers or text, got an array of {array.dtype}. "
            "Convert it first, for example with .astype(str) or .astype(float)."
        )
    return array


def checked_column(name: str, array: NDArray[Any], n_touches: int) -> NDArray[Any]:
    """Return a column that has one row per touch and suits its name, or explain."""
    if array.ndim == 0 or len(array) != n_touches:
        rows = f"{len(array)} rows" if array.ndim else "a single value"
        raise TouchesError(
            f"{name} must have one row per touch, got {rows} for {n_touches} touches. "
            "Cut or fill it; begin its name with set_ if it describes the whole set."
        )
    if name in FLAT and array.ndim != 1:
        raise TouchesError(
            f"{name} must have one value per touch, got shape {array.shape}. "
            f"Give its parts names of their own, or use {name}[:, 0]."
        )
    if name in NUMBERS and array.dtype.kind not in "iuf":
        raise TouchesError(
            f"{name} must be numbers, got an array of {array.dtype}. "
            "Convert it first, for example with .astype(float)."
        )
    return _checked_labels(name, array) if name in LABELS else array


def _checked_labels(name: str, array: NDArray[Any]) -> NDArray[Any]:
    """Return labels as text; integers become text, nothing else does."""
    kind = array.dtype.kind
    if kind == "f" and np.isnan(array).any():
        touch = np.flatnonzero(np.isnan(array))[0]
        raise TouchesError(
            f"{name} must name every touch, got NaN at touch {touch}. "
            "Label that touch or leave it out."
        )
    if kind not in "iuSU":
        raise TouchesError(
            f"{name} must be text or integers, got an array of {array.dtype}. "
            "Convert it first, for example with .astype(str)."
        )
    labels = _decoded(name, array) if kind == "S" else array
    text = labels if labels.dtype.kind == "U" else labels.astype(np.str_)
    empty = np.char.str_len(np.char.strip(text)) == 0
    if empty.any():
        raise TouchesError(
            f"{name} must not be empty, got an empty label at touch "
            f"{np.flatnonzero(empty)[0]}. Label that touch or leave it out."
        )
    return text


def _decoded(name: str, array: NDArray[Any]) -> NDArray[Any]:
    try:
        return np.char.decode(array, "utf-8")
    except UnicodeDecodeError as error:
        raise TouchesError(
            f"{name} must be UTF-8 text, got bytes that are not. "
            "Decode them first, for example with np.char.decode(labels, 'latin-1')."
        ) from error


def _checked_whole(
    name: str, array: NDArray[Any], images: NDArray[Any]
) -> NDArray[Any]:
    if name == "no_contact":
        return _checked_no_contact(array, images)
    if name == "geometry":
        return _checked_geometry(array)
    return array


def _checked_no_contact(array: NDArray[Any], images: NDArray[Any]) -> NDArray[Any]:
    if array.shape != images.shape[1:]:
        n_rows, n_cols = images.shape[1:]
        raise TouchesError(
            f"no_contact must be one image of {n_rows} x {n_cols} taxels like the "
            f"touches, got shape {array.shape}. Crop or resize it, or leave it out."
        )
    if array.dtype.kind not in "biuf":
        raise TouchesError(
            f"no_contact must be integers or floats, got {array.dtype}. Convert it."
        )
    _refuse_infinity("no_contact", array[np.newaxis])
    return array


def _checked_geometry(array: NDArray[Any]) -> NDArray[Any]:
    value = array.item() if array.size == 1 else array.tolist()
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    try:
        check_option("geometry", text, GEOMETRIES)
    except ValueError as error:
        raise TouchesError(f"{error} Leave it out to have it found out.") from error
    return np.array(text)


def _refuse_infinity(name: str, images: NDArray[Any]) -> None:
    """Refuse infinite taxels, a few megabytes at a time; NaN is a dead taxel."""
    if images.dtype.kind != "f":
        return
    for start, block in _blocks(images):
        bad = np.isinf(block).any(axis=(1, 2))
        if bad.any():
            where = f" in touch {start + np.flatnonzero(bad)[0]}"
            raise TouchesError(
                f"{name} must not be infinite, got infinity"
                f"{where if name == 'images' else ''}. "
                "Clip saturated taxels; mark dead ones as NaN."
            )


def _blocks(images: NDArray[Any]) -> Iterator[tuple[int, NDArray[Any]]]:
    step = max(1, _TAXELS_AT_ONCE // max(1, images[0].size))
    for start in range(0, len(images), step):
        yield start, images[start : start + step]
