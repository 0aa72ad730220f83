"""Columns of a set of touches: checked, picked from, joined and summarised.

A name decides first: the names in `WHOLE` and those beginning with `set_` belong to
the whole set; the names in `COLUMNS` are columns and must have one row per touch. Any
other array is a column when it has one row per touch, and belongs to the whole set when
it does not.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._checks import check_option, one_spelling, size_text, unmasked
from .._types import FORMER, GEOMETRIES, LAYOUT, PLAIN_KINDS, Array, Floats

Arrays = dict[str, Array]

LABELS = ("object", "category")
NUMBERS = ("order", "position_mm", "position_raw", "force_n", "time_s")
FLAT = (*LABELS, "order", "session", "time_s", "sensor", "episode", "press", "frame")
COLUMNS = frozenset((*FLAT, *NUMBERS, "source_path", "press_frames"))
WHOLE = frozenset(("no_contact", "frame_index", "geometry", *LAYOUT))
_TAXELS_AT_ONCE = 2**22
VECTORS = (
    'For vectors, one a row, save Touches(X[:, np.newaxis], geometry="none", '
    "object=names)."
)
SUMMARIES = ("peak", "hold", "loading")
_HELD = 0.8
_LACKING = ("nan", "NaN", "NaT", "<NA>")  # labels that lack, made texts by programs


class TouchesError(ValueError):
    """Touches, a touch archive or a folder of pictures are not what they must be.

    The message names the file (or the argument), what was found and the fix.
    """


def refuse_large(what: str, n_bytes: int, max_bytes: int) -> None:
    """Refuse what would take too much memory, before it is read."""
    if n_bytes > max_bytes:
        raise TouchesError(
            f"{what} must take at most {max_bytes} bytes, got {n_bytes}. Split it, "
            "keep it in a library, which is read as it is needed, or raise max_bytes "
            "if you trust it."
        )


def belongs_to_whole(name: str) -> bool:
    """Tell whether `name` alone says that an array describes the whole set."""
    return name in WHOLE or name.startswith("set_")


def frozen(array: Array) -> Array:
    """Return a read-only view; the caller's own array stays as it is."""
    view = array.view()
    view.flags.writeable = False
    return view


def checked_images(images: ArrayLike) -> Array:
    """Return images (n_touches, n_rows, n_cols[, n_channels]) read-only, or explain."""
    array = plain_array("images", images)
    if array.ndim not in (3, 4):
        hint = (
            " For one touch pass images[np.newaxis]; for vectors, one a row, "
            'images[:, np.newaxis] and geometry="none".'
        ) * (array.ndim == 2)
        raise TouchesError(
            "images must have shape (n_touches, n_rows, n_cols) or (n_touches, n_rows, "
            f"n_cols, n_channels), got {array.shape}.{hint}"
        )
    if 0 in array.shape:
        raise TouchesError(
            "images must hold at least one touch of at least one taxel, "
            f"got shape {array.shape}. Leave empty recordings out."
        )
    _refuse_odd_levels("images", array)
    return frozen(array)


def sorted_out(
    values: Mapping[str, Any], images: Array, whole_names: Collection[str] | None = ()
) -> tuple[Arrays, Arrays]:
    """Split `values` into checked columns and checked entries of the whole set.

    None counts as absent. `whole_names` are arrays of no settled name that belong
    to the whole set even where their length happens to be the number of touches; None
    that all of no settled name are columns, and that None is no column.
    """
    columns: Arrays = {}
    whole: Arrays = {}
    for given_name, value in values.items():
        if value is None and (whole_names is not None or belongs_to_whole(given_name)):
            continue
        name = FORMER.get(given_name, given_name)
        if name != given_name and values.get(name) is not None:
            raise TouchesError(
                f"{name} must be given once, got {given_name} as well, which is its "
                "former name. Leave that out."
            )
        array = plain_array(name, value)
        long = array.ndim > 0 and len(array) == len(images)
        is_column = whole_names is None or (long and name not in whole_names)
        if belongs_to_whole(name):
            whole[name] = frozen(_checked_whole(name, array, images))
        elif name in COLUMNS or is_column:
            _refuse_touches_last(name, array, images)
            columns[name] = frozen(checked_column(name, array, len(images)))
        else:
            whole[name] = frozen(array)
    return columns, whole


