"""Touches from tables: CSV files, arrays of numpy, data frames of pandas.

Of a CSV file by itself, or a data frame, each row is a touch: the columns that
`Touches` knows by name (`object`, `session`, `force_n`, `x_mm`..., also in capitals;
`label` or `class` is the object where none is called so), or that hold text,
are columns; all other numbers are taxels, in their order; a first line of 0, 1, 2...
(five at least) is the names that pandas gives. Where taxels are numbered
(t0, t1, t2...), numbers of a name without one are columns too, as is a clock: what is
called time, timestamp or stamp, with or without a unit, or a first column that rises
evenly. Of a folder of CSV or `.npy` files each file is a touch, its lines the rows of
taxels.
"""

import csv
import re
from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import TextIO

import numpy as np

from .._checks import listed
from .._types import Array
from ._columns import COLUMNS, LABELS, Arrays, TouchesError, checked_shape
from ._containers import CONTAINERS, container_arrays, whole_labels

TABLES = (".csv", ".npy")
TEXT_ENDINGS = (".txt", ".tsv")  # by themselves; in folders they are notes
_PLACES = ("x_mm", "y_mm", "z_mm")
_TEXT_COLUMNS = ("object", "category", "session", "subject")
COLUMN_NAMES = COLUMNS | {*_PLACES, "subject"}
# Known names that are also read in capitals.
_SPELT = (*_TEXT_COLUMNS, *_PLACES, "order", "force_n", "time_s")
CLOCK = re.compile(
    r"(time|time[ _]?stamp|stamp)([ _]?[(\[]?(s|secs?|seconds?|ms|us|ns|min)[)\]]?)?",
    re.IGNORECASE,
)
_LEAST_OF_CLOCK = 5  # numbers a line, of which the first may be a time
_LEAST_OF_COUNT = 5  # 0, 1, 2... that are names
_FILE_NAMES = ("file", "filename", "file_name", "path", "image", "name")
_LABELS = ("label", "class")
_NUMBERED = re.compile(r"[^\d.+-]*\d+[^\d.+-]*")  # once, and not by -1 or 0.5
_DECIMAL_COMMA = re.compile(r"[+-]?\d*(,\d+)?([eE][+-]?\d+)?")
_OF_DIGITS = re.compile(r"[-+\d.,;]*")
_BYTES_PER_CELL = 2  # no number is shorter, with its comma


