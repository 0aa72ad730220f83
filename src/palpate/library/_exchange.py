"""Touches of a library as archive, Parquet file or LeRobotDataset.

Parquet is written by `palpate.touches`, one row a touch; images that came as pictures
are written as these.

Of a LeRobotDataset v3.0 [1]_ one touch is one frame, one object in one session (and
episode) is one episode, and its task is "touch <object>", or "touch" without a label.
The feature `observation.tactile` is an image where touches are pictures of a camera (8
bits, grey or r, g, b), else an array of float32, NaN where it has gaps. `object`,
`category`, `session`, `episode`, `subject`, `sensor`, `time_s`, `order` are features
where touches have them; `timestamp` counts seconds from the first touch of the episode.
What belongs to the whole set stands in `meta/info.json` under `palpate`, which other
readers pass over.

Of touches all must have an object or none, whatever they are written to.

References
----------
.. [1] LeRobotDataset v3.0, https://huggingface.co/docs/lerobot/lerobot-dataset-v3
"""

import json
import secrets
import shutil
import warnings
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from .._checks import ARRAY_SIDE
from .._durable import PARTIAL, flush_all, flush_folder
from .._extras import needed
from .._types import RGB, Array, Floats, Indices
from ..touches import Touches, TouchesError, png_bytes, url_of, write_parquet
from ._reading import Selection, read_array
from ._rows import FROM, Numbers, Tables, n_at_once
from ._store import LibraryError, refuse_used, room_for

TACTILE = "observation.tactile"
_LEROBOT_VERSION = "v3.0"
# Touches of a row group of Parquet, and so of a task of a worker that reads it.
_ROW_GROUP = 128
_FRAMES_PER_SECOND = 1  # a touch is a frame, and has its own time
_FILE = "chunk-{:03d}/file-{:03d}.parquet"
_PARTS, _KINDS = ("data", "meta/episodes"), ("chunk", "file")
_KEYS = ("object", "category", "session", "episode", "sensor")
_LABELS = ("object", "category", "session", "episode", "subject", "sensor")
_NUMBERS = ("time_s", "order")
_MEASURED = tuple(
    f"observation.{name}" for name in ("position_mm", "direction", "force_n")
)


def export_touches(
    tables: Tables, numbers: Numbers, path: str | Path, by: str | None = None
) -> int:
    """Write touches to `path`, whose ending says how; return how many."""
    picked = Selection(tables, numbers)
    url = url_of(path)
    path = Path(path)
    path = path if path.name else path.absolute()  # "." and ".." have no name
    kind = path.suffix.lower()
    if kind != ".parquet" and (url is not None or kind not in _WRITERS):
        raise LibraryError(
            "path must end in .npz or .parquet (the address of a store in .parquet), "
            f"or name a folder for a LeRobotDataset, got {url or path.name!r}."
        )
    if by is not None and (by not in _KEYS or kind != ".parquet"):
        raise LibraryError(
            f"by must be one of {', '.join(_KEYS)}, and for Parquet alone, got {by!r} "
            f"with {kind or 'a folder'!r}. Give a folder that ends in .parquet."
        )
    if url is not None:
        _to_store(picked, url, by)
        return len(numbers)
    if not path.parent.is_dir():
        raise LibraryError(
            f"path must be in a folder that exists, got {str(path)!r}. "
            f"Make {str(path.parent)!r} first."
        )
    if not kind or by is not None:
        refuse_used(path)
    partial = path.with_name(f"{PARTIAL}{secrets.token_hex(8)}{kind}")
    fix = "Nothing is left there; free space, or give another one."
    try:
        with room_for(f"{len(numbers)} touches", path, fix):
            if kind == ".parquet":
                _write_files(picked, by, partial, _opened)
            else:
                _WRITERS[kind](partial, picked)
            flush_all(partial)
            partial.replace(path)
            flush_folder(path.absolute().parent)
    finally:  # what a failed export has left; a finished one has another name
        if partial.is_dir():
            shutil.rmtree(partial, ignore_errors=True)
        with suppress(OSError):
            partial.unlink()
    return len(numbers)


def _to_store(picked: Selection, url: str, by: str | None) -> None:
    """Write Parquet to a store that fsspec knows."""
    fsspec = needed("fsspec.core", "parquet", "Writing to a store")
    try:
        # Folders in a folder of this disk are made; other stores need none.
        on_disk = {"auto_mkdir": by is not None} if url.startswith("file:") else {}
        system, place = fsspec.url_to_fs(url, **on_disk)
        if by is not None and (there := system.find(place)):
            raise LibraryError(
                f"{url} must be a new or empty folder, got {there[0]} in it. Give "
                "another one."
            )
        with system.transaction:  # what fails leaves nothing, and what was there stays
            _write_files(picked, by, place, lambda name: system.open(name, "wb"))
    except (LibraryError, TouchesError):
        raise
    except (OSError, ImportError, ValueError) as error:
        raise LibraryError(
            f"{url} must be an address that fsspec can write to, got: {error}."
        ) from error