def _refuse_touches_last(name: str, array: Array, images: Array) -> None:
    """Refuse labels as long as the last axis of images, and not as the first."""
    if name in LABELS and array.shape == images.shape[-1:] != images.shape[:1]:
        raise TouchesError(
            f"{name} must have one row per touch, got {len(array)} for images of shape "
            f"{images.shape}. Bring touches to the first axis: "
            "np.moveaxis(images, -1, 0)."
        )


def plain_array(name: str, value: ArrayLike) -> Array:
    """Return `value` as an array of plain numbers, text or times, or explain."""
    try:
        value = unmasked(name, value)
    except ValueError as error:
        raise TouchesError(str(error)) from None
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise TouchesError(
            f"{name} must be one array, got rows of unequal length. Pad or cut them."
        ) from error
    cells = array.flat if array.dtype.kind in "TO" else ()
    are_texts = [isinstance(cell, str) for cell in cells]
    if are_texts and all(are_texts):  # of numpy, of pandas: no plain file
        value = array.tolist()
        array = np.array(value)
    if array.dtype.kind == "U" and isinstance(value, list | tuple | str):
        texts = [value] if isinstance(value, str) else value
        for place, text in enumerate(texts):
            if isinstance(text, str) and text.endswith("\0"):  # numpy would drop it
                raise _unprintable(name, text)
            if isinstance(text, float) and np.isnan(text):  # and write this as "nan"
                raise TouchesError(
                    f"{name} must be text or numbers, got NaN among texts at {place}. "
                    'Label that touch or leave it out; write "" where a label may lack.'
                )
    if array.dtype.kind not in PLAIN_KINDS:
        fix = "Convert it first, for example with .astype(str) or .astype(float)."
        if any(are_texts):  # of the others .astype(str) would make "None" and "nan"
            fix = "Fill in what is missing, or leave these touches out."
        raise TouchesError(
            f"{name} must hold plain numbers or text, got an array of {array.dtype}. "
            f"{fix}"
        )
    return array


def checked_column(name: str, array: Array, n_touches: int) -> Array:
    """Return a column that has one row per touch and suits its name, or explain."""
    if array.ndim == 0 or len(array) != n_touches:
        rows = f"{len(array)} rows" if array.ndim else "a single value"
        raise TouchesError(
            f"{name} must have one row per touch, got {rows} for {n_touches} touches. "
            "Cut or fill it; begin its name with set_ if it describes the whole set."
        )
    if name in FLAT and array.ndim != 1:
        fix = f"Give its parts names of their own, or use {name}[:, 0]."
        if name in LABELS and array.ndim == 2 and array.shape[1] > 1:
            fix = f"Of labels as ones among zeros give {name}.argmax(axis=1)."
        raise TouchesError(
            f"{name} must have one value per touch, got shape {array.shape}. {fix}"
        )
    if name in NUMBERS and array.dtype.kind not in "iuf":
        fix = "Convert it first, for example with .astype(float)."
        if name == "time_s" and array.dtype.kind in "MU":  # would be nanoseconds
            fix = 'Write seconds: (t - t[0]) / numpy.timedelta64(1, "s") of dates t.'
        raise TouchesError(
            f"{name} must be numbers, got an array of {array.dtype}. {fix}"
        )
    return _checked_labels(name, array) if name in LABELS else array


def checked_shape(shape: Any) -> tuple[int, int]:
    """Return the rows and columns of taxels, or explain."""
    sides = list(shape) if np.iterable(shape) else []
    if len(sides) == 2 and all(
        isinstance(s, int | np.integer) and s > 0 for s in sides
    ):
        return int(sides[0]), int(sides[1])
    raise TouchesError(
        f"shape must be rows and columns of taxels, got {shape!r}. Such as (16, 16)."
    )


def picked_rows(index: Any, n_touches: int) -> slice | Array:
    """Return `index` as a slice or an array that keeps at least one touch."""
    if isinstance(index, int | np.integer) and not isinstance(index, bool):
        touch = int(index)
        if not -n_touches <= touch < n_touches:
            raise IndexError(f"touch {touch} is out of range: there are {n_touches}.")
        return slice(touch % n_touches, touch % n_touches + 1)
    rows: slice | Array = index
    if not isinstance(index, slice):
        rows = np.asarray(None if isinstance(index, tuple) else index)
        if rows.size == 0 and rows.ndim == 1:
            rows = rows.astype(np.intp)
        if rows.ndim != 1 or rows.dtype.kind not in "biu":
            raise TypeError(
                "Touches are picked by number, slice, mask or array of numbers, "
                f"got {index!r}. Columns are in touches.columns[name]."
            )
        if rows.dtype.kind == "b" and len(rows) != n_touches:
            raise IndexError(
                f"a mask must have one value per touch ({n_touches}), got {len(rows)}."
            )
    if len(np.arange(n_touches)[rows]) == 0:
        raise TouchesError(
            f"A selection must keep at least one of {n_touches} touches, got none."
        )
    return rows


