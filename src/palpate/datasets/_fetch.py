"""Fetching: download, check, convert, write; each step whole or not at all.

Downloads lie in `.downloads/NAME` until the archive is made. Where the card has no
SHA-256, that of the first goes to `.fetched/NAME.sha256`; a later one must be the same.
What is made is compared with the arrays behind the figures, whose SHA-256 the card has.

`[convert]` of a card has the `pattern` of the files' paths, whose named groups fill
the columns; how a file is `read`; which to `keep`, by a mask of numbers for each
object; the groups to `sort` by. `ways` make the image of a file; where there are
several, nobody wrote down which the archive behind the figures has: all are compared.
Files are read in memory, and never unpacked under names of the source.
"""

import hashlib
import io
import os
import re
import shutil
import sys
import tomllib
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from .._checks import check_option
from .._durable import replacing, write_text
from .._extras import needed
from .._types import Array
from ..touches import Touches, decode_bytes

_CARDS = files(__package__) / "cards"
_CACHES = {"win32": "AppData/Local", "darwin": "Library/Caches"}
_MB = 10**6
_MOST_IN_ZIP = 100 * _MB  # of one file; zipfile inflates no more than it promises
Say = Callable[[str], None]
Read = Callable[[], bytes]
Groups = dict[str, Any]
Rule = dict[str, Any]
_NUMBER = re.compile(r"-?[1-9]\d*|0").fullmatch
Made = tuple[dict[str, Array], dict[str, bytes]]  # arrays, and files beside by path


def names() -> tuple[str, ...]:
    """Return the names of all sets, sorted."""
    return tuple(sorted(one.name.removesuffix(".toml") for one in _CARDS.iterdir()))


def card(name: str) -> dict[str, Any]:
    """Return what is known of the set `name`, by headings; a ValueError lists them."""
    check_option("name", name, names())
    text = (_CARDS / f"{name}.toml").read_text(encoding="utf-8")
    return {"name": name, **tomllib.loads(text)}


def where(folder: str | Path | None = None) -> Path:
    """Return the folder of recorded touches, which may not be there yet.

    It is `folder`; by default what PALPATE_DATA names, else the cache: what
    PALPATE_DATA_HOME names, else `palpate` in the caches of this computer.
    """
    told = (folder, os.environ.get("PALPATE_DATA"), os.environ.get("PALPATE_DATA_HOME"))
    for named in told:
        if named:
            return Path(named)
    caches = "LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME"
    usual = Path.home() / _CACHES.get(sys.platform, ".cache")
    return Path(os.environ.get(caches) or usual) / "palpate"


def fetch(
    name: str,
    *,
    folder: str | Path | None = None,
    mirror: str | None = None,
    progress: Say | None = None,
) -> Path:
    """Fetch a set from its public source, if it is not there; return its archive.

    Parameters
    ----------
    name : str
        One of `names()`.
    folder : path, optional
        Where it goes; see `where`.
    mirror : str, optional
        What stands for `https://HOST` in the source's address. Default:
        PALPATE_DATA_MIRROR, if it names anything.
    progress : callable, optional
        Called with the present stage, a text.

    Warns where no SHA-256 was known, and where arrays are not those behind the figures.
    Raises ValueError for another name, or a source that has changed, is damaged or too
    large; OSError where it cannot be reached or the folder not be written; ImportError
    without pooch. Nothing half done is left.
    """
    one, here = card(name), where(folder)
    made: list[Path] = [here / place for place in one["makes"]]
    if all(place.exists() for place in made):
        return made[0]
    if "why_not" in one:
        raise ValueError(f"{name} cannot be fetched: {one['why_not']}")
    downloads, seen = here / ".downloads" / name, here / ".fetched" / f"{name}.sha256"
    known = one["source"]["sha256"] or (seen.read_text() if seen.is_file() else "")
    with _explained(name, downloads, seen):
        load = partial(_download, one, downloads, progress or (lambda stage: None))
        url = _address(one["source"]["url"], mirror)
        with _source(one, url, known, load) as source:
            chosen, differs = _chosen(one, source)
        _write(made, *chosen)
        with (downloads / "source").open("rb") as file:
            got = hashlib.file_digest(file, "sha256").hexdigest()
        seen.parent.mkdir(exist_ok=True)
        write_text(seen, got)
        shutil.rmtree(downloads, ignore_errors=True)
    if not known:
        trusted = "no SHA-256 of the source was known, so this download was trusted"
        warnings.warn(f"{name}: {trusted}; a later one must have {got}.", stacklevel=2)
    if differs:
        others = f"{', '.join(differs)} are not the arrays behind the figures"
        warnings.warn(f"{name}: {others}: say so beside what you make.", stacklevel=2)
    return made[0]


def load(
    name: str,
    *,
    folder: str | Path | None = None,
    mirror: str | None = None,
    progress: Say | None = None,
) -> Touches:
    """Return the touches of a set, fetched first if it is not there.

    Parameters and errors as for `fetch`: `name` is one of `names()`, `folder` where the
    set is or goes, `mirror` stands for the source's host, `progress` is called with the
    present stage.
    """
    return Touches.load(fetch(name, folder=folder, mirror=mirror, progress=progress))