def _opened(name: str | Path) -> Any:
    """Open a file to write, in folders that are made."""
    path = Path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    return path.open("wb")


def _write_files(
    picked: Selection, by: str | None, path: str | Path, opened: Callable[[Any], Any]
) -> None:
    """Write one file, or one for each value of a column in folders `by=value`."""
    if by is None:
        with opened(path) as file:
            _write_parquet(file, picked)
        return
    values = picked.columns.get(by)
    if values is None:
        raise LibraryError(
            f"by must be a column of the touches, got {by!r}, which they lack."
        )
    # A number that some lack is NaN there: as of texts, their folder has an empty name.
    names = np.array(["" if value != value else str(value) for value in values])
    for name in np.unique(names):
        place = f"{path}/{by}={quote(str(name), safe='')}"
        with opened(f"{place}/part-0.parquet") as file:
            part = picked[np.flatnonzero(names == name)]
            _write_parquet(file, part, picked, {by: values.dtype.str})


def _write_parquet(
    file: Any,
    picked: Selection,
    whole: Selection | None = None,
    named: dict[str, str] | None = None,
) -> None:
    """Write a row group for every `_ROW_GROUP` touches, fewer of large images.

    `whole` is all that is written, of which these may be a part; `named` are columns
    that the path carries, and their types.
    """
    if whole is None:
        picked.read_columns()  # refuses objects that some lack, before any is written
    keys = picked.recordings()
    places = {key: place for place, key in enumerate(dict.fromkeys(keys))}
    numbers = np.array([places[key] for key in keys])
    recordings = [_described(picked.tables, key) for key in places]
    parts = _row_groups(picked, numbers, whole or picked, named or {})
    write_parquet(file, parts, picked.channels(), recordings, named)


def _row_groups(
    picked: Selection,
    numbers: Indices,
    of: Selection,
    named: Collection[str],
) -> Iterator[tuple[Array, dict[str, Array], list[bytes] | None, Indices]]:
    """Yield images, columns, files of images and numbers of recordings, in parts.

    Where some images came as pictures, the others are written as such too: a column of
    Parquet is of one type.
    """
    shape, dtype = picked.kind
    are_pictures = picked.has_pictures()
    step = min(_ROW_GROUP, n_at_once(shape, dtype))
    for start in range(0, len(picked), step):
        rows = np.arange(start, min(start + step, len(picked)))
        images = np.empty((len(rows), *shape), dtype)
        part = picked[rows]
        columns = part.read_columns(images, of)
        columns = {n: c for n, c in columns.items() if n not in named}
        files = None
        if are_pictures:
            pairs = zip(part.files(), images, strict=True)
            files = [file or png_bytes(image) for file, image in pairs]
        yield images, columns, files, numbers[rows]


def _described(tables: Tables, key: int) -> dict[str, Any]:
    """Return what a Parquet file says of a recording."""
    recording = tables.recording(key)
    whole = {n: read_array(tables, n, digest) for n, digest in recording.whole.items()}
    present = {n: array for n, array in whole.items() if array is not None}
    if recording.geometry is not None:
        present["geometry"] = np.array(recording.geometry)
    names = ("sensor", "kind", "unit", "pitch_mm")
    return {"whole": present, **{name: getattr(recording, name) for name in names}}


def _write_lerobot(path: Path, picked: Selection) -> None:
    """Write a new folder; episodes are read one by one."""
    pa = needed("pyarrow", "parquet", "Writing a LeRobotDataset")
    pq = needed("pyarrow.parquet", "parquet", "Writing a LeRobotDataset")
    data = path / "data" / _FILE.format(0, 0)
    data.parent.mkdir(parents=True)
    picked.read_columns()  # refuses objects that some lack, before any is written
    dataset = _Dataset(picked.whole)
    numbers = picked.numbers
    columns = "o.name, t.session, t.episode, t.number"
    sql = f"SELECT {columns} {FROM} WHERE t.number IN (?) ORDER BY t.number"
    groups: dict[tuple[Any, ...], list[int]] = {}
    for *key, number in picked.tables.store.among(sql, numbers.tolist()):
        groups.setdefault(tuple(key), []).append(number)
    rows = (np.searchsorted(numbers, members) for members in groups.values())
    episodes = (picked[places].touches(of=picked) for places in rows)
    tables = (_frame_table(pa, dataset.add(episode)) for episode in episodes)
    first = next(tables)
    with pq.ParquetWriter(data, first.schema) as writer:
        for table in chain([first], tables):
            writer.write_table(table.cast(first.schema))
    _write_meta(pa, pq, path / "meta", dataset)


