"""Folders of pictures: which they are, which cannot be used, and their labels."""

import hashlib
import os
import re
import warnings
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._checks import listed, nearest_path
from .._types import FILMS, PICTURES, RGB, Array
from . import _pictures
from ._columns import Arrays, TouchesError, trimmed
from ._containers import CONTAINERS
from ._layout import (
    LABELS,
    BadPicture,
    compiled,
    kept_names,
    labels_of,
    levels_pattern,
    odd_names,
)
from ._pictures import (
    Header,
    PictureError,
    checked_picture,
    common_header,
    decode_picture,
    decode_pictures,
    fix_of_another,
    most_common_header,
    n_cores,
)
from ._tables import TABLES, folder_levels

_GREY_DIFFERS = 8.0  # levels of 255, in the mean over a picture
_ONE_TOUCH_A_FILE = tuple(
    ending for ending in CONTAINERS if ending not in (".zarr", ".mat")
)
_KINDS_OF_FILES = (PICTURES, _ONE_TOUCH_A_FILE, TABLES)  # the first there is read
_ALL_KINDS = {ending for kinds in _KINDS_OF_FILES for ending in kinds}
_GREY = {".bmp", ".webp"}  # pictures too, read where there is no JPEG or PNG
_LISTED = 5  # pictures left out
_MOST_TABLE = 2**30  # bytes; only to say which objects are lost


@dataclass
class PictureCheck:
    """The findings in the pictures of a folder.

    Attributes
    ----------
    bad : list of BadPicture
        Those that cannot be read, are unlike most, or get no label.
    usual : str
        Size and format of the others.
    turned : list of str
        Those that were turned upright, as their Exif orientation says.
    flat : list of str
        Pictures of one level all over.
    same : list of (str, str)
        Pictures that are a copy of another one.
    coloured, grey : list of str
        Which of those that can be used are in colour, and in grey, where all were
        read in grey and the first in colour shows some; else none.
    empty : list of str
        Folders in which no file is.
    lost : dict of str to BadPicture
        Objects of which no picture can be used, where some of others can, and the
        first of each.
    others : dict of str to list of str
        Other files, by their endings; without a JPEG or PNG those of BMP and WebP.
    """

    bad: list[BadPicture] = field(default_factory=list)
    usual: str = ""
    turned: list[str] = field(default_factory=list)
    flat: list[str] = field(default_factory=list)
    same: list[tuple[str, str]] = field(default_factory=list)
    coloured: list[str] = field(default_factory=list)
    grey: list[str] = field(default_factory=list)
    empty: list[str] = field(default_factory=list)
    lost: dict[str, BadPicture] = field(default_factory=dict)
    others: dict[str, list[str]] = field(default_factory=dict)

    @staticmethod
    def of_folder(
        root: Path,
        *,
        name_pattern: str | None = None,
        levels: str | None = None,
        no_contact: str | PathLike[str] | None = None,
        colour: bool = False,
        max_pixels: int = 50_000_000,
    ) -> "PictureCheck":
        """Look at every JPEG and PNG of a folder, and of the folders in it.

        Raises TouchesError where the pictures are not what is read, or folders mean
        nothing.
        """
        files: dict[str, list[str]] = {}
        for name in sorted(_files(root), key=_natural_order):
            ending = Path(name).suffix.lower() or "no ending"
            files.setdefault(ending, []).extend([name] * (name != LABELS))
        if not {*files} & {*PICTURES}:
            return PictureCheck(others={e: files[e] for e in sorted(_GREY & {*files})})
        root, names, pattern = _chosen(root, name_pattern, levels, no_contact)
        if (kind := Path(names[0]).suffix).lower() not in PICTURES:
            raise TouchesError(
                f"{root} must hold pictures to be looked at, got {kind} files. What is "
                "wrong with one of these is said when they are read."
            )
        check = _checked(root, names, pattern, max_pixels, colour)
        empty = [here for here, folders, inside in _walk(root) if not folders + inside]
        check.empty = sorted((f"{e.as_posix()}/" for e in empty), key=_natural_order)
        others = sorted({ending for ending in files if files[ending]} - {*PICTURES})
        check.others = {ending: files[ending] for ending in others}
        return check

    @property
    def is_of_pictures(self) -> bool:
        """Whether a JPEG or PNG was looked at."""
        return bool(self.usual or self.bad)


