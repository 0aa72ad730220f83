"""From a source's files to the arrays of an archive, by the rules of its card.

`[convert]` of a card has the `pattern` of the files' paths, whose named groups fill
the columns; how a file is `read`; which to `keep`, by a mask of numbers for each
object; the groups to `sort` by. `ways` make the image of a file; where there are
several, nobody wrote down which the archive behind the figures has: all are compared.

Files are read in memory, and never unpacked under names of the source.
"""

import io
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from typing import Any

import numpy as np

from .._types import Array
from ..touches import decode_bytes

Read = Callable[[], bytes]
Groups = dict[str, Any]
Rule = dict[str, Any]
_NUMBER = re.compile(r"-?[1-9]\d*|0").fullmatch
Made = tuple[dict[str, Array], dict[str, bytes]]  # arrays, and files beside by path


def converted(files: Mapping[str, Read], rule: Rule) -> Iterator[Made]:
    """Yield the arrays of a set, in each way that its images may have been made."""
    rows, masks = _matching(files, rule["pattern"]), rule.get("keep")
    if masks is not None:  # hexadecimal, by object: bit n is whether number n is kept
        bits = {name: int(mask, 16) for name, mask in masks.items()}
        rows = [row for row in rows if bits.get(row[0]["object"], 0) >> row[0]["n"] & 1]
    if rule["read"] == "films":
        yield from _films({groups["object"]: read() for groups, read in rows})
        return
    rows.sort(key=lambda row: [row[0][name] for name in rule["sort"]])
    groups, data = [row[0] for row in rows], [row[1]() for row in rows]
    seen: Counter[tuple[Any, ...]] = Counter()
    for one in groups:  # the place of each file within its recording
        recording = tuple(one[name] for name in rule.get("recording", []))
        one["place"] = seen[recording]
        seen[recording] += 1
    columns = {name: _column(groups, how) for name, how in rule["columns"].items()}
    whole = {name: np.array(value) for name, value in rule.get("whole", {}).items()}
    member, pairs = rule.get("beside", ""), zip(groups, data, strict=True)
    beside = {one["path"]: d for one, d in pairs if one.get("member") == member}
    levels = [_READ[rule["read"]](content, rule) for content in data]
    if "no_contact" in rule:
        one, read = _matching(files, rule["no_contact"])[0]
        beside[one["path"]] = read()
        idle = _READ[rule["read"]](beside[one["path"]], rule)
        whole["no_contact"] = _WAYS[rule["ways"][0]](idle)
    for way in rule["ways"]:
        images = np.stack([_WAYS[way](picture) for picture in levels])
        yield {"images": images, **columns, **whole}, beside


def _matching(files: Mapping[str, Read], pattern: str) -> list[tuple[Groups, Read]]:
    """Return what matches the end of each path; in several folders, the first counts.

    `path` is the part that matches; a group of digits without a leading 0 is a number.
    """
    found: dict[str, tuple[Groups, Read]] = {}
    for path in sorted(files):
        match = re.search(rf"(?:^|/)(?P<path>{pattern})$", path)
        if match:
            told = match.groupdict().items()
            groups = {name: int(t) if _NUMBER(t) else t for name, t in told}
            found.setdefault(match["path"], (groups, files[path]))
    if not found:
        raise ValueError(
            f"the source must hold files like {pattern}, got none among {len(files)}. "
            "It is laid out in another way than palpate knows: please report it."
        )
    return list(found.values())


def _column(rows: list[Groups], how: Rule) -> Array:
    """Fill the templates of a column from the groups of each path."""
    of, kind = how["of"], how["type"]
    if isinstance(of, list):
        return np.array([[int(one.format(**g)) for one in of] for g in rows], kind)
    texts = [of.format(**groups) for groups in rows]
    if not kind.startswith("<U"):
        return np.array([int(text) + how.get("add", 0) for text in texts], kind)
    told = [text.lower() if "lower" in how else text for text in texts]
    return np.array(told, f"<U{max([int(kind[2:]), *map(len, told)])}")


def _counts(data: bytes, rule: Rule) -> Array:
    """Return the numbers of a text; lines with letters are headings."""
    lines = data.decode("ascii", "replace").splitlines()
    numbers = " ".join(line for line in lines if not re.search("[A-Za-z]", line))
    return np.array(numbers.split(), float).astype(np.uint16).reshape(*rule["shape"])


def _means(levels: Array, side: int) -> Array:
    """Return the means of squares of `side` pixels, rounded."""
    rows, cols, *channels = levels.shape
    squares = levels.reshape(rows // side, side, cols // side, side, *channels)
    return np.asarray(np.rint(squares.mean((1, 3))), np.uint8)


def _films(data: Mapping[str, bytes]) -> Iterator[Made]:
    """MATLAB films of presses, C (100 taxels, frames, presses), one file an object.

    Whether frame 600 was counted from 0 or from 1 is not written down.
    """
    loadmat: Any = import_module("scipy.io").loadmat  # its types know no open file

    names, index = sorted(data), np.arange(300, 900, 20)
    films = [loadmat(io.BytesIO(data[n]), variable_names=["C"])["C"] for n in names]
    grids = [film.T.reshape(*film.shape[:0:-1], 10, 10) for film in films]
    presses = [np.arange(len(grid), dtype=np.int16) for grid in grids]
    for first in (0, 1):
        frames = [grid[:, index - first].astype(np.float32) for grid in grids]
        arrays = {
            "images": np.concatenate([grid[:, 600 - first] for grid in grids]),
            "object": np.repeat(np.array(names, "<U16"), list(map(len, grids))),
            "press": np.concatenate(presses),
            "frames": np.concatenate(frames),
            "frame_index": index,
        }
        yield arrays, {}


_READ: dict[str, Callable[[bytes, Rule], Array]] = {
    "grey": lambda data, rule: decode_bytes(data),
    "colour": lambda data, rule: decode_bytes(data, colour=True),
    "counts": _counts,
}
_WAYS: dict[str, Callable[[Array], Array]] = {
    "as it is": lambda levels: levels,
    "dome": lambda levels: _means(levels[:, :480], 4),
    "half": lambda levels: _means(levels, 2),
    "every other": lambda levels: levels[::2, ::2],
    "middle frame": lambda film: film[len(film) // 2],
    "third frame": lambda film: film[2],
    "first frame": lambda film: film[0],
    "last frame": lambda film: film[-1],
}