class _Dataset:
    """The metadata of a LeRobotDataset's episodes, gathered one by one."""

    def __init__(self, whole: dict[str, Array]) -> None:
        self.whole = whole
        self.tasks: dict[str, int] = {}
        self.rows: list[dict[str, Any]] = []
        self.features: dict[str, Any] = {}
        self.dtype, self.n_axes, self.n_frames = "", 0, 0
        # Count, sum and sum of squares; the most of what is below and above zero.
        self._spread: dict[str, tuple[Floats, Floats]] = {}

    def add(self, touches: Touches) -> dict[str, Array]:
        """Take in the touches of one episode, all of one object; return its frames."""
        task = f"touch {'' if touches.object is None else touches.object[0]}".strip()
        task_index = self.tasks.setdefault(task, len(self.tasks))
        number, first = len(self.rows), self.n_frames
        frames = _lerobot_frames(touches, self.whole, number, first, task_index)
        self.dtype, self.n_axes = touches.images.dtype.str, touches.images.ndim
        for name, values in frames.items():
            feature = _feature(name, values)
            self.features.setdefault(name, feature)
            if feature["dtype"] == "string":
                continue
            wide = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
            if feature["dtype"] == "image":  # as readers see it: 0 to 1, by channel
                wide = wide.reshape(-1, feature["shape"][2]) / 255
            is_there, filled = ~np.isnan(wide), np.nan_to_num(wide)
            sums = np.stack([is_there.sum(0), filled.sum(0), (filled**2).sum(0)])
            most = np.fmax.reduce([-wide.T, wide.T], axis=2)  # NaN only where all are
            before = self._spread.get(name, (0 * sums, most))
            self._spread[name] = before[0] + sums, np.fmax(before[1], most)
        places = [f"{part}/{kind}_index" for part in _PARTS for kind in _KINDS]
        row = {"episode_index": number, "tasks": [task], "length": len(touches)}
        row |= dict.fromkeys(places, 0) | {"dataset_from_index": first}
        self.n_frames += len(touches)
        self.rows.append({**row, "dataset_to_index": self.n_frames})
        return frames

    def spread(self) -> dict[str, Any]:
        """Return minimum, maximum, mean and deviation of each feature over all.

        Gaps between pads and dead taxels (NaN) do not count; 0 where nothing does.
        """
        result = {}
        for name, ((count, total, squares), (under, over)) in self._spread.items():
            mean = total / np.maximum(count, 1)
            sd = np.sqrt(np.maximum(squares / np.maximum(count, 1) - mean**2, 0))
            picture = self.features[name]["dtype"] == "image"
            shape = (-1, 1, 1) if picture else self.features[name]["shape"]
            values = {"min": -under, "max": over, "mean": mean, "std": sd}
            values = {k: np.nan_to_num(v).reshape(shape) for k, v in values.items()}
            result[name] = {k: v.tolist() for k, v in values.items()}
            result[name]["count"] = [self.n_frames]
        return result


def _feature(name: str, values: Array) -> dict[str, Any]:
    if name == TACTILE and values.dtype == np.uint8:
        shape = [*values.shape[1:], *[1] * (4 - values.ndim)]
        axes = ["height", "width", "channels"]
        return {"dtype": "image", "shape": shape, "names": axes}
    kind = "string" if values.dtype.kind == "U" else values.dtype.name
    return {"dtype": kind, "shape": list(values.shape[1:]) or [1], "names": None}


def _lerobot_frames(
    touches: Touches, whole: dict[str, Array], episode: int, first: int, task: int
) -> dict[str, Array]:
    """Return frames by feature; where times are not known, they count touches.

    `whole` is what describes all episodes alike.
    """
    n_touches = len(touches)
    number = np.arange(n_touches, dtype=np.int64)
    time_s = np.asarray(touches.columns.get("time_s", number), dtype=np.float64)
    if np.isnan(time_s).any():
        time_s = number.astype(np.float64)
    images = touches.images
    # What a camera gives: 8 bits, grey or in colour, and larger than an array.
    arranged = str(whole.get("geometry")) in ("array", "none") or "pads" in whole
    levels = images.dtype == np.uint8 and touches.channels in (None, RGB)
    if arranged or not levels or min(images.shape[1:3]) <= ARRAY_SIDE:
        images = images.astype("f4")
    elif images.ndim == 3:  # policies take pictures of three channels alone
        images = np.repeat(images[..., np.newaxis], 3, axis=3)
    columns = {TACTILE: images, **_moves(touches)}
    extra = touches.columns
    for feature in _MEASURED:
        if (values := extra.get(feature.removeprefix("observation."))) is not None:
            flat = values.reshape(n_touches, -1).astype(np.float32)
            columns[feature] = flat[:, 0] if flat.shape[1] == 1 else flat
    labels = {n: extra[n] for n in _LABELS if n in extra}
    columns |= {
        n: c if c.dtype.kind in "iuf" else c.astype(np.str_) for n, c in labels.items()
    }
    columns |= {n: extra[n].astype(np.float64) for n in _NUMBERS if n in extra}
    return {
        **columns,
        "timestamp": (time_s - time_s[0]).astype(np.float32),
        "frame_index": number,
        "episode_index": np.full(n_touches, episode, np.int64),
        "index": first + number,
        "task_index": np.full(n_touches, task, np.int64),
    }