def folder_arrays(
    root: Path,
    name_pattern: str | None,
    levels: str | None,
    no_contact: str | PathLike[str] | None,
    colour: bool,
    skip_bad: bool,
    max_pixels: int,
    max_bytes: int,
    progress: bool | None,
) -> tuple[Arrays, list[bytes] | None]:
    """Return what `Touches` is made of, and files of pictures; see `Touches.load`."""
    is_folder = root.is_dir()
    root, names, pattern = _chosen(root, name_pattern, levels, no_contact)
    if is_folder:
        _warn_of_others(root, names)
    are_arrays = Path(names[0]).suffix.lower() in (*TABLES, *_ONE_TOUCH_A_FILE)
    if are_arrays and (colour or skip_bad or no_contact is not None):
        raise TouchesError(
            "colour, skip_bad and no_contact must be left out for arrays, as in "
            f"{root}."
        )
    if skip_bad:
        check = _checked(root, names, pattern, max_pixels, colour)
        names = _without_bad(root, names, check)
    try:
        columns = trimmed(labels_of(root, names, pattern, max_bytes))
    except TouchesError as error:
        raise TouchesError(f"{root}: {error}") from error
    paths = [root / name for name in names]
    if are_arrays:
        images = folder_levels(paths, max_bytes)
        return {"images": images, **columns, "source_path": np.array(names)}, None
    header = common_header(paths, max_pixels=max_pixels, colour=colour)
    whole: Arrays = {"channels": np.array(RGB)} if colour else {}
    if no_contact is not None:
        whole["no_contact"] = _like(Path(no_contact), header, max_pixels)
    limits: dict[str, Any] = {"max_bytes": max_bytes, "progress": progress}
    images, files = decode_pictures(paths, header, **limits)
    columns["source_path"] = np.array(names)
    return {"images": images, **whole, **columns}, files


def _chosen(
    root: Path,
    name_pattern: str | None,
    levels: str | None,
    no_contact: str | PathLike[str] | None,
) -> tuple[Path, list[str], re.Pattern[str] | None]:
    """Return the folder, the pictures that are meant, and how names are read."""
    if levels is not None and name_pattern is not None:
        raise TouchesError(
            f"levels must be left out with a name_pattern, got {levels!r}. Give either."
        )
    if no_contact is not None and root.exists():
        _there(Path(no_contact), root)
    if root.is_file():
        root, names = root.parent, [root.name]
    else:
        names = _picture_names(root, None if no_contact is None else Path(no_contact))
    if levels is not None:
        name_pattern = levels_pattern(levels)
        names = kept_names(names, levels)
    return root, names, None if name_pattern is None else compiled(name_pattern)


def _checked(
    root: Path,
    names: Sequence[str],
    pattern: re.Pattern[str] | None,
    max_pixels: int,
    colour: bool,
) -> PictureCheck:
    """Look at every picture, and at whether it gets a label like the others."""
    check = _check_pictures(root, names, max_pixels=max_pixels, colour=colour)
    are_bad = {bad.picture for bad in check.bad}
    odd: dict[str, BadPicture] = {}
    if pattern is not None or not (root / LABELS).is_file():
        odd = odd_names(names, pattern)
    check.bad += [bad for name, bad in odd.items() if name not in are_bad]
    check.bad.sort(key=lambda bad: _natural_order(bad.picture))
    if check.bad:
        check.lost = _lost(root, names, pattern, check.bad, odd)
    return check


def _lost(
    root: Path,
    names: Sequence[str],
    pattern: re.Pattern[str] | None,
    bad: Sequence[BadPicture],
    odd: Collection[str],
) -> dict[str, BadPicture]:
    """Return the objects, or folders of odd pictures, of which nothing can be used."""
    gone = {picture.picture: picture for picture in bad}
    named = [name for name in names if name not in odd]
    try:
        objects = labels_of(root, named, pattern, _MOST_TABLE).get("object", ())
    except TouchesError:  # said where touches are made of them
        return {}
    labels = dict(zip(named, map(str, objects), strict=False))
    kept = {top for name in names if name not in gone for top in name.split("/")[:1]}
    kept |= {label for name, label in labels.items() if name not in gone}
    if pattern is None or "/" in pattern.pattern:
        labels |= {name: name.partition("/")[0] for name in odd if "/" in name}
    lost: dict[str, BadPicture] = {}
    for name, label in labels.items() if kept else ():
        if label not in kept:
            lost.setdefault(label, gone[name])
    return lost


class _Seen(NamedTuple):
    problem: str
    fix: str
    header: Header | None = None
    coloured: bool = False
    orientation: int = 1
    flat: bool = False
    digest: bytes = b""


