"""Converting: files of a source, in memory, become the arrays of a set.

`[convert]` of a card has the `pattern` of the files' paths, whose named groups fill
the columns; how a file is `read`; which to `keep`, by a mask of numbers for each
object; the groups to `sort` by. `ways` make the image of a file; where there are
several, nobody wrote down which the archive behind the figures has: all are compared.
"""

import hashlib
import io
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import import_module
from itertools import chain
from math import prod
from typing import Any, NamedTuple

import numpy as np

from .._types import Array
from ..touches import decode_bytes

Groups = dict[str, Any]
Rule = dict[str, Any]
Made = tuple[dict[str, Array], dict[str, bytes]]  # arrays, and files beside by path
_NUMBER = re.compile(r"-?[1-9]\d{0,17}|0").fullmatch
# No source has longer paths, larger pictures or longer texts; patterns take long over
# long names.
LONGEST_PATH, _MOST_PIXELS, _LONGEST_TEXT = 260, 640 * 480, 10**7
_MOST_NUMBERS = 2 * 10**7, 10**8  # of one film, and of all


class Member(NamedTuple):
    """A file of a source: its size in bytes, and what reads it."""

    n_bytes: int
    read: Callable[[], bytes]


def converted(
    files: Mapping[str, Member], rule: Rule, n_touches: int, most_bytes: int
) -> Iterator[Made]:
    """Yield the arrays of a set, in each way that its images may have been made.

    Raises ValueError where files are others, or more, than the set can have.
    """
    rows, masks = _matching(files, rule["pattern"]), rule.get("keep")
    if masks is not None:  # hexadecimal, by object: bit n is whether number n is kept
        bits = {name: int(mask, 16) for name, mask in masks.items()}
        rows = [row for row in rows if bits.get(row[0]["object"], 0) >> row[0]["n"] & 1]
    _refuse_many([file for _, file in rows], 3 * n_touches, most_bytes)
    if rule["read"] == "films":
        yield from _films({groups["object"]: file.read() for groups, file in rows})
        return
    rows.sort(key=lambda row: [row[0][name] for name in rule["sort"]])
    groups, data = [row[0] for row in rows], [row[1].read() for row in rows]
    seen: Counter[tuple[Any, ...]] = Counter()
    for groups_of_file in groups:  # the place of each file within its recording
        recording = tuple(groups_of_file[name] for name in rule.get("recording", []))
        groups_of_file["place"] = seen[recording]
        seen[recording] += 1
    columns = {name: _column(groups, how) for name, how in rule["columns"].items()}
    whole = {name: np.array(value) for name, value in rule.get("whole", {}).items()}
    member, pairs = rule.get("beside", ""), zip(groups, data, strict=True)
    beside = {
        groups_of_file["path"]: d
        for groups_of_file, d in pairs
        if groups_of_file.get("member") == member
    }
    levels = [_READ[rule["read"]](content, rule) for content in data]
    if "no_contact" in rule:
        groups_of_file, file = _matching(files, rule["no_contact"])[0]
        _refuse_many([file], 1, most_bytes)
        beside[groups_of_file["path"]] = file.read()
        idle = _READ[rule["read"]](beside[groups_of_file["path"]], rule)
        whole["no_contact"] = _WAYS[rule["ways"][0]](idle)
    for way in rule["ways"]:
        images = np.stack([_WAYS[way](picture) for picture in levels])
        yield {"images": images, **columns, **whole}, beside


def digest(array: Array) -> str:
    """Return the SHA-256 of an array's kind, shape and values; text of any width."""
    text = array.dtype.kind == "U"
    values = "\0".join(array.ravel().tolist()).encode() if text else array.tobytes()
    head = f"{'U' if text else array.dtype.str}{array.shape}".encode()
    return hashlib.sha256(head + values).hexdigest()


def _refuse_many(files: Sequence[Member], most: int, most_bytes: int) -> None:
    """Refuse more files, or bytes of them, than a set can have, before any is read."""
    if len(files) > most:
        raise ValueError(
            f"the source must have at most {most} files, got {len(files)}."
        )
    n_bytes = sum(file.n_bytes for file in files)
    if n_bytes > most_bytes:
        raise ValueError(
            f"the source's files must have at most {most_bytes / 1e6:.0f} MB, got "
            f"{n_bytes / 1e6:.0f}."
        )


