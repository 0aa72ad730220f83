"""A benchmark for people: a table and sentences for each archive, and one page."""

from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

from .._durable import write_text
from ._report import check_report_path, html_table, report_page

TITLE = "Presets beside simple recognisers"


def benchmark_tables(
    result: dict[str, Any],
) -> Iterator[tuple[str, list[str], list[list[str]]]]:
    """Yield title, columns and lines of text of each archive."""
    entries = result["benchmark"]
    for name in dict.fromkeys(entry["archive"] for entry in entries):
        mine = [entry for entry in entries if entry["archive"] == name]
        rows = [row for entry in mine for row in entry["rows"]]
        counts = sorted({int(k) for row in rows for k in row["after"] or {}} - {1})
        columns = ["recogniser", "after 1, %", "±", *(f"after {k}, %" for k in counts)]
        columns += ["no contact, %", "log loss", "learn, s", "ms a touch"]
        lines = [line for entry in mine for line in _lines(entry, counts)]
        blank = [[*line, *[""] * (len(columns) - len(line))] for line in lines]
        yield f"{name}: {mine[0]['n_touches']} touches", columns, blank


def verdicts(result: dict[str, Any]) -> Iterator[str]:
    """Yield a sentence for each comparison, and for all that was left out."""
    for entry in result["benchmark"]:
        where = f"{entry['archive']}, {entry['protocol']}"
        if (found := entry["behind"]) is not None:
            side = "behind" if found["points"] > 0 else "ahead of"
            leak = found["no_contact"]
            bare = f", which names {_text(leak, 100)} % of touches without contact"
            yield (
                f"{where}: {found['verdict']}: default is {abs(found['points']):.1f} "
                f"points (standard error {found['se']:.1f}) {side} "
                f"{found['recogniser']}{'' if leak is None else bare}."
            )
        if entry["left_out"]:
            names = ", ".join(entry["left_out"])
            yield f"{where}: no other fold teaches {len(entry['left_out'])}: {names}."
        for row in entry["rows"]:
            if row["reason"] is not None:
                yield f"{where}: no {row['recogniser']}: {row['reason']}"
    for left in result["skipped"]:
        yield f"{left['archive']}, {left['protocol'] or 'skipped'}: {left['reason']}"


def write_benchmark(path: str | Path, result: dict[str, Any]) -> Path:
    """Write tables and sentences as one self-contained `.html`."""
    target = check_report_path(path)
    lines = "".join(f"<li>{escape(line)}</li>" for line in verdicts(result))
    tables = [html_table(*table) for table in benchmark_tables(result)]
    sections = [f"<h1>{TITLE}</h1>", *tables, f"<ul>{lines}</ul>"]
    write_text(target, report_page(TITLE, sections))
    return target


def _lines(entry: dict[str, Any], counts: list[int]) -> Iterator[list[str]]:
    counted = f"{entry['n_labels']} labels, folds: {entry['n_folds']}"
    yield [f"{entry['protocol']} ({counted})"]
    for row in entry["rows"]:
        after, seconds = row["after"] or {}, row["seconds"] or {}
        shares = [row["accuracy"], row["se"], *(after.get(str(k)) for k in counts)]
        yield [
            f"  {row['recogniser']}",
            *(_text(share, 100) for share in (*shares, row["no_contact"])),
            _text(row["log_loss"], digits=2),
            _text(seconds.get("learn"), digits=2),
            _text(seconds.get("per_touch"), 1000, digits=2),
        ]
    for name, share in entry["controls"].items():
        if share is not None:
            yield [f"  control: {name}", _text(share, 100)]


def _text(value: float | None, scale: float = 1, digits: int = 1) -> str:
    return "-" if value is None else f"{scale * value:.{digits}f}"