def _look(path: Path, max_pixels: int, colour: bool) -> _Seen:
    """Decode one picture."""
    try:
        header, orientation, levels, data = checked_picture(
            path, max_pixels=max_pixels, colour=colour
        )
    except PictureError as error:
        return _Seen(str(error), error.fix)
    except OSError as error:
        return _Seen(error.strerror or str(error), "check it, or take it out")
    digest = hashlib.blake2b(data, digest_size=16).digest()
    flat = bool(np.ptp(levels) == 0)
    counted = header.checked(colour)
    return _Seen("", "", counted, header.colour, orientation, flat, digest)


def _check_pictures(
    root: Path, names: Sequence[str], *, max_pixels: int, colour: bool
) -> PictureCheck:
    """Decode every picture and say which cannot be used, and what else is odd."""
    with ThreadPoolExecutor(n_cores()) as pool:
        looks = pool.map(lambda name: _look(root / name, max_pixels, colour), names)
        seen = dict(zip(names, looks, strict=True))
    headers = [picture.header for picture in seen.values() if picture.header]
    usual = most_common_header(headers) if headers else None
    check = PictureCheck(usual=str(usual or ""))
    first: dict[bytes, str] = {}
    for name, picture in seen.items():
        if picture.header is None:
            check.bad.append(BadPicture(name, picture.problem, picture.fix))
        elif usual is not None and not picture.header.is_like(usual):
            check.bad.append(_another(name, picture.header, usual))
        else:
            check.turned += [name] * (picture.orientation > 1)
            check.flat += [name] * picture.flat
            if (copy := first.setdefault(picture.digest, name)) != name:
                check.same.append((name, copy))
    if not colour:
        bad = {odd.picture for odd in check.bad}
        alike = {n: picture for n, picture in seen.items() if n not in bad}
        in_colour = [n for n, picture in alike.items() if picture.coloured]
        if in_colour and shows_colour(root / in_colour[0]):
            check.coloured = in_colour
            check.grey = [n for n, picture in alike.items() if not picture.coloured]
    return check


def _another(name: str, header: Header, usual: Header) -> BadPicture:
    """Say what is wrong with a picture of another size or depth than most."""
    problem, fix = f"{header}, not {usual}", fix_of_another(header, usual)
    turned = header._replace(n_rows=header.n_cols, n_cols=header.n_rows)
    if turned.is_like(usual):
        problem, fix = f"{problem}: on its side", f"turn it by 90 degrees; {fix}"
    return BadPicture(name, problem, fix)


def shows_colour(file: Path | BytesIO) -> bool:
    """Return whether red, green and blue differ by more than what JPEG does to grey."""
    from PIL import Image

    with Image.open(file) as picture:
        levels = np.asarray(picture.convert("RGB"), np.int16)
    return bool(np.ptp(levels, axis=2).mean() > _GREY_DIFFERS)


def _without_bad(root: Path, names: Sequence[str], check: PictureCheck) -> list[str]:
    """Return the pictures that can be used, and warn of the others."""
    bad = check.bad
    gone = {odd.picture for odd in bad}
    kept = [name for name in names if name not in gone]
    if check.lost or not kept:
        odd = next(iter(check.lost.values()), bad[0])
        lost = listed([*check.lost], 5) or "these objects"
        raise TouchesError(
            f"No picture of {lost} can be used: {odd.picture} is {odd.problem}. "
            f"Fix: {odd.fix}. Or take {lost} out of {root}."
        )
    if bad:
        first = "; ".join(f"{odd.picture} is {odd.problem}" for odd in bad[:_LISTED])
        more = f"; and {len(bad) - _LISTED} more" * (len(bad) > _LISTED)
        n = f"{len(bad)} picture{'s' * (len(bad) > 1)}"
        warnings.warn(
            f"{n} of {len(names)} in {root} left out: {first}{more}.", stacklevel=5
        )
    return kept


def _warn_of_others(root: Path, names: Sequence[str]) -> None:
    """Warn of files that could be touches too, where they are more than those read."""
    of_read = {Path(name).suffix.lower() for name in names}
    kinds = Counter(Path(n).suffix.lower() for n in _files(root) if n != LABELS)
    others = {k: n for k, n in kinds.items() if k in _ALL_KINDS and k not in of_read}
    if sum(others.values()) > len(names):
        left = " and ".join(f"{n} of {kind}" for kind, n in sorted(others.items()))
        warnings.warn(
            f"{root} has {len(names)} of {', '.join(sorted(of_read))}, which are read, "
            f"and {left}, which are left alone. If these are the touches, take the "
            "others out.",
            stacklevel=4,
        )