def joined_images(parts: Sequence[Array]) -> Array:
    for number, part in enumerate(parts):
        if part.shape[1:] != parts[0].shape[1:]:
            first, other = (size_text(a.shape[1:]) for a in (parts[0], part))
            raise TouchesError(
                f"images must all be {first} like set 0, got {other} in set {number}. "
                "Resize or crop them first."
            )
        if part.dtype != parts[0].dtype:
            raise TouchesError(
                f"images must all be {parts[0].dtype} like set 0, got {part.dtype} in "
                f"set {number}. Convert one of them with images.astype."
            )
    # By itself it would put bytes into this machine's order.
    return np.concatenate(parts, dtype=parts[0].dtype)


def joined_columns(parts: Sequence[Arrays]) -> Arrays:
    """Join columns by name, in the order in which names first appear."""
    joined: Arrays = {}
    for name in dict.fromkeys(name for part in parts for name in part):
        columns = _in_every_set(f"column {name!r}", name, parts)
        kinds = [(_kind(column), column.shape[1:]) for column in columns]
        odd = next((i for i, kind in enumerate(kinds) if kind != kinds[0]), None)
        if odd is not None:
            raise TouchesError(
                f"column {name!r} must be alike in every set, got {_row(columns[odd])} "
                f"in set {odd} after {_row(columns[0])} in set 0. Convert one of them, "
                f"or drop it with touches.without({name!r})."
            )
        joined[name] = np.concatenate(columns)
    return joined


def joined_whole(parts: Sequence[Arrays]) -> Arrays:
    """Keep the entries of the whole set, which must be the same in every set."""
    for name in dict.fromkeys(name for part in parts for name in part):
        first, *others = _in_every_set(name, name, parts)
        for number, entry in enumerate(others, 1):
            numbers = entry.dtype.kind in "fc" and first.dtype.kind in "fc"
            # Kinds first: numpy before 2.1 cannot compare texts with numbers.
            alike = _kind(entry) == _kind(first)
            if not alike or not np.array_equal(entry, first, equal_nan=numbers):
                fix = f"Keep the sets apart, or drop it with touches.without({name!r})."
                if name == "no_contact":  # an array without it is told worse
                    fix += (
                        " Of an array join the changes from each one's own: "
                        "Touches(touches.differences(), **touches.columns)."
                    )
                raise TouchesError(
                    f"{name} must be the same in every set, got another one in set "
                    f"{number}. {fix}"
                )
    return dict(parts[0])


def _in_every_set(what: str, name: str, parts: Sequence[Arrays]) -> list[Array]:
    for number, part in enumerate(parts):
        if name not in part:
            raise TouchesError(
                f"{what} must be in every set, got none in set {number}. "
                f"Add it with touches.with_columns({name}=...), or drop it "
                f"elsewhere with touches.without({name!r})."
            )
    return [part[name] for part in parts]


def common_whole(parts: Sequence[Arrays]) -> Arrays:
    """Return the entries of whole sets that are the same in all of them."""
    contents = [
        {n: (a.dtype, a.shape, a.tobytes()) for n, a in part.items()} for part in parts
    ]
    first = contents[0].items()
    alike = {n for n, held in first if all(c.get(n) == held for c in contents)}
    same = {n: array for n, array in parts[0].items() if n in alike}
    if "pads" not in same:  # names of pads that differ name nothing
        same.pop("pad_names", None)
    return same


def trimmed(arrays: Arrays) -> Arrays:
    """Return arrays of others' files, labels without blanks around, none that lacks."""
    texts = {n: a for n, a in arrays.items() if n in LABELS and a.dtype.kind == "U"}
    texts = {name: np.char.strip(text) for name, text in texts.items()}
    for name, text in texts.items():
        if len(lacking := np.flatnonzero(np.isin(text, _LACKING))):
            raise TouchesError(
                f"Column {name} must not be empty, got {str(text[lacking[0]])!r} at "
                f"touch {lacking[0]}, as programs write a label that lacks. Label that "
                "touch or leave it out."
            )
    return {**arrays, **texts}