def table_arrays(
    table: Mapping[str, Array],
    shape: tuple[int, int] | None,
    channels: Sequence[str] | None = None,
) -> Arrays:
    """Return what `Touches` is made of, by name, of columns of equal length.

    Of a taxel with `channels` these follow each other.
    """
    table = dict(map(_renamed, _spelt([*table]), table, table.values()))
    for name, column in table.items():
        is_text = column.dtype.kind == "U" and name not in _TEXT_COLUMNS
        cells = [str(cell) for cell in column if is_text and cell]
        numbers = [cell for cell in cells if _DECIMAL_COMMA.fullmatch(cell)]
        commas = [cell for cell in numbers if "," in cell]
        if commas and all(map(_DECIMAL_COMMA.fullmatch, cells[1:])):
            raise TouchesError(
                f"Column {name} must hold numbers with a decimal point, got "
                f"{commas[0]!r}. Write points (of pandas, read_csv(decimal=','))."
            )
        texts = (
            column[column != ""].tolist()
            if is_text and name not in COLUMN_NAMES
            else []
        )
        odd = [text for text in texts if not _is_number(text)]
        if 0 < len(odd) < len(texts) / 2:  # a taxel, which would be none in silence
            raise TouchesError(
                f"Column {name} must hold numbers as most of it does, got {odd[0]!r}. "
                "Correct it; where a taxel is dead leave it empty."
            )
    named = {
        n for n, c in table.items() if n in COLUMN_NAMES or c.dtype.kind not in "biuf"
    }
    truths = {n for n, c in table.items() if c.dtype.kind == "b"}
    if 2 * len(truths) < len(table.keys() - named):
        named |= {name for name in truths if _stem(name) == name}
    named |= {name for name in table if CLOCK.fullmatch(name)}
    _refuse_texts_of_taxels(table, named)
    named |= _beside_numbered([name for name in table if name not in named])
    first, second = [*(name for name in table if name not in named), "", ""][:2]
    if _stem(first) != _stem(second) and _is_clock(table[first]):
        named.add(first)
    columns = {name: column for name, column in table.items() if name in named}
    if not (taxels := {n: column for n, column in table.items() if n not in named}):
        raise TouchesError(
            f"A table of touches must have columns of taxels, got {', '.join(table)}. "
            "Every row is a touch, every other column of numbers a taxel."
        )
    if all(name in columns for name in _PLACES):
        places = [columns.pop(name).astype(np.float64) for name in _PLACES]
        columns["position_mm"] = np.stack(places, axis=1)
    n_channels = len(channels or [""])
    if len(taxels) % n_channels:
        raise TouchesError(
            f"A table of {len(taxels)} numbers a touch must have as many of each "
            f"channel, got {', '.join(channels or ())}. Name what is no taxel."
        )
    _refuse_another_order([*taxels], shape is not None, channels or ())
    n_taxels = len(taxels) // n_channels
    n_rows, n_cols = (1, n_taxels) if shape is None else checked_shape(shape)
    if n_rows * n_cols != n_taxels:
        in_lines = ", or write all rows of a touch into one line" * (n_cols == n_taxels)
        raise TouchesError(
            f"shape must have as many taxels as the table, {n_taxels}, got "
            f"{n_rows} x {n_cols}. Its columns of taxels are {listed([*taxels], 3)}: "
            f"leave out what is none{in_lines}."
        )
    depth = [n_channels] if channels else []
    images = np.stack([*taxels.values()], axis=1).reshape(-1, n_rows, n_cols, *depth)
    if channels:
        columns["channels"] = np.array(channels)
    if shape is None:  # the places of taxels in a table say nothing
        columns["geometry"] = np.array("none")
    elif 1 in (n_rows, n_cols):  # a strip, which of images alone would be a vector
        columns["geometry"] = np.array("array")
    return {"images": images, **columns}


def _beside_numbered(names: Sequence[str]) -> set[str]:
    """Return which are no taxels: beside numbered ones (t0, t1...) those without."""
    stems = {name: _stem(name) for name in names}
    numbered = [stem for name, stem in stems.items() if stem != name]
    if len(numbered) < 2 or len(set(numbered)) > 1:
        return set()
    return {name for name, stem in stems.items() if stem == name}


def _stem(name: str) -> str:
    return name.rstrip("0123456789")


def _spelt(names: Sequence[str], targets: Sequence[str] = _SPELT) -> list[str]:
    """Return names of columns as `Touches` spells those that it knows.

    `label` or `class` is the object where none is called so.
    """
    small = [name.strip().lower() for name in names]
    spelt = {name: name for name in targets}
    if "object" not in small and (labels := [s for s in small if s in _LABELS]):
        spelt[labels[0]] = "object"
    return [
        spelt.get(s, name) if small.count(s) == 1 or name == s else name
        for s, name in zip(small, names, strict=True)
    ]


def _renamed(spelt: str, name: str, column: Array) -> tuple[str, Array]:
    """Return a column by the name that `Touches` knows, where it suits its values."""
    if spelt in LABELS:
        column = whole_labels(column)
    if spelt == name:
        return name, column
    kind = column.dtype.kind
    if name.strip().lower() in _LABELS and kind == "U" and (column == "").any():
        return name, column  # it may be about something else
    kinds = (
        "Uiu" if spelt in LABELS else "iuf" if spelt not in _TEXT_COLUMNS else "Uiuf"
    )
    return (spelt if kind in kinds else name), column


def _refuse_texts_of_taxels(table: Mapping[str, Array], named: set[str]) -> None:
    """Refuse text in a column that is numbered as columns of numbers are."""
    numbers: dict[str, list[int]] = {}
    for name in table.keys() - named:
        if end := name[len(_stem(name)) :]:
            numbers.setdefault(_stem(name), []).append(int(end))
    for name, column in table.items():
        stem = _stem(name)
        if column.dtype.kind == "U" and name != stem and stem in numbers:
            taxels, number = numbers[stem], int(name[len(stem) :])
            if len(taxels) > 1 and min(taxels) - 1 <= number < max(taxels):
                raise TouchesError(
                    f"Column {name} must hold numbers as {stem}{max(taxels)} does, got "
                    f"{str(column[0])!r}. Correct it; where a taxel is dead leave it "
                    "empty."
                )


