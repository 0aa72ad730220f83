"""Folders of pictures as touches."""

import os
import re
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._columns import Arrays
from ._decode import (
    common_header,
    decode_picture,
    decode_pictures,
    picture_header,
    refusal,
)
from ._errors import TouchesError
from ._labels import compiled, labels_from_folders, labels_from_names
from ._pictures import Header
from ._touches import MAX_BYTES, MAX_PIXELS, Touches

_ENDINGS = (".jpg", ".jpeg", ".png")


def read_folder(
    path: str | PathLike[str],
    *,
    name_pattern: str | None = None,
    no_contact: str | PathLike[str] | None = None,
    max_pixels: int = MAX_PIXELS,
    max_bytes: int = MAX_BYTES,
    progress: bool | None = None,
) -> Touches:
    r"""Read all JPEG and PNG pictures in a folder and the folders in it.

    Pictures come in natural order of their paths (`img_2` before `img_10`), as
    stored: colour becomes grey, 16 bits stay 16 bits, Exif orientation is not
    applied. Hidden files and files of other kinds are skipped.

    Parameters
    ----------
    path : path
        The folder.
    name_pattern : str, optional
        Regular expression, searched in each file name, else in its path within the
        folder. Named groups become columns: `object`, `category` and `session`
        (text), `n` or `order` (`order`, integers), `x`, `y`, `z` (`position_raw`),
        `x_mm`, `y_mm`, `z_mm` (`position_mm`), any other name (numbers where all are
        numbers, else text). Where it has no group `object`, folders give labels
        as they do without a pattern: one level of folders is the object; of more,
        the first is the category and the whole path the object; pictures that lie
        in no folder have no labels.
    no_contact : path, optional
        Picture of the sensor touching nothing, as large and deep as the others.
    max_pixels : int, default=50_000_000
        Largest picture to decode, in pixels.
    max_bytes : int, default=4 GiB
        Most memory that all images may take.
    progress : bool, optional
        Show a bar on standard error when decoding takes over two seconds; by
        default where standard error is a terminal.

    Raises
    ------
    TouchesError
        A picture is damaged, unlike the others or of a kind that is not read; a
        name does not match; folders label some pictures only. Nothing is returned
        in part.

    Notes
    -----
    The path of each picture within the folder is kept as `source_path`. A JPEG has
    no checksum: one that is cut short is refused, flipped bits inside it may not be.

    Examples
    --------
    >>> pattern = r"img_(?P<n>\d+)_name_(?P<object>\w+?)_at_(?P<x>\d+)_"
    >>> touches = read_folder("originals", name_pattern=pattern)  # doctest: +SKIP
    """
    root = Path(path)
    pattern = None if name_pattern is None else compiled(name_pattern)
    names = _picture_names(root, None if no_contact is None else Path(no_contact))
    try:
        columns = _labels(names, pattern)
    except TouchesError as error:
        raise TouchesError(f"{root}: {error}") from error
    paths = [root / name for name in names]
    header = common_header(paths, max_pixels=max_pixels)
    empty = None
    if no_contact is not None:
        empty = read_no_contact(Path(no_contact), header, max_pixels=max_pixels)
    images = decode_pictures(paths, header, max_bytes=max_bytes, progress=progress)
    return Touches(images, no_contact=empty, **columns, source_path=np.array(names))


def read_no_contact(path: Path, like: Header, *, max_pixels: int) -> NDArray[Any]:
    """Return the picture of no contact, which must be as large and deep as `like`."""
    header = picture_header(path, max_pixels=max_pixels)
    if header._replace(format=like.format) != like:
        raise TouchesError(
            f"no_contact must be {like.n_cols} x {like.n_rows} {like.n_bits}-bit like "
            f"the touches, got {header} in {path}. Convert it, or give another."
        )
    return decode_picture(path, header)


def _labels(names: list[str], pattern: re.Pattern[str] | None) -> Arrays:
    columns = {} if pattern is None else labels_from_names(names, pattern)
    if "object" not in columns:
        columns = {**labels_from_folders(names), **columns}
    return columns


def _picture_names(root: Path, no_contact: Path | None) -> list[str]:
    """Return the paths of all touches within `root`, in natural order."""
    if not root.is_dir():
        raise TouchesError(
            f"{root} must be a folder of pictures, got none there. Check the path."
        )
    try:
        found = _files(root)
    except OSError as error:
        raise refusal(Path(error.filename or root), error) from error
    pictures = [name for name in found if Path(name).suffix.lower() in _ENDINGS]
    if no_contact is not None:
        pictures = _without(no_contact, pictures, root)
    if not pictures:
        raise _no_pictures(root, found)
    return sorted(pictures, key=_natural_order)


def _files(root: Path) -> list[str]:
    """Return all files below `root` but hidden ones, following symbolic links."""
    found: list[str] = []
    seen: dict[tuple[int, int], Path] = {}
    waiting = [root]
    while waiting:
        folder = waiting.pop()
        status = folder.stat()
        first = seen.setdefault((status.st_dev, status.st_ino), folder)
        if first is not folder:
            raise TouchesError(
                f"{folder} must not lead back to {first}, got a symbolic link that "
                "does: its pictures would count twice. Remove the link."
            )
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name.startswith("."):
                    continue
                if entry.is_dir():
                    waiting.append(folder / entry.name)
                else:
                    found.append((folder / entry.name).relative_to(root).as_posix())
    return found


def _without(no_contact: Path, pictures: list[str], root: Path) -> list[str]:
    """Leave the picture of no contact out of the touches."""
    try:
        status = no_contact.stat()
        if root.resolve() not in no_contact.resolve().parents:
            return pictures
        return [
            name
            for name in pictures
            if not os.path.samestat(status, (root / name).stat())
        ]
    except OSError as error:
        raise refusal(Path(error.filename or no_contact), error) from error


def _no_pictures(root: Path, found: list[str]) -> TouchesError:
    kinds = sorted({Path(name).suffix or "no ending" for name in found})
    got = f"{len(found)} files of {', '.join(kinds[:5])}" if found else "no files"
    hint = " Archives are loaded one by one." if ".npz" in kinds else ""
    return TouchesError(
        f"{root} must hold pictures ending in {', '.join(_ENDINGS)}, got {got}. "
        f"Convert them, or give another folder.{hint}"
    )


def _natural_order(name: str) -> tuple[Any, ...]:
    """Sort numbers within names by value, folder by folder."""
    parts = [
        [int(piece) if i % 2 else piece.casefold() for i, piece in enumerate(pieces)]
        for pieces in (re.split(r"(\d+)", part) for part in name.split("/"))
    ]
    return parts, name