def _checked_labels(name: str, array: Array) -> Array:
    """Return labels as text; integers become text, nothing else does."""
    kind = array.dtype.kind
    if kind not in "iuSU":
        nan = np.flatnonzero(np.isnan(array)) if kind == "f" else array[:0]
        where = f", NaN at touch {nan[0]}" if len(nan) else ""
        raise TouchesError(
            f"{name} must be text or integers, got an array of {array.dtype}{where}. "
            "Fill in what is missing, and convert it, for example by .astype(str)."
        )
    labels = _decoded(name, array)
    text = labels if labels.dtype.kind == "U" else labels.astype(np.str_)
    empty = np.char.str_len(np.char.strip(text)) == 0
    if empty.any():
        raise TouchesError(
            f"Column {name} must not be empty, got an empty label at touch "
            f"{empty.argmax()}. Label that touch or leave it out."
        )
    texts = text.tolist()
    spelt = {label: one_spelling(label) for label in set(texts)}
    for label, spelling in spelt.items():
        if spelling is None:
            raise _unprintable(name, label)
    if all(label == spelling for label, spelling in spelt.items()):
        return text
    return np.array([spelt[label] for label in texts], dtype=np.str_)


def _decoded(name: str, array: Array) -> Array:
    try:
        return np.char.decode(array, "utf-8") if array.dtype.kind == "S" else array
    except UnicodeDecodeError as error:
        raise TouchesError(
            f"{name} must be UTF-8 text, got bytes that are not. "
            "Decode them first, for example with np.char.decode(labels, 'latin-1')."
        ) from error


def _unprintable(name: str, text: str) -> TouchesError:
    fix = "Leave out line breaks and control characters."
    if any("\udc80" <= letter <= "\udcff" for letter in text):  # a byte of a file name
        fix = (
            "A name of a file that is no UTF-8, as of an old zip file: rename it, or, "
            "where it is right, set PYTHONUTF8=1."
        )
    return TouchesError(
        f"{name} must be of letters that can be printed, got {text!r}. {fix}"
    )


def check_layout(images: Array, columns: Arrays, whole: Arrays) -> None:
    """Refuse channels, pads and frames of presses that do not suit the images."""
    names, pads = whole.get("channels"), whole.get("pads")
    n_channels = images.shape[3] if images.ndim == 4 else 0
    if n_channels != (0 if names is None else len(names)):
        fix = (
            "List them in their order by `channels`, in an archive by its array "
            "channels: r,g,b of colours, x,y,z of forces. Images without a fourth axis "
            "have none: leave them out."
        )
        if names is None and n_channels > 1:
            fix += (
                " Frames of presses (n_touches, n_frames, n_rows, n_cols) are no "
                "images: give one of each press, and all as `press_frames`."
            )
        if images.shape[1] <= 4 < n_channels:  # as PyTorch has them
            fix = (
                "Channels come last: images.transpose(0, 2, 3, 1), each with its name."
            )
        raise TouchesError(
            f"channels must name each of the {n_channels} channels of images of shape "
            f"{images.shape}, got {_listed(names)}. {fix}"
        )
    if "pad_names" in whole and (pads is None or len(pads) != len(whole["pad_names"])):
        n_pads = "no pads" if pads is None else f"{len(pads)} pads"
        raise TouchesError(
            f"pad_names must name each of the pads, got {_listed(whole['pad_names'])} "
            f"for {n_pads}. Give as many names as pads, or leave them out."
        )
    frames = columns.get("press_frames")
    if frames is None:
        return
    if 0 in frames.shape or frames.shape[2:] != images.shape[1:]:
        raise TouchesError(
            "press_frames must hold for each touch at least one frame of "
            f"{size_text(images.shape[1:])} like the images, got shape {frames.shape}. "
            "Crop them, call them something else, or leave them out."
        )
    _refuse_odd_levels("press_frames", frames)


def _checked_names(name: str, array: Array) -> Array:
    text = _decoded(name, array)
    names = [str(name).strip() for name in text.tolist()] if text.ndim == 1 else []
    if text.dtype.kind != "U" or not all(names) or not 0 < len(set(names)) == len(text):
        raise TouchesError(
            f"{name} must be different texts in a list, none of them empty, got "
            f"{array.tolist()!r}. Name each once."
        )
    return text


