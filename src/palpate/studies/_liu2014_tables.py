"""The Liu 2014 study as tables of text, for a terminal, a report or a page."""

from collections.abc import Sequence
from typing import Any

Row = dict[str, Any]
Table = tuple[str, list[str], list[list[str]]]
DATA_NAMES = {"simulated": "simulated", "taxel10x10": "real"}


def tables(result: dict[str, Any]) -> list[Table]:
    """Return (title, columns, rows) of every table, figures in per cent."""
    rows = result["rows"]
    made = [
        _methods("Table 2", rows, "Table 2", result["plan"]["partitions"]),
        _methods("Controls, and our moments", rows, "controls", ()),
    ]
    made += [_class_sets(rows), _counts(rows)]
    made += [
        _conditions("Load, cover 0.9 mm", "load, kgf", "load_kgf", rows, "Fig. 5"),
        _conditions("Cover, 4 kgf", "cover, mm", "cover_mm", rows, "Fig. 6"),
    ]
    return [table for table in made if table[2]]


def pick(rows: Sequence[Row], **wanted: Any) -> Row | None:
    """Return the first row that has these entries, or None."""
    fits = (r for r in rows if all(r.get(k) == v for k, v in wanted.items()))
    return next(fits, None)


def cell(row: Row | None) -> str:
    """Return mean and standard deviation, or a dash."""
    if row is None:
        return "-"
    spread = "" if row["sd"] is None else f" ± {row['sd']:.1f}"
    return f"{row['ours']:.1f}{spread}"


def _methods(
    title: str, rows: Sequence[Row], table: str, partitions: Sequence[int]
) -> Table:
    """One line per method and scaling; a column per data and protocol."""
    held = [row for row in rows if row["table"] == table]
    columns = _unique((row["data"], row["protocol"]) for row in held)
    lines = []
    for name, scaling in _unique((row["name"], row["features"]) for row in held):
        known = {"name": name, "features": scaling}
        found = [
            pick(held, data=data, protocol=protocol, **known)
            for data, protocol in columns
        ]
        # Where nothing is chosen there is one row, which stands for both protocols.
        single = [pick(held, data=data, **known) for data, _ in columns]
        shown = [one or other for one, other in zip(found, single, strict=True)]
        first = next(row for row in shown if row is not None)
        lines.append([name, scaling, _paper(first), *map(cell, shown)])
    heads = [f"{DATA_NAMES[data]}, {protocol}" for data, protocol in columns]
    return title, ["method", "features", "paper", *heads], lines


def _class_sets(rows: Sequence[Row]) -> Table:
    """Figs 12 to 14 at the largest n, the paper's value in brackets."""
    held = [
        row for row in rows if row["table"].startswith("Fig") and "condition" not in row
    ]
    most = max((row["n"] for row in held if row.get("n")), default=0)
    encodings = ("FD", "GE", "FD+GE", "sorted pixels", "raw pixels")
    lines = []
    for data, classes, scaling in _unique(
        (row["data"], row["classes"], row["features"]) for row in held
    ):
        known = {"data": data, "classes": classes, "features": scaling}
        found = [
            pick(held, encoding=e, n=most if "FD" in e else None, **known)
            for e in encodings
        ]
        lines.append([DATA_NAMES[data], classes, scaling, *map(_with_paper, found)])
    title = f"Figs 12-14: 3-NN, n = {most} (paper in brackets)"
    return title, ["data", "classes", "features", *encodings], lines


def _counts(rows: Sequence[Row]) -> Table:
    """Accuracy against the number of Fourier descriptors."""
    held = [row for row in rows if row["table"] in ("Fig. 12", "Fig. 14")]
    counts = _unique(row["n"] for row in held)
    keys = ("data", "classes", "encoding", "features")
    lines = []
    for known in _unique(tuple(row[key] for key in keys) for row in held):
        wanted = dict(zip(keys, known, strict=True))
        found = [pick(held, n=n, **wanted) for n in counts]
        values = ["-" if row is None else f"{row['ours']:.1f}" for row in found]
        lines.append([DATA_NAMES[known[0]], *known[1:], *values])
    heads = ["data", "classes", "encoding", "features", *(f"n = {n}" for n in counts)]
    return "Figs 12 and 14: 3-NN against the number of descriptors", heads, lines


def _conditions(
    title: str, head: str, key: str, rows: Sequence[Row], table: str
) -> Table:
    held = [row for row in rows if row["table"] == table]
    lines = []
    for value in _unique(row[key] for row in held):
        here = [row for row in held if row[key] == value]
        cells = [
            cell(pick(here, encoding=encoding, features=scaling))
            for encoding, scaling in (
                ("FD+GE", "z-scored"),
                ("FD+GE", "raw"),
                ("sorted pixels", "z-scored"),
                ("raw pixels", "z-scored"),
            )
        ]
        first = here[0]
        lines.append(
            [
                f"{value:g}",
                *cells,
                f"{first['pieces']:.2f}",
                f"{first['in_pieces']:.0f}",
                f"{first['overlap']:.0f}",
                f"{first['pieces_2x2']:.2f}",
                f"{first['overlap_2x2']:.0f}",
            ]
        )
    heads = ["FD+GE, z-scored", "FD+GE, raw", "sorted pixels", "raw pixels"]
    heads += ["pieces", "in pieces, %", "overlap, %", "pieces 2 x 2", "overlap 2 x 2"]
    return f"{title}: 3-NN, and the binary images", [head, *heads], lines


def _paper(row: Row) -> str:
    return "-" if row["paper"] is None else f"{row['paper']:g}"


def _with_paper(row: Row | None) -> str:
    if row is None or row["paper"] is None or row["data"] != "simulated":
        return cell(row)
    return f"{cell(row)} ({row['paper']:g})"


def _unique(values: Any) -> list[Any]:
    return list(dict.fromkeys(values))