def _matching(files: Mapping[str, Member], pattern: str) -> list[tuple[Groups, Member]]:
    """Return what matches the end of each path; in several folders, the first counts.

    `path` is the part that matches; a group of digits without a leading 0 is a number.
    """
    matches: dict[str, tuple[Groups, Member]] = {}
    wanted = re.compile(rf"(?:^|/)(?P<path>{pattern})$")
    for path in sorted(files):
        if len(path) <= LONGEST_PATH and (match := wanted.search(path)):
            texts = match.groupdict().items()
            groups = {name: int(t) if _NUMBER(t) else t for name, t in texts}
            matches.setdefault(match["path"], (groups, files[path]))
    if not matches:
        raise ValueError(
            f"the source must hold files like {pattern}, got none among {len(files)}. "
            "It is laid out in another way than palpate knows: please report it."
        )
    return list(matches.values())


def _column(rows: list[Groups], how: Rule) -> Array:
    """Fill the templates of a column from the groups of each path."""
    source, kind = how["of"], how["type"]
    if isinstance(source, list):
        return np.array(
            [[int(template.format(**g)) for template in source] for g in rows], kind
        )
    texts = [source.format(**groups) for groups in rows]
    if not kind.startswith("<U"):
        return np.array([int(text) + how.get("add", 0) for text in texts], kind)
    texts_kept = [text.lower() if "lower" in how else text for text in texts]
    return np.array(texts_kept, f"<U{max([int(kind[2:]), *map(len, texts_kept)])}")


def _counts(data: bytes, rule: Rule) -> Array:
    """Return the numbers of a text; lines with letters are headings."""
    if len(data) > _LONGEST_TEXT:
        raise ValueError(
            f"a text of counts must have at most {_LONGEST_TEXT} bytes, "
            f"got {len(data)}."
        )
    lines = data.decode("ascii", "replace").splitlines()
    numbers = (line.split() for line in lines if not re.search("[A-Za-z]", line))
    counts = np.fromiter(map(float, chain.from_iterable(numbers)), float)
    if not (counts >= 0).all() or (counts >= 2**16).any():
        raise ValueError("counts must be 0 to 65535, got others.")
    return counts.astype(np.uint16).reshape(*rule["shape"])


def _means(levels: Array, side: int) -> Array:
    """Return the means of squares of `side` pixels, rounded."""
    rows, cols, *channels = levels.shape
    squares = levels.reshape(rows // side, side, cols // side, side, *channels)
    return np.asarray(np.rint(squares.mean((1, 3))), np.uint8)


def _films(data: Mapping[str, bytes]) -> Iterator[Made]:
    """MATLAB films of presses, C (100 taxels, frames, presses), one file an object.

    Whether frame 600 was counted from 0 or from 1 is not written down.
    """
    names, index = sorted(data), np.arange(300, 900, 20)
    films, n_numbers = [], 0
    for name in names:
        films.append(_film(name, data[name]))
        n_numbers += films[-1].size
        if n_numbers > _MOST_NUMBERS[1]:
            raise ValueError(f"films must have at most {_MOST_NUMBERS[1]} numbers.")
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


def _film(name: str, data: bytes) -> Array:
    """Return C of a MATLAB file, whose size is known before it is read."""
    scipy_io: Any = import_module("scipy.io")  # its types know no open file
    try:
        sizes = {n: shape for n, shape, _ in scipy_io.whosmat(io.BytesIO(data))}
        shape = sizes.get("C", ())
        if len(shape) == 3 and prod(shape) <= _MOST_NUMBERS[0]:
            film = scipy_io.loadmat(io.BytesIO(data), variable_names=["C"])["C"]
            if film.shape == shape and film.dtype.kind in "iuf":
                return np.asarray(film)
        got = f"an array C of shape {shape}" if shape else f"{sorted(sizes)[:5]}"
    except Exception as error:  # scipy raises a dozen kinds on damaged files
        got = f"a file that cannot be read ({error})"
    raise ValueError(
        f"the film of {name!r} must hold C (100 taxels, frames, presses) of at most "
        f"{_MOST_NUMBERS[0]} numbers, got {got}."
    )


_READ: dict[str, Callable[[bytes, Rule], Array]] = {
    "grey": lambda data, rule: decode_bytes(data, max_pixels=_MOST_PIXELS),
    "colour": lambda data, rule: decode_bytes(
        data, max_pixels=_MOST_PIXELS, colour=True
    ),
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