def _checked_pads(array: Array, images: Array) -> Array:
    """Return boxes that lie within the picture and apart from one another."""
    if array.dtype.kind not in "iu" or array.ndim != 2 or array.shape[1:] != (4,):
        raise TouchesError(
            "pads must be integers (n_pads, 4), first row, first column, rows and "
            f"columns of each, got shape {array.shape} of {array.dtype}. "
            "Give one such row for each pad."
        )
    taken: Array = np.zeros(images.shape[1:3], dtype=bool)
    for number, (row, col, n_rows, n_cols) in enumerate(array.tolist()):
        box = slice(row, row + n_rows), slice(col, col + n_cols)
        fits = row + n_rows <= taken.shape[0] and col + n_cols <= taken.shape[1]
        what = ""
        if min(n_rows, n_cols) < 1:
            what = "that has no taxel"
        elif min(row, col) < 0 or not fits:
            what = f"that leaves the picture of {size_text(taken.shape)}"
        elif taken[box].any():
            what = "that overlaps another one"
        if what:
            raise TouchesError(
                "pads must lie apart within the picture, got pad "
                f"{number}, {[row, col, n_rows, n_cols]}, {what}. "
                "Correct its first row, first column, rows or columns."
            )
        taken[box] = True
    if not len(array):
        raise TouchesError("pads must hold at least one pad, got none. Leave them out.")
    return array


def _checked_whole(name: str, array: Array, images: Array) -> Array:
    if name == "pads":
        return _checked_pads(array, images)
    if name in LAYOUT:
        return _checked_names(name, array)
    if name == "no_contact":
        if array.shape != images.shape[1:]:
            raise TouchesError(
                f"no_contact must be one image of {size_text(images.shape[1:])} like "
                f"the touches, got shape {array.shape}. Crop, resize or leave it out."
            )
        _refuse_odd_levels("no_contact", array[np.newaxis])
    if name != "geometry":
        return array
    value = array.item() if array.size == 1 else array.tolist()
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    try:
        check_option("geometry", text, GEOMETRIES)
    except ValueError as error:
        raise TouchesError(f"{error} Leave it out to have it found out.") from error
    return np.array(text)


def _refuse_odd_levels(name: str, images: Array) -> None:
    """Refuse what is no level, some megabytes at a time; NaN is a dead taxel."""
    if images.dtype.kind not in "biuf":
        raise TouchesError(
            f"{name} must be integers or floats, got {images.dtype}. "
            f"Convert them first, for example {name}.astype(np.float32)."
        )
    if images.dtype.kind != "f":
        return
    step = max(1, _TAXELS_AT_ONCE // max(1, images[0].size))
    for start in range(0, len(images), step):
        part = images[start : start + step]
        bad = np.isinf(part).reshape(len(part), -1).any(axis=1)
        if bad.any():
            where = "" if name == "no_contact" else f" in touch {start + bad.argmax()}"
            raise TouchesError(
                f"{name} must not be infinite, got infinity{where}. "
                "Clip saturated taxels; mark dead ones as NaN."
            )


def _kind(column: Array) -> str:
    """Return what may be joined: numbers with numbers or truths, text with text."""
    kind = column.dtype.kind
    return "numbers" if kind in "biufc" else kind


def _row(column: Array) -> str:
    row = " x ".join(map(str, column.shape[1:]))
    return f"{row} {column.dtype} a row" if row else str(column.dtype)


def _listed(names: Array | None) -> str:
    return "none" if names is None else repr(names.tolist())


def frame_summaries(frames: Array) -> Array:
    """Return the summaries of presses, (n_touches, n_rows, n_cols, 3 * n_channels).

    `frames` are (n_touches, n_frames, n_rows, n_cols[, n_channels]); NaN stays NaN. All
    channels of the first of `SUMMARIES` come first. Frames of 8 and 16 bits give
    float32, wider ones float64.
    """
    n_touches, _, n_rows, n_cols = frames.shape[:4]
    summaries = [_summarised(press.astype(np.float64)) for press in frames]
    dtype = np.result_type(frames.dtype, np.float32)
    return np.array(summaries, dtype).reshape(n_touches, n_rows, n_cols, -1)


def _summarised(press: Floats) -> Floats:
    """Return (n_rows, n_cols, 3[, n_channels]) of one press."""
    loads = np.nansum(press, axis=tuple(range(1, press.ndim)))
    peak, gained = int(loads.argmax()), loads - loads[0]
    held = press[gained >= _HELD * gained[peak]].mean(axis=0)
    loading = (press[peak] - press[0]) / max(peak, 1)
    return np.stack([press[peak], held, loading], axis=2)
