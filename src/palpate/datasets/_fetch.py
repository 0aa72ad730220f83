"""Fetching: download, check, convert, write; each step whole or not at all.

Ready models of simulated sensors are made by today's code when first asked for, and
named after it, so that other code makes its own and takes away what is older.

Downloads lie in `.downloads/NAME` until the archive is made. Where the card has no
SHA-256, that of the first goes to `.fetched/NAME.sha256`; a later one must be the same.
What is made is compared with the arrays behind the figures, whose SHA-256 the card has.

A mirror is not trusted: names, files, their number and their sums are bounded before
anything is read, as is the time; what cannot be right is deleted with what was made.
Files are read in memory, and never unpacked under names of the source.
"""

import hashlib
import os
import re
import shutil
import struct
import sys
import threading
import time
import tomllib
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from errno import EACCES, EDQUOT, EIO, EMFILE, ENFILE, ENOSPC, EPERM, EROFS
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import numpy as np

from .._checks import check_option
from .._durable import check_folder_of, replacing, write_text
from .._extras import needed
from .._types import Array
from ..touches import Touches
from ._convert import LONGEST_PATH, Made, Member, converted, digest

_CARDS = files(__package__) / "cards"
_CACHES = {"win32": "AppData/Local", "darwin": "Library/Caches"}
_MB = 10**6
_MOST_IN_ZIP = 100 * _MB  # of one file; zipfile inflates no more than it promises
Say = Callable[[str], None]
# Of a zip's list of files, which zipfile reads as a whole; all downloads of a set.
_LONGEST_LIST, _MOST_S = 20 * _MB, 7200.0
_LIST_END, _INFLATED = b"PK\x05\x06", (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_FULL = (ENOSPC, EDQUOT, EACCES, EPERM, EROFS, EIO, EMFILE, ENFILE)
_PACKAGE = Path(__file__).parents[1]
_MAKERS = (
    "datasets",
    "simulation",
    "touches",
    "images",
    "encodings",
    "classifiers",
    "recognition",
)
_SEED = 0
# Those that `palpate demo` explores, and what a small gel can tell from another in a
# few presses; the other objects of a `sim:` sensor are strangers.
_OF_DOME = ("stapler", "toothbrush", "mug", "box", "pen", "ball")
_OF_GEL = ("ball", "massage ball", "pen", "toothbrush")


class ReadyModel(NamedTuple):
    """A model of what a simulated sensor touches; `fetch` makes it."""

    name: str
    what: str  # it knows, in words
    n_touches: int  # of each object, that it learns

    def file(self, folder: str | Path | None = None) -> Path:
        """Return where its file is, or will be; `folder` is that of `fetch`."""
        here = Path(folder) if folder else _cached()
        return here / "models" / f"{self.name}-{_code()}.palpate"


_MODELS = (
    ReadyModel("sim-array", "twelve flat parts on the pressure array of sim:array", 24),
    ReadyModel(
        "sim-dome", f"{', '.join(_OF_DOME)} under the dome camera of sim:dome", 60
    ),
    ReadyModel(
        "sim-gel", f"{', '.join(_OF_GEL)} on the gel, in colour, of sim:gel", 40
    ),
)
# What `fetch` makes on this computer, by name.
READY = {model.name: model for model in _MODELS}


def names() -> tuple[str, ...]:
    """Return the names of all sets, sorted."""
    return tuple(sorted(file.name.removesuffix(".toml") for file in _CARDS.iterdir()))


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
    named = folder or os.environ.get("PALPATE_DATA")
    return Path(named) if named else _cached()


def _cached() -> Path:
    """Return the folder for what can be made or fetched again."""
    if home := os.environ.get("PALPATE_DATA_HOME"):
        return Path(home)
    caches = "LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME"
    if named := os.environ.get(caches):
        return Path(named) / "palpate"
    try:
        return Path.home() / _CACHES.get(sys.platform, ".cache") / "palpate"
    except RuntimeError as error:  # a container's user without a home
        raise ValueError(
            "PALPATE_DATA_HOME must name a folder for what is made or fetched, got "
            "nothing, and there is no home directory. Set it."
        ) from error


def fetch(
    name: str,
    *,
    folder: str | Path | None = None,
    mirror: str | None = None,
    progress: Say | None = None,
) -> Path:
    """Fetch a set from its public source, if it is not there; return its archive.

    Or return the file of a ready model of a simulated sensor, made where it is not
    there.

    Parameters
    ----------
    name : str
        One of `names()`; or "sim-array", "sim-dome" or "sim-gel", a model.
    folder : path, optional
        Where it goes; see `where`. A model goes to the cache, whatever PALPATE_DATA is.
    mirror : str, optional
        What stands for `https://HOST` in the source's address. Default:
        PALPATE_DATA_MIRROR, if it names anything.
    progress : callable, optional
        Called with the present stage, a text.

    Warns where no SHA-256 was known, and where arrays are not those behind the figures.
    Raises ValueError for another name, or a source that has changed, is damaged or too
    large; OSError where it cannot be reached or the folder not be written; ImportError
    without pooch, or for a model without the simulation's packages. Nothing half done
    is left.
    """
    if name in READY:
        return _make_ready(READY[name], folder, progress)
    check_option("name", name, (*names(), *READY))
    description, here = card(name), where(folder)
    outputs: list[Path] = [here / place for place in description["makes"]]
    if all(place.exists() for place in outputs):
        return outputs[0]
    if "why_not" in description:
        raise ValueError(f"{name} cannot be fetched: {description['why_not']}")
    downloads, seen = here / ".downloads" / name, here / ".fetched" / f"{name}.sha256"
    expected = description["source"]["sha256"] or (
        seen.read_text() if seen.is_file() else ""
    )
    with _explained(name, downloads, seen):
        meter = _Meter(description["name"], description["source"]["most_mb"], progress)
        load = partial(_download, meter, downloads)
        url = _address(description["source"]["url"], mirror)
        with _source(description, url, expected, load) as source:
            chosen, differs = _chosen(description, source)
        _write(outputs, *chosen)
        with (downloads / "source").open("rb") as file:
            got = hashlib.file_digest(file, "sha256").hexdigest()
        seen.parent.mkdir(exist_ok=True)
        write_text(seen, got)
        shutil.rmtree(downloads, ignore_errors=True)
    if not expected:
        trusted = "no SHA-256 of the source was known, so this download was trusted"
        warnings.warn(f"{name}: {trusted}; a later one must have {got}.", stacklevel=2)
    if differs:
        others = f"{', '.join(differs)} are not the arrays behind the figures"
        warnings.warn(f"{name}: {others}: say so beside what you make.", stacklevel=2)
    return outputs[0]


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

    Raises
    ------
    ValueError
        For what `fetch` refuses, and a name that is no set but a ready model.
    """
    check_option("name", name, names())
    return Touches.load(fetch(name, folder=folder, mirror=mirror, progress=progress))


def _address(url: str, mirror: str | None) -> str:
    """Return the address with the mirror in place of the host, if there is one."""
    root = mirror or os.environ.get("PALPATE_DATA_MIRROR")
    if root and not re.match(r"https?://[^/]", root):
        raise ValueError(f"mirror must begin with https:// or http://, got {root!r}.")
    return f"{root.rstrip('/')}{urlsplit(url).path}" if root else url


def _download(meter: "_Meter", folder: Path, url: str, name: str, sha256: str) -> Path:
    """Return a download, whole and with the SHA-256 that is known, if one is.

    It works in a thread that is left behind where it does not end in time: a server may
    send a byte now and then for days.
    """
    pooch = needed("pooch", "data", "Fetching recorded touches")
    pooch.get_logger().setLevel("WARNING")
    downloader = pooch.HTTPDownloader(
        progressbar=meter,
        chunk_size=2**16,
        timeout=30,
        headers={"Accept-Encoding": "identity"},
    )
    got: list[Path | BaseException] = []

    def retrieve() -> None:
        how = {"downloader": downloader}
        try:
            got.append(Path(pooch.retrieve(url, sha256 or None, name, folder, **how)))
        except BaseException as error:  # handed on below
            got.append(error)

    thread = threading.Thread(target=retrieve, daemon=True)
    thread.start()
    try:
        thread.join(max(0.0, meter.until_s - time.monotonic()))
        if not got:
            raise ValueError(f"the source must be sent within {_MOST_S / 60:.0f} min.")
    finally:
        meter.over = not got
    if isinstance(got[0], BaseException):
        raise got[0]
    return got[0]


class _Meter:
    """What pooch takes for a bar: says how far it is, refuses what is too large.

    It counts all the downloads of a set.
    """

    def __init__(self, name: str, most_mb: int, say: Say | None) -> None:
        self.total, self.over = 0, False
        self.until_s = time.monotonic() + _MOST_S
        self._done = self._before = 0
        self._name, self._most_mb, self._say = name, most_mb, say

    def update(self, n_bytes: int) -> None:
        self._done += n_bytes
        if self.over:
            raise ValueError("the download was given up.")
        n_bytes = self._before + max(self.total, self._done)
        if n_bytes > self._most_mb * _MB:
            got = f"got {n_bytes / _MB:.0f}"
            raise ValueError(f"the source must have at most {self._most_mb} MB, {got}.")
        if self._say is not None:
            done = self._done // _MB
            self._say(f"{self._name}: {done} of {self.total // _MB or '?'} MB")

    def reset(self) -> None:
        if self.total:  # pooch counts once more what it expected, if anything
            self._done = 0

    def close(self) -> None:
        self._before += self._done
        self.total = self._done = 0


@contextmanager
def _source(
    description: dict[str, Any],
    url: str,
    expected: str,
    load: Callable[[str, str, str], Path],
) -> Iterator[Mapping[str, Member]]:
    """Yield the files of a zip, or those that a list of checksums names."""
    first = load(url, "source", expected)
    if "listed" in description["source"]:
        wanted = re.compile(
            rf"([0-9a-f]{{64}}) [ *]?({description['source']['listed']})"
        )
        lines = first.read_text(errors="replace").splitlines()
        matches = (wanted.fullmatch(s) for s in lines if len(s) < 66 + LONGEST_PATH)
        sums = {m[2]: m[1] for m in matches if m}
        most, base = 3 * description["touches"], url.rpartition("/")[0]
        if len(sums) > most:
            raise ValueError(f"the list must name at most {most}, got {len(sums)}.")
        places = {
            n: load(f"{base}/{n}", expected, expected) for n, expected in sums.items()
        }
        yield {n: Member(p.stat().st_size, p.read_bytes) for n, p in places.items()}
        return
    _refuse_long_list(first)
    with zipfile.ZipFile(first) as archive:
        yield {
            info.filename: Member(info.file_size, partial(_read_member, archive, info))
            for info in archive.infolist()
            if info.file_size <= _MOST_IN_ZIP and info.compress_type in _INFLATED
        }


def _refuse_long_list(path: Path) -> None:
    """Refuse a zip whose list of files is very long, before zipfile reads it."""
    with path.open("rb") as file:
        file.seek(-min(path.stat().st_size, 2**16 + 22), os.SEEK_END)
        tail = file.read()
    for match in re.finditer(re.escape(_LIST_END), tail):
        end = tail[match.start() : match.start() + 16]
        n_bytes = struct.unpack("<I", end[12:])[0] if len(end) == 16 else 0
        if n_bytes > _LONGEST_LIST:
            raise ValueError(
                f"the zip's list of files must have at most {_LONGEST_LIST // _MB} MB, "
                f"got {n_bytes / _MB:.0f}."
            )


def _read_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    """Return a file of a zip; no more is inflated than the list promises."""
    with archive.open(info) as file:
        return file.read(info.file_size)


def _chosen(
    description: dict[str, Any], source: Mapping[str, Member]
) -> tuple[Made, list[str]]:
    """Return the version behind the figures, else the first, and what differs."""
    tried: list[tuple[Made, list[str]]] = []
    most_bytes = description["source"]["most_mb"] * _MB
    for version in converted(
        source, description["convert"], description["touches"], most_bytes
    ):
        Touches(**version[0])  # refuses what would not read as an archive
        got = {name: digest(array) for name, array in version[0].items()}
        wanted = description["arrays"]
        differs = [n for n in {**wanted, **got} if got.get(n) != wanted.get(n)]
        tried = [*tried[:1], (version, differs)]
        if not differs:
            return tried[-1]
    return tried[0]


def _write(
    outputs: list[Path], arrays: dict[str, Array], beside: dict[str, bytes]
) -> None:
    """Write the files beside, then the archive, each whole or not at all."""
    archive, *folders = outputs
    archive.parent.mkdir(parents=True, exist_ok=True)
    for folder in folders:
        partly = folder.with_name(f".partial-{folder.name}")
        shutil.rmtree(partly, ignore_errors=True)
        try:
            for name, data in beside.items():
                (partly / name).parent.mkdir(parents=True, exist_ok=True)
                (partly / name).write_bytes(data)
            if not folder.exists():
                partly.rename(folder)
        finally:
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
        message = error if http else "the source cannot be reached, or was cut off"
        again = "Check the network and try again, or give a copy with `mirror`"
        raise OSError(f"{name}: {message}. {again}.") from error
    except Exception as error:
        # Damaged files make zipfile, scipy and numpy raise two dozen kinds.
        full = isinstance(error, OSError) and error.errno in _FULL
        if full or isinstance(error, ImportError):
            raise
        shutil.rmtree(downloads, ignore_errors=True)
        raise ValueError(
            f"{name}: {error} The download was deleted; fetch it again. If so again, "
            "the source has changed: give a copy with `mirror`, or, if you trust the "
            f"source as it is now, delete {seen}."
        ) from error


def _make_ready(model: ReadyModel, folder: str | Path | None, say: Say | None) -> Path:
    """Return the file of a ready model, made first where it is not there."""
    from ..recognition import ObjectRecogniser

    path = model.file(folder)
    if path.is_file():
        return path
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        check_folder_of(path)
    except OSError as error:
        raise OSError(
            f"{model.name} must be kept in a folder that may be written to, got "
            f"{path.parents[1]}: {error.strerror}. Set PALPATE_DATA_HOME to "
            "another one."
        ) from error
    if say is not None:
        say(f"{model.name}: simulating touches and learning them, once")
    ObjectRecogniser().fit(_ready_touches(model)).save(path)
    for older in path.parent.glob(f"{model.name}-*.palpate"):
        if older != path:
            older.unlink(missing_ok=True)
    return path


def _ready_touches(model: ReadyModel) -> Touches:
    """Return the touches that a ready model learns: as its `sim:` sensor gives them."""
    from .. import simulation

    n_touches = model.n_touches
    how: dict[str, Any] = {"random_state": _SEED}
    if model.name == "sim-array":
        array = simulation.PressureArray()
        return simulation.simulate_presses(None, n_touches, array=array, **how)
    how |= {"drift": False}
    if model.name == "sim-gel":
        gel = simulation.GelCamera(image_shape=(120, 160))
        return simulation.simulate_touches(_OF_GEL, n_touches, gel, **how)
    dome = simulation.DomeCamera(image_shape=(120, 120))
    return simulation.simulate_touches(_OF_DOME, n_touches, dome, **how)


@cache
def _code() -> str:
    """Return what names the code that makes ready models."""
    code = hashlib.sha256()
    for path in sorted(
        p for subpackage in _MAKERS for p in (_PACKAGE / subpackage).rglob("*.py")
    ):
        code.update(path.read_bytes())
    return code.hexdigest()[:12]