def _refuse_another_order(
    names: Sequence[str], has_places: bool, channels: Sequence[str]
) -> None:
    """Refuse taxels whose names say that they lie in another order."""
    by_number = sorted(names, key=_natural)
    are_numbered = all(map(_NUMBERED.fullmatch, names)) and (has_places or channels)
    if are_numbered and by_number != [*names] == sorted(names):
        raise TouchesError(
            "Columns of taxels must stand row by row, got "
            f"{', '.join(names[:4])}..., sorted as text is. Sort them by their numbers."
        )
    ends = [next((c for c in channels if _ends(n, c)), None) for n in names]
    wanted = [channels[n % len(channels)] for n in range(len(names)) if channels]
    if set(ends) == set(channels) and ends != wanted:
        first = next(n for n, end in enumerate(ends) if end != wanted[n])
        raise TouchesError(
            f"Columns of taxels must hold {', '.join(channels)} of each taxel, one "
            f"after the other, got {names[first]} for {wanted[first]}. Sort them so, "
            "or name `channels` in their order."
        )


def _natural(name: str) -> list[tuple[int, str]]:
    parts = re.split(r"(\d+)", name)
    return [(int(p) if n % 2 else 0, "" if n % 2 else p) for n, p in enumerate(parts)]


def _ends(name: str, channel: str) -> bool:
    return name.rstrip("0123456789_-. ").lower().endswith(channel.lower())


def taxel_names(path: Path, columns: Collection[str]) -> list[str]:
    """Return the names that a text file gives to what is none of `columns`, if any.

    Files of other kinds name no taxels.
    """
    if path.suffix.lower() not in (".csv", *TEXT_ENDINGS) or not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8-sig") as file:
        first, comma = _first_line(file)
        if comma in first.strip():  # numpy writes names behind "# "
            file.seek(0)
            first = next(filter(str.strip, file)).removeprefix("# ")
    split = first.split(comma) if comma in first.strip() else first.split()
    names = _spelt([name.strip().strip('"') for name in split])
    kept = {*columns, *_PLACES}
    is_count = _counts_columns(names) or not any(map(_is_name, names))
    return [] if is_count else [name for name in names if name not in kept]


def in_order(names: Sequence[str]) -> bool:
    """Tell whether names differ in numbers alone, and these rise: t0, t1, t2..."""
    kinds = {re.sub(r"\d+", "0", name) for name in names}
    return len(kinds) < 2 and [*names] == sorted(names, key=_natural)


def csv_arrays(
    path: Path,
    shape: tuple[int, int] | None,
    max_bytes: int,
    channels: Sequence[str] | None = None,
) -> Arrays:
    """Return what `Touches` is made of, one touch a line; the first may be names."""
    lines = _lines(path, max_bytes)
    first = [lines[0][0].removeprefix("# "), *lines[0][1:]]  # numpy writes names so
    named = any(map(_is_name, first)) or _counts_columns(first)
    of_digits = all(map(_OF_DIGITS.fullmatch, first))
    if named and of_digits and re.search("[,;]", "".join(first)):
        raise TouchesError(
            f"{path} must hold numbers with a decimal point, got {first[0]!r}. Export "
            "it again, or read it by pandas.read_csv and `Touches.from_frame`."
        )
    values = [float(cell) for cell in first if named and cell and not _is_name(cell)]
    rise = all(low < high for low, high in pairwise(values))
    if not rise and not COLUMN_NAMES.intersection(_spelt(first)):
        raise TouchesError(
            f"{path} must begin with a line of names, or hold numbers alone, got "
            f"{', '.join(first[:5])}... Add a line of names before it, one of them "
            "object."
        )
    names = first if named else [f"taxel {n}" for n in range(len(first))]
    column = [] if named else [row[0] for row in lines]
    if all(map(_is_number, column)) and _is_clock(_numbers(column, "", 1)):
        names[0] = "time_s"
    if len(set(names)) < len(names) or not all(names):
        got = ", ".join(names[:8])
        index = " Of pandas: to_csv(index=False) leaves out the index." * (not names[0])
        raise TouchesError(
            f"{path} must have a first line of names that differ, got {got}.{index}"
        )
    rows = lines[named:]
    if not rows:
        raise TouchesError(f"{path} must hold a line for each touch, got names alone.")
    table = {}
    for name, cells in zip(names, zip(*rows, strict=True), strict=True):
        numbers = [_is_number(cell) for cell in cells if cell]
        text = name.lower() in _TEXT_COLUMNS or (
            named and not any(numbers) and bool(numbers)
        )
        what = f"{path}, {name}"
        table[name] = np.array(cells) if text else _numbers(cells, what, 1 + named)
    return table_arrays(table, shape, channels)