def _there(no_contact: Path, root: Path) -> None:
    """Refuse a picture of no contact that is not there, with what may be meant."""
    if no_contact.exists():
        return
    inside = root / no_contact.name
    near = f"Did you mean {inside}?" if inside.is_file() else nearest_path(no_contact)
    near = near or nearest_path(inside)
    raise TouchesError(
        f"{no_contact} must be readable, got: No such file or directory. "
        f"{near or 'Give another `no_contact`, or leave it out.'}"
    )


def no_contact_picture(
    path: Path, images: Array, channels: tuple[str, ...] | None, max_pixels: int
) -> Array:
    """Return a picture of no contact that suits the images of an archive."""
    _there(path, path.parent)
    n_bits = {"uint8": 8, "uint16": 16}.get(images.dtype.name)
    if n_bits is None or channels not in (None, RGB):
        named = "" if channels is None else f" and channels {', '.join(channels)}"
        raise TouchesError(
            "no_contact must have the unit of the images, got a picture for images "
            f"of {images.dtype}{named}. "
            "Use touches.with_columns(no_contact=image) if they share one."
        )
    n_rows, n_cols = images.shape[1:3]
    like = Header("PNG", n_rows, n_cols, n_bits, channels is not None)
    return _like(path, like, max_pixels)


def _like(path: Path, like: Header, max_pixels: int) -> Array:
    """Return the picture of no contact, which must be as large and deep as `like`."""
    header = _pictures.picture_header(path, max_pixels=max_pixels, colour=like.colour)
    if not header.is_like(like):
        raise TouchesError(
            f"no_contact must be {like.n_cols} x {like.n_rows} {like.n_bits}-bit like "
            f"the touches, got {header} in {path}. Convert it, or give another."
        )
    return decode_picture(path, header)[0]


def _picture_names(root: Path, no_contact: Path | None) -> list[str]:
    try:
        files = _files(root)
        there = {Path(name).suffix.lower() for name in files}
        read = next((kinds for kinds in _KINDS_OF_FILES if there & {*kinds}), ())
        pictures = [n for n in files if Path(n).suffix.lower() in read and n != LABELS]
        if no_contact and root.resolve() in no_contact.resolve(strict=True).parents:
            pictures = [n for n in pictures if not no_contact.samefile(root / n)]
    except OSError as error:
        raise _pictures.refusal(Path(error.filename or root), error) from error
    if not pictures:
        kinds = sorted({Path(name).suffix or "no ending" for name in files})
        got = f"{len(files)} files of {', '.join(kinds[:5])}" if files else "no files"
        hint = " Archives are loaded one by one." if ".npz" in kinds else ""
        if ".sqlite" in kinds:
            hint = " Of a library: TouchLibrary.open(path).touches()."
        if films := [kind for kind in kinds if kind.lower() in FILMS]:
            hint += f" Films ({films[0]}) are read one by one, each for its object."
        raise TouchesError(
            f"{root} must hold pictures ending in {', '.join(PICTURES)}, or "
            f"{', '.join((*TABLES, *_ONE_TOUCH_A_FILE))} files, got {got}. "
            f"Convert them, or give another folder.{hint}"
        )
    return sorted(pictures, key=_natural_order)


def _walk(root: Path) -> Iterator[tuple[Path, list[str], list[str]]]:
    """Yield folders below `root` but hidden ones, the folders and the files in each.

    Symbolic links are followed.
    """
    seen: dict[tuple[int, int], str] = {}
    for folder, folders, files in os.walk(root, onerror=_raised, followlinks=True):
        status = Path(folder).stat()
        first = seen.setdefault((status.st_dev, status.st_ino), folder)
        if first != folder:
            raise TouchesError(
                f"{folder} must not lead back to {first}, got a symbolic link that "
                "does: its pictures would count twice. Remove the link."
            )
        folders[:] = [name for name in folders if not name.startswith(".")]
        yield Path(folder).relative_to(root), folders, files


def _files(root: Path) -> list[str]:
    """Return all files below `root` but hidden ones."""
    if not root.is_dir():
        raise TouchesError(
            f"{root} must be a folder of pictures, got none there. "
            f"{nearest_path(root) or 'Check the path.'}"
        )
    paths = [here / name for here, _, files in _walk(root) for name in files]
    return [path.as_posix() for path in paths if not path.name.startswith(".")]


def _raised(error: OSError) -> None:
    raise error


def _natural_order(name: str) -> tuple[Any, ...]:
    """Sort numbers within names by value, folder by folder."""
    parts = [
        [int(piece) if i % 2 else piece.casefold() for i, piece in enumerate(pieces)]
        for pieces in (re.split(r"(\d+)", part) for part in name.split("/"))
    ]
    return parts, name
