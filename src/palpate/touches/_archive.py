"""Touch archives: `.npz` files of plain arrays, without pickles.

Every array is stored under its name, in the type it has. Where an array of the
whole set happens to be as long as the set (a selection can make it so), its name
is listed in `set_whole_names`, so that reading does not take it for a column.
"""

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import _npz
from ._columns import Arrays, belongs_to_whole, sorted_out
from ._errors import TouchesError
from ._touches import MAX_BYTES, Touches

if TYPE_CHECKING:
    from ._npz import ArrayFile

_WHOLE_NAMES = "set_whole_names"


def read_archive(path: str | PathLike[str], *, max_bytes: int = MAX_BYTES) -> Touches:
    """Read a touch archive.

    Parameters
    ----------
    path : path
        An `.npz` file with at least `images` (n_touches, n_rows, n_cols).
    max_bytes : int, default=4 GiB
        Most bytes that its arrays may take; checked before anything is inflated.

    Raises
    ------
    TouchesError
        The file is no touch archive, is damaged, holds pickles, or its arrays do
        not fit together.
    """
    file = Path(path)
    with _npz.opened(file, max_bytes) as archive:
        _refuse_no_images(archive)
        arrays = archive.read()
    try:
        return _touches(arrays)
    except TouchesError as error:
        raise TouchesError(f"{file}: {error}") from error


def write_archive(path: str | PathLike[str], touches: Touches) -> None:
    """Write a touch archive: all of it or nothing.

    The file is written under another name in the same folder, flushed to disk and
    renamed; an archive that was there before stays whole until then.

    Parameters
    ----------
    path : path
        Where to write; the name must end in `.npz`.
    touches : Touches
        What to write.

    Raises
    ------
    TouchesError
        The name does not end in `.npz`, or the file cannot be written.
    """
    file = Path(path)
    if file.suffix.lower() != ".npz":
        raise TouchesError(
            f"A touch archive must have a name that ends in .npz, got {file}. "
            f"Write to {file.with_name(file.name + '.npz')}."
        )
    arrays: Arrays = {"images": touches.images, **touches.columns, **touches.whole}
    mistakable = [
        name
        for name, array in touches.whole.items()
        if not belongs_to_whole(name) and array.ndim and len(array) == len(touches)
    ]
    if mistakable:
        arrays[_WHOLE_NAMES] = np.array(mistakable)
    _npz.write(file, arrays)


def _touches(arrays: Arrays) -> Touches:
    images = Touches(arrays.pop("images")).images
    names = arrays.pop(_WHOLE_NAMES, np.array([], dtype=np.str_))
    columns, whole = sorted_out(arrays, images, _texts(names))
    return Touches._of(images, columns, whole)


def _texts(names: NDArray[Any]) -> list[str]:
    return [str(name) for name in names.ravel()]


def _refuse_no_images(archive: "ArrayFile") -> None:
    members = archive.members
    if "images" not in members:
        held = ", ".join(map(str, members.values())) or "nothing"
        raise TouchesError(
            f"{archive.path} is not a touch archive: it must hold an array named "
            f"images (n_touches, n_rows, n_cols); it holds {held}. "
            "Rename the array of images, or give another file."
        )