def _counts_columns(first: list[str]) -> bool:
    """Tell whether a first line is 0, 1, 2...: names that pandas makes, no readings.

    Before them is nothing, where the first column is an index.
    """
    names = [str(n) for n in range(len(first))]
    return len(first) >= _LEAST_OF_COUNT and first in (names, ["", *names[:-1]])


def _is_clock(numbers: Array) -> bool:
    """Tell whether a first column is a clock or a count, whatever its name, no taxel.

    It rises from each line to the next, by steps that are all within a tenth of their
    median; five lines at least. A taxel of a sensor with noise does not.
    """
    if len(numbers) < _LEAST_OF_CLOCK:
        return False
    steps = np.diff(numbers.astype(np.float64))
    usual = np.median(steps)
    return bool(usual > 0 and (np.abs(steps - usual) <= 0.1 * usual).all())


def load_levels(path: Path, max_bytes: int) -> Array:
    """Return the array of a file that is one touch."""
    if path.suffix.lower() in CONTAINERS:
        images: Array = container_arrays(path, max_bytes, max_bytes)["images"]
        if len(images) > 1:
            raise TouchesError(
                f"{path} must be one touch in a folder of touches, got {len(images)} "
                "of them. Give it by itself."
            )
        return np.asarray(images[0])
    if path.suffix.lower() != ".npy":
        lines = [*enumerate(_lines(path, max_bytes), 1)]
        if _counts_columns(first := lines[0][1]) and len(lines) > 1:
            lines = [(n, row[first[0] == "" :]) for n, row in lines[1:]]
        if all(map(_is_name, lines[0][1])):
            raise TouchesError(
                f"{path} must hold rows of taxels alone, for each file of a folder is "
                f"one touch, got names ({', '.join(lines[0][1][:3])}...). Take this "
                "line out, or give a file of many touches or frames by itself."
            )
        return np.stack([_numbers(row, f"{path}, line {n}", 1) for n, row in lines])
    try:
        with path.open("rb") as file:
            if file.read(2) == b"PK":  # numpy would leave it open
                raise ValueError("several in an archive, which ends in .npz")
        mapped = np.load(path, mmap_mode="r", allow_pickle=False)
        if mapped.nbytes <= max_bytes:
            return np.array(mapped)
        problem: object = f"more than {max_bytes} bytes"
    except Exception as error:  # the header is a literal: it fails in many ways
        problem = error
    raise TouchesError(
        f"{path} must be an array that numpy.save wrote, of plain numbers, got: "
        f"{problem}. Write it again."
    )


def folder_levels(paths: Sequence[Path], max_bytes: int) -> Array:
    """Return one array per file, (n_touches, n_rows, n_cols[, n_channels])."""
    first = load_levels(paths[0], max_bytes)
    images = [first]
    for path in paths[1:]:
        image = load_levels(path, max_bytes - len(images) * first.nbytes)
        if (image.shape, image.dtype) != (first.shape, first.dtype):
            raise TouchesError(
                f"{path} must be {first.shape} {first.dtype} like {paths[0]}, got "
                f"{image.shape} {image.dtype}. Convert it, or move it elsewhere."
            )
        images.append(image)
    is_text = paths[0].suffix.lower() == ".csv" and first.shape[1] > 2
    rises = [[_is_clock(column) for column in image.T] for image in images if is_text]
    if rises and all(first and not any(others) for first, *others in rises):
        raise TouchesError(
            f"{paths[0]} and others must hold rows of taxels alone, got a first "
            "column that rises evenly, as a clock does. Take it out; of the frames of "
            "a touch keep one."
        )
    return np.stack(images)


