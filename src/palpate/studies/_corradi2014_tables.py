"""The Corradi 2014 study as tables of text, for a terminal, a report or a page."""

from collections.abc import Sequence
from typing import Any

from ._liu2014_tables import Row, Table, cell, pick

SIGNIFICANT = 0.05


def tables(result: dict[str, Any]) -> list[Table]:
    """Return (title, columns, rows) of every table."""
    rows = result["rows"]
    made = [_table_2(rows)]
    for folds in ("randomised", "grouped"):
        for data in _unique(row["data"] for row in rows if row["table"] == "Fig. 3"):
            made.append(_fig_3(rows, data, folds))
    made += [_unseen(rows), _best(rows), _paired(result["paired"])]
    made.append(_duplicates(result["duplicates"]))
    return [table for table in made if table[2]]


def _table_2(rows: Sequence[Row]) -> Table:
    held = [row for row in rows if row["table"] == "Table 2" and row["q"] == 2]
    columns = _unique((row["data"], row["variant"]) for row in held)
    lines = []
    for encoding in _unique(row["encoding"] for row in held):
        found = [
            pick(held, encoding=encoding, data=data, variant=variant)
            for data, variant in columns
        ]
        lines.append([encoding, *map(_index, found)])
    heads = [f"{data}, {variant}" for data, variant in columns]
    title = (
        "Table 2: Davies-Bouldin index, q = 2, smaller is better (paper in brackets)"
    )
    return title, ["encoding", *heads], lines


def _fig_3(rows: Sequence[Row], data: str, folds: str) -> Table:
    held = [
        row
        for row in rows
        if row["table"] == "Fig. 3" and (row["data"], row["folds"]) == (data, folds)
    ]
    title = f"Fig. 3: {data}, {folds} folds, per cent right"
    return _accuracies(title, held)


def _unseen(rows: Sequence[Row]) -> Table:
    held = [row for row in rows if row["table"] == "unseen"]
    title = "Category of unseen objects, one touch, per cent right over folds"
    return _accuracies(title, held)


def _accuracies(title: str, held: Sequence[Row]) -> Table:
    """One line per encoding and variant, a column per classifier."""
    kinds = _unique(row["classifier"] for row in held)
    lines = []
    for encoding, variant in _unique((r["encoding"], r["variant"]) for r in held):
        known = {"encoding": encoding, "variant": variant}
        found = [pick(held, classifier=kind, **known) for kind in kinds]
        lines.append([encoding, variant, *map(_with_paper, found)])
    return title, ["encoding", "on", *kinds], lines


def _best(rows: Sequence[Row]) -> Table:
    held = [row for row in rows if row["table"] == "best"]
    lengths = _unique(row["after"] for row in held)
    lines = []
    for encoding in _unique(row["encoding"] for row in held):
        found = [pick(held, encoding=encoding, after=k) for k in lengths]
        folds = [f"{value:.0f}" for value in (found[0] or {})["folds_right"]]
        lines.append([encoding, *map(cell, found), " ".join(folds)])
    heads = [f"after {k}" for k in lengths] + ["each fold, after 1"]
    title = "Category of unseen objects, kernel ridge unless said, per cent right"
    return title, ["encoding", *heads], lines


def _paired(paired: Sequence[Row]) -> Table:
    """Where image and derivative differ, all tests together."""
    lines = []
    for data in _unique(row["data"] for row in paired):
        held = [row for row in paired if row["data"] == data]
        alone = sum(row["p"] < SIGNIFICANT for row in held)
        differ = [row for row in held if row["p_together"] < SIGNIFICANT]
        better = sum(row["difference"] > 0 for row in differ)
        mean = sum(row["difference"] for row in held) / len(held)
        counts = [len(held), alone, len(differ), better]
        lines.append([data, f"{mean:+.1f}", *map(str, counts)])
    heads = ["image less derivative, mean", "pairs", "p < 0.05", "after Holm"]
    heads.append("of these image better")
    return "Image against derivative, paired on the same folds", ["data", *heads], lines


def _duplicates(duplicates: dict[str, float]) -> Table:
    lines = [[data, f"{share:.1f}"] for data, share in duplicates.items()]
    title = "Touches that another one of the set nearly repeats (correlation > 0.99)"
    return title, ["data", "share, %"], lines


def _index(row: Row | None) -> str:
    if row is None:
        return "-"
    paper = "" if row["paper"] is None else f" ({row['paper']:g})"
    return f"{row['ours']:.2f}{paper}"


def _with_paper(row: Row | None) -> str:
    paper = "" if row is None or row["paper"] is None else f" ({row['paper']:g})"
    return cell(row) + paper


def _unique(values: Any) -> list[Any]:
    return list(dict.fromkeys(values))
