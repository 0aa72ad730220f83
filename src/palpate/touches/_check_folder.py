"""Every picture of a folder that cannot be used, in one list, with its fix."""

import hashlib
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ._columns import TouchesError
from ._pictures import (
    GREY_WHERE_COLOUR,
    Header,
    PictureError,
    checked_picture,
    n_cores,
)

_GREY_DIFFERS = 8.0  # levels of 255, in the mean over a picture


class BadPicture(NamedTuple):
    """A picture that cannot be used: its path in the folder, why, and the fix."""

    picture: str
    problem: str
    fix: str


@dataclass
class PictureCheck:
    """The findings in the pictures of a folder.

    Attributes
    ----------
    bad : list of BadPicture
        Those that cannot be read, are unlike most, or get no label.
    usual : str
        Size and format of the others.
    turned : int
        How many were turned upright, as their Exif orientation says.
    flat : list of str
        Pictures of one level all over.
    same : list of (str, str)
        Pictures that are a copy of another one.
    coloured, grey : int
        How many of those that can be used are in colour, and in grey, where all were
        read in grey and the first in colour shows some; else 0.
    """

    bad: list[BadPicture] = field(default_factory=list)
    usual: str = ""
    turned: int = 0
    flat: list[str] = field(default_factory=list)
    same: list[tuple[str, str]] = field(default_factory=list)
    coloured: int = 0
    grey: int = 0


class _Seen(NamedTuple):
    header: Header | None
    coloured: bool
    orientation: int
    flat: bool
    digest: bytes
    problem: str


def check_pictures(
    root: Path, names: Sequence[str], *, max_pixels: int, colour: bool
) -> PictureCheck:
    """Decode every picture and say which cannot be used, and what else is odd."""

    def look(name: str) -> _Seen:
        try:
            header, orientation, levels, data = checked_picture(
                root / name, max_pixels=max_pixels, colour=colour
            )
        except (OSError, PictureError) as error:
            strerror = getattr(error, "strerror", None)
            return _Seen(None, False, 1, False, b"", strerror or str(error))
        digest = hashlib.blake2b(data, digest_size=16).digest()
        flat = bool(np.ptp(levels) == 0)
        counted = header.checked(colour)
        return _Seen(counted, header.colour, orientation, flat, digest, "")

    with ThreadPoolExecutor(n_cores()) as pool:
        seen = dict(zip(names, pool.map(look, names), strict=True))
    headers = Counter(picture.header for picture in seen.values() if picture.header)
    check = PictureCheck()
    if not headers:
        usual = None
    else:
        usual = headers.most_common(1)[0][0]
        check.usual = str(usual)
    first: dict[bytes, str] = {}
    for name, picture in seen.items():
        if picture.header is None:
            check.bad.append(BadPicture(name, picture.problem, _fix(picture.problem)))
        elif picture.header != usual:
            fix = "convert it, or keep the two kinds in folders of their own"
            check.bad.append(BadPicture(name, f"{picture.header}, not {usual}", fix))
        else:
            check.turned += picture.orientation > 1
            check.flat += [name] * picture.flat
            if (copy := first.setdefault(picture.digest, name)) != name:
                check.same.append((name, copy))
    if not colour:
        alike = {name: one for name, one in seen.items() if one.header == usual}
        in_colour = [name for name, one in alike.items() if one.coloured]
        if in_colour and _shows_colour(root / in_colour[0]):
            check.coloured = len(in_colour)
            check.grey = len(alike) - len(in_colour)
    return check


def _shows_colour(path: Path) -> bool:
    """Return whether red, green and blue differ by more than what JPEG does to grey."""
    from PIL import Image

    with Image.open(path) as picture:
        levels = np.asarray(picture.convert("RGB"), np.int16)
    return bool(np.ptp(levels, axis=2).mean() > _GREY_DIFFERS)


def _fix(problem: str) -> str:
    if GREY_WHERE_COLOUR in problem:
        return "leave out `colour`, or take it out"
    if "pixels" in problem and "more than" in problem:
        return "make it smaller"
    return "save it again as 8-bit JPEG or PNG, or take it out"


def without_bad(names: Sequence[str], bad: Sequence[BadPicture]) -> list[str]:
    """Return the pictures that can be used; refuse a folder that has none."""
    gone = {odd.picture for odd in bad}
    kept = [name for name in names if name not in gone]
    if not kept:
        raise TouchesError(
            f"Pictures must be usable, got {len(names)} of which none is: "
            f"{bad[0].picture} is {bad[0].problem}. Fix: {bad[0].fix}."
        )
    return kept