def label_columns(path: Path, names: Sequence[str], max_bytes: int) -> Arrays:
    """Return the columns that a table beside pictures has for each of them.

    Its first line names the columns; `file`, `filename`, `path`, `image` or `name`
    holds the name of the picture, with its folders if it lies in some.
    """
    header, *rows = _lines(path, max_bytes)
    header = _spelt(header, _TEXT_COLUMNS)
    place = next((i for i, n in enumerate(header) if n.lower() in _FILE_NAMES), None)
    if place is None or len(set(header)) < len(header) or not all(header):
        raise TouchesError(
            f"{path} must begin with names, a different one each column, one of them "
            f"{', '.join(_FILE_NAMES)}, got {', '.join(header[:8])}."
        )
    by_name = {row[place].removeprefix("./"): row for row in rows}
    if len(by_name) < len(rows):
        raise TouchesError(f"{path} must have one line for each picture, got two.")
    missing = [name for name in names if name not in by_name]
    if missing:
        raise TouchesError(
            f"{path} must have a line for each picture, got none for {missing[0]} "
            f"({len(missing)} of {len(names)}). Add it, or move the picture."
        )
    columns: Arrays = {}
    for number, name in enumerate(header):
        cells = [by_name[picture][number] for picture in names]
        if number == place or not any(cells):
            continue
        number_like = name not in _TEXT_COLUMNS and all(map(_is_number, cells))
        what = f"{path}, {name}"
        columns[name] = _numbers(cells, what, 2) if number_like else np.array(cells)
    return columns


def _lines(path: Path, max_bytes: int) -> list[list[str]]:
    """Return the cells of each line that is not empty; all must have as many."""
    try:
        if path.stat().st_size > max_bytes // 8 * _BYTES_PER_CELL:
            raise ValueError(f"a file of {path.stat().st_size} bytes")
        with path.open(newline="", encoding="utf-8-sig") as file:
            first, comma = _first_line(file)
            file.seek(0)
            if comma in first.strip():
                read = csv.reader(file, delimiter=comma, strict=True)
                numbered = [(read.line_num, list(map(str.strip, row))) for row in read]
            else:  # columns with blanks between; # begins a comment, as numpy writes it
                bare = (line.partition("#")[0].split() for line in file)
                numbered = [*enumerate(bare, 1)]
    except (OSError, ValueError, csv.Error) as error:
        what = f"{path} must be a CSV file of numbers in UTF-8"
        raise TouchesError(f"{what}, got: {error}. Export it again.") from error
    lines = [(number, row) for number, row in numbered if any(row)]
    if not lines:
        raise TouchesError(f"{path} must hold lines of numbers, got none.")
    for number, row in lines:
        if len(row) != len(lines[0][1]):
            raise TouchesError(
                f"{path}, line {number} must have {len(lines[0][1])} cells like the "
                f"first, got {len(row)}. The file may be cut short, or have lines "
                "before its table: take these out."
            )
    return [row for _, row in lines]


def _first_line(file: TextIO) -> tuple[str, str]:
    """Return the first line that holds cells, and what lies between them."""
    first = next((line for line in file if line.partition("#")[0].strip()), "")
    return first, max(",;\t", key=first.count)


def _is_name(cell: str) -> bool:
    """Tell whether a cell is no number: "0_1" is none, though Python reads it as 1."""
    try:
        float(cell or "nan")
    except ValueError:
        return True
    return "_" in cell


def _is_number(cell: str) -> bool:
    is_nothing = cell.lower() in ("", "nan")
    return is_nothing or (not _is_name(cell) and isfinite(float(cell)))


def _numbers(cells: Sequence[str], what: str, first: int) -> Array:
    """Return cells as numbers; an empty one is NaN."""
    for number, cell in enumerate(cells, first):
        if not _is_number(cell):
            raise TouchesError(
                f"{what}, number {number} must be a number as others are, got "
                f"{cell!r}. Correct it, or leave it empty for a dead taxel."
            )
    return np.array([float(cell or "nan") for cell in cells])