def _address(url: str, mirror: str | None) -> str:
    """Return the address with the mirror in place of the host, if there is one."""
    root = mirror or os.environ.get("PALPATE_DATA_MIRROR")
    if root and not re.match(r"https?://[^/]", root):
        raise ValueError(f"mirror must begin with https:// or http://, got {root!r}.")
    return f"{root.rstrip('/')}{urlsplit(url).path}" if root else url


def _download(
    one: dict[str, Any], folder: Path, say: Say, url: str, name: str, known: str
) -> Path:
    """Return a download, whole and with the SHA-256 that is known, if one is."""
    pooch = needed("pooch", "data", "Fetching recorded touches")
    pooch.get_logger().setLevel("WARNING")
    downloader = pooch.HTTPDownloader(
        progressbar=_Meter(one["name"], one["source"]["most_mb"], say),
        chunk_size=2**16,
        timeout=30,
        headers={"Accept-Encoding": "identity"},
    )
    return Path(pooch.retrieve(url, known or None, name, folder, downloader=downloader))


class _Meter:
    """What pooch takes for a bar: says how far it is, refuses what is too large."""

    def __init__(self, name: str, most_mb: int, say: Say) -> None:
        self.total, self._done = 0, 0
        self._name, self._most_mb, self._say = name, most_mb, say

    def update(self, n_bytes: int) -> None:
        self._done += n_bytes
        if max(self.total, self._done) > self._most_mb * _MB:
            got = f"got {max(self.total, self._done) / _MB:.0f}"
            raise ValueError(f"the source must have at most {self._most_mb} MB, {got}.")
        self._say(f"{self._name}: {self._done // _MB} of {self.total // _MB or '?'} MB")

    def reset(self) -> None:
        self._done = 0

    def close(self) -> None:
        pass


@contextmanager
def _source(
    one: dict[str, Any], url: str, known: str, load: Callable[[str, str, str], Path]
) -> Iterator[Mapping[str, Read]]:
    """Yield the files of a zip, or those that a list of checksums names."""
    first = load(url, "source", known)
    if "listed" in one["source"]:
        wanted = re.compile(rf"([0-9a-f]{{64}}) [ *]?({one['source']['listed']})")
        told = map(wanted.fullmatch, first.read_text(errors="replace").splitlines())
        base = url.rpartition("/")[0]
        yield {m[2]: load(f"{base}/{m[2]}", m[1], m[1]).read_bytes for m in told if m}
        return
    with zipfile.ZipFile(first) as archive:
        small = [info for info in archive.infolist() if info.file_size <= _MOST_IN_ZIP]
        yield {info.filename: partial(archive.read, info) for info in small}


def _chosen(one: dict[str, Any], source: Mapping[str, Read]) -> tuple[Made, list[str]]:
    """Return the version behind the figures, else the first, and what differs."""
    tried: list[tuple[Made, list[str]]] = []
    for made in _converted(source, one["convert"]):
        Touches(**made[0])  # refuses what would not read as an archive
        got = {name: digest(array) for name, array in made[0].items()}
        differs = [n for n, wanted in one["arrays"].items() if got.get(n) != wanted]
        tried = [*tried[:1], (made, differs)]
        if not differs:
            return tried[-1]
    return tried[0]


def digest(array: Array) -> str:
    """Return the SHA-256 of an array's kind, shape and values; text of any width."""
    text = array.dtype.kind == "U"
    values = "\0".join(array.ravel().tolist()).encode() if text else array.tobytes()
    head = f"{'U' if text else array.dtype.str}{array.shape}".encode()
    return hashlib.sha256(head + values).hexdigest()


def _write(
    made: list[Path], arrays: dict[str, Array], beside: dict[str, bytes]
) -> None:
    """Write the files beside, then the archive, each whole or not at all."""
    archive, *folders = made
    archive.parent.mkdir(parents=True, exist_ok=True)
    for folder in folders:
        partly = folder.with_name(f".partial-{folder.name}")
        shutil.rmtree(partly, ignore_errors=True)
        for name, data in beside.items():
            (partly / name).parent.mkdir(parents=True, exist_ok=True)
            (partly / name).write_bytes(data)
        if not folder.exists():
            partly.rename(folder)
        shutil.rmtree(partly, ignore_errors=True)
    with replacing(archive) as file:
        plain: dict[str, Any] = dict(arrays)  # numpy 2.0 has no allow_pickle
        np.savez_compressed(file, **plain)


@contextmanager
def _explained(name: str, downloads: Path, seen: Path) -> Iterator[None]:
    """Say in one sentence what went wrong; forget a download that is not right."""
    needed("pooch", "data", "Fetching recorded touches")
    from requests import HTTPError, RequestException

    try:
        downloads.mkdir(parents=True, exist_ok=True)
        yield
    except RequestException as error:
        http = isinstance(error, HTTPError)
        said = error if http else "the source cannot be reached, or was cut off"
        again = "Check the network and try again, or give a copy with --mirror"
        raise OSError(f"{name}: {said}. {again}.") from error
    except (ValueError, zipfile.BadZipFile, zlib.error, EOFError) as error:
        shutil.rmtree(downloads, ignore_errors=True)
        raise ValueError(
            f"{name}: {error} The download was deleted; fetch it again. If so again, "
            "the source has changed: give a copy with --mirror, or, if you trust the "
            f"source as it is now, delete {seen}."
        ) from error


def _converted(files: Mapping[str, Read], rule: Rule) -> Iterator[Made]:
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
