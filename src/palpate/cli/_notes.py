"""What is said of touches that were read: how, and what of them is not looked at."""

import re
from collections import Counter
from operator import ne
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ._options import Reading, kind_of
from ._output import counted

if TYPE_CHECKING:
    from ..touches import Touches, TouchSource

# Pictures in files that are not read beside JPEG and PNG.
STILLS = (".bmp", ".webp", ".tif", ".tiff", ".gif", ".heic", ".avif")
_LEAST_STUCK = 5  # touches in which a taxel reads the same


def read_as(reading: Reading, path: Path, touches: "Touches | TouchSource") -> str:
    """Return how the folders above pictures were understood, if nobody said it.

    Of a library that it is one.
    """
    kind = kind_of(path)
    named = reading.levels is not None or reading.name_pattern is not None
    if kind != "folder" or named or (path / "labels.csv").is_file():
        return "a library" if kind == "library" else ""
    names = ("category", "object", "session")
    levels = [name for name in names if getattr(touches, name) is not None]
    if len(levels) < 2:
        return ""
    return f"folders were read as {'/'.join(levels)}; --levels says otherwise"


def left_aside(reading: Reading, path: Path, touches: "Touches | TouchSource") -> str:
    """Return what of touches may be looked at wrongly, or not, if nobody said it.

    The colour of pictures, pictures that are not read or named in several ways,
    columns of numbers, and taxels that never change.
    """
    from ..touches import Touches

    kind, notes = kind_of(path), []
    if not isinstance(touches, Touches):
        return ""
    if reading.colour is None and kind == "folder" and touches.hides_colour():
        notes.append(
            "pictures in colour were read in grey: --colour, if colour tells, as "
            "behind a gel"
        )
    if kind == "folder":
        notes += [_stills_left(path, touches), named_in_ways(reading, path, touches)]
    else:
        notes += [_read_as_taxels(path, touches), _stuck_taxels(touches)]
    return "; ".join(filter(None, notes))


def named_in_ways(reading: Reading, path: Path, touches: "Touches") -> str:
    """Return that pictures of each object are named in the same several ways."""
    labels, names = touches.object, touches.columns.get("source_path")
    is_said = reading.name_pattern is not None or (path / "labels.csv").is_file()
    if kind_of(path) != "folder" or is_said or labels is None or names is None:
        return ""
    stems = [re.sub(r"\d+", "#", Path(name).stem) for name in names.tolist()]
    ways: dict[str, Counter[str]] = {}
    for label, stem in zip(labels.tolist(), stems, strict=True):
        ways.setdefault(label, Counter())[stem] += 1
    kinds = {way for of_object in ways.values() for way in of_object}
    of_all = all(way.keys() == kinds for way in ways.values()) and len(ways) > 1
    if not of_all or 2 * len(kinds) > min(way.total() for way in ways.values()):
        return ""
    return (
        f"pictures of each object are named in {len(kinds)} ways "
        f"({', '.join(sorted(kinds)[:5])}), and all count as touches: take out "
        "those of another camera, and those of no touch"
    ) * (len(kinds) > 1)


def refuse_another_order(first: Path, training: Any, other: Path, touches: Any) -> None:
    """Refuse text files of the same taxels in two orders."""
    from ..touches import taxel_names

    names = taxel_names(first, training.columns)
    others = taxel_names(other, touches.columns)
    if names != others and sorted(names) == sorted(others):
        n = [*map(ne, names, others)].index(True)
        raise ValueError(
            f"{other} must have its taxels in the order of {first}, got {others[n]} "
            f"where {names[n]} is. Sort its columns so."
        )


def _stills_left(path: Path, touches: "Touches") -> str:
    """Return how many pictures are not read beside those of other endings."""
    names = touches.columns.get("source_path")
    read = set() if names is None else {Path(n).suffix.lower() for n in names.tolist()}
    parts = [file.relative_to(path).parts for file in path.rglob("*")]
    shown = [part[-1] for part in parts if not any(p.startswith(".") for p in part)]
    kinds = Counter(Path(name).suffix.lower() for name in shown)
    left = {kind: kinds[kind] for kind in STILLS if kinds[kind] and kind not in read}
    few = " and ".join(f"{count} of {kind}" for kind, count in left.items())
    return f"pictures left alone: {few}; save them as PNG" if read and left else ""


def _stuck_taxels(touches: "Touches") -> str:
    """Return the taxels that read one number in all touches, beyond all others'.

    Of a camera's picture, which has a frame about it, none.
    """
    import numpy as np

    from ..recognition import find_geometry

    if find_geometry(touches) not in ("array", "none"):
        return ""
    images = touches.images.reshape(len(touches), -1)
    low, high = images.min(axis=0), images.max(axis=0)
    still = low == high
    if len(images) < _LEAST_STUCK or still.all() or np.isnan(low[~still]).all():
        return ""
    beyond = (low > np.nanmax(high[~still])) | (low < np.nanmin(low[~still]))
    stuck = np.flatnonzero(still & beyond)
    if not 0 < len(stuck) <= low.size / 10:  # more are a rim, or a gap between pads
        return ""
    where = np.unravel_index(stuck[0], touches.images.shape[1:])
    first = f"row {where[0]}, column {where[1]} reads {low[stuck[0]]:g}"
    return (
        f"{counted(len(stuck), 'taxel')} of one reading in all touches, beyond those "
        f"of all others ({first}): where it is dead, write NaN"
    )


def _read_as_taxels(path: Path, touches: "Touches") -> str:
    """Return which columns of a text file are taxels, where names leave it open."""
    from ..touches import in_order, taxel_names

    taxels, notes = taxel_names(path, touches.columns), []
    if taxels and touches.geometry == "none" and (names := touches.unknown_names):
        listed = ", ".join(names[:5]) + " and more" * (len(names) > 5)
        notes.append(
            f"numbers beside the numbered taxels are kept, not looked at "
            f"({listed}): what tells objects apart must have a taxel's name and "
            "the next number"
        )
    if not in_order(taxels) and len(taxels) == touches.images[0].size:
        few = ", ".join(taxels)
        if len(taxels) > 8:
            few = ", ".join([*taxels[:4], "...", *taxels[-3:]])
        notes.append(
            f"{len(taxels)} columns of numbers were read as taxels, in this order: "
            f"{few}; take out what is none, such as times and numbers of objects"
        )
    return "; ".join(notes)