def _moves(touches: Touches) -> dict[str, Array]:
    """Return what a policy learns from: where each touch was, and the next place.

    The last touch of an episode stays where it is. Without places there are none.
    """
    places = touches.columns.get("position_mm")
    if places is None:
        return {}
    places = places.reshape(len(touches), -1)
    force = touches.columns.get("force_n")
    state = [places] if force is None else [places, force.reshape(len(touches), -1)]
    moves = {
        "observation.state": np.hstack(state).astype(np.float32),
        "action": np.vstack([places[1:], places[-1:]]).astype(np.float32),
    }
    return {n: v[:, 0] if v.shape[1] == 1 else v for n, v in moves.items()}


def _frame_table(pa: Any, frames: dict[str, Array]) -> Any:
    arrays = {}
    for name, values in frames.items():
        if name == TACTILE and values.dtype == np.uint8:
            files = [{"bytes": png_bytes(v), "path": None} for v in values]
            kind = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
            arrays[name] = pa.array(files, kind)
            continue
        column = pa.array(values.reshape(-1))
        for size in reversed(values.shape[1:]):
            ends = np.arange(0, len(column) + 1, size, dtype=np.int32)
            column = pa.ListArray.from_arrays(pa.array(ends), column)
        arrays[name] = column
    return pa.table(arrays)


def _write_meta(pa: Any, pq: Any, meta: Path, dataset: _Dataset) -> None:
    whole = {name: _json_values(array) for name, array in dataset.whole.items()}
    info = {
        "codebase_version": _LEROBOT_VERSION,
        "robot_type": None,
        "total_episodes": len(dataset.rows),
        "total_frames": dataset.n_frames,
        "total_tasks": len(dataset.tasks),
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": _FRAMES_PER_SECOND,
        "splits": {"train": f"0:{len(dataset.rows)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": dataset.features,
        # What other readers pass over: of what type the touches were, and the rest.
        "palpate": {
            "dtype": dataset.dtype,
            "grey": dataset.n_axes == 3,
            "whole": whole,
        },
    }
    episodes = meta / "episodes" / _FILE.format(0, 0)
    episodes.parent.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(dataset.rows), episodes)
    tasks = dataset.tasks
    table = pa.table({"task_index": list(tasks.values()), "task": list(tasks)})
    table = table.replace_schema_metadata({"pandas": json.dumps(_TASKS_PANDAS)})
    pq.write_table(table, meta / "tasks.parquet")
    text = json.dumps(info, indent=4, default=str, allow_nan=False)
    (meta / "info.json").write_text(text)
    (meta / "stats.json").write_text(json.dumps(dataset.spread(), allow_nan=False))


def _json_values(array: Array) -> Any:
    """Return values as lists; NaN, and infinity, of which JSON knows nothing, None."""
    if array.dtype.kind != "f":
        return array.tolist()
    values = array.astype(object)
    values[~np.isfinite(array)] = None
    return values.tolist()


def _column(name: str, kind: str, numpy_type: str) -> dict[str, Any]:
    kinds = {"pandas_type": kind, "numpy_type": numpy_type, "metadata": None}
    return {"name": name, "field_name": name, **kinds}


# Readers take a task's name from the index of a pandas table; this is what
# `DataFrame.to_parquet` writes of such a table.
_TEXT = _column("task", "unicode", "object")
_TASKS_PANDAS = {
    "index_columns": ["task"],
    "column_indexes": [{**_TEXT, "name": None, "field_name": None}],
    "columns": [_column("task_index", "int64", "int64"), _TEXT],
    "pandas_version": "2.2.0",
}


def _write_archive(path: Path, picked: Selection) -> None:
    touches = picked.touches()
    if touches.no_contact is None and picked.no_contact is not None:
        warnings.warn(
            "An archive holds one frame of no contact, got touches of several, which "
            "are left out. Choose those of one session (`where`), or write Parquet.",
            stacklevel=4,
        )
    try:
        touches.save(path)
    except TouchesError as error:
        if isinstance(error.__cause__, OSError):  # `path` is not what was asked for
            raise error.__cause__ from None
        raise


_WRITERS: dict[str, Callable[[Path, Selection], None]] = {
    ".npz": _write_archive,
    "": _write_lerobot,
}
