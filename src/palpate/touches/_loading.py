"""Telling archives from folders."""

from os import PathLike
from pathlib import Path

from ._archive import read_archive
from ._errors import TouchesError
from ._folder import read_folder, read_no_contact
from ._pictures import Header
from ._touches import Touches


def load(
    path: str | PathLike[str],
    name_pattern: str | None,
    no_contact: str | PathLike[str] | None,
    max_pixels: int,
    max_bytes: int,
    progress: bool | None,
) -> Touches:
    """Read an archive or a folder; `Touches.load` explains the arguments."""
    place = Path(path)
    if place.is_dir():
        return read_folder(
            place,
            name_pattern=name_pattern,
            no_contact=no_contact,
            max_pixels=max_pixels,
            max_bytes=max_bytes,
            progress=progress,
        )
    if place.suffix.lower() != ".npz":
        got = "another kind of file" if place.exists() else "nothing there"
        raise TouchesError(
            f"{place} must be a touch archive (.npz) or a folder of pictures, "
            f"got {got}. Check the path; put single pictures into a folder."
        )
    if name_pattern is not None:
        raise TouchesError(
            f"name_pattern must be left out for an archive, got {name_pattern!r} with "
            f"{place}. Archives carry their labels."
        )
    touches = read_archive(place, max_bytes=max_bytes)
    if no_contact is None:
        return touches
    return _with_no_contact(touches, Path(no_contact), max_pixels)


def _with_no_contact(touches: Touches, path: Path, max_pixels: int) -> Touches:
    """Put a picture in place of the no-contact image; it must suit the images."""
    n_bits = {"uint8": 8, "uint16": 16}.get(touches.images.dtype.name)
    if n_bits is None:
        raise TouchesError(
            "no_contact must have the unit of the images, got a picture for images "
            f"of {touches.images.dtype}. "
            "Use touches.with_columns(no_contact=image) if they share one."
        )
    n_rows, n_cols = touches.images.shape[1:]
    like = Header("PNG", n_rows, n_cols, n_bits)
    image = read_no_contact(path, like, max_pixels=max_pixels)
    return touches.with_columns(no_contact=image)
