"""Tables of Markdown with one figure a cell: `tables.py PAGE.md ...` rewrites pages.

A column of "54 ± 16" becomes two, and so does one of "54 (16)" below a head such as
"right (sd)", or where `--brackets NAME` says what all brackets of a page are. One of
"54 / 77 / 82" below a head such as "after 1 / 5 / 15" becomes three. A column with a
cell of another kind, "-" and plain figures aside, stays as it is.
"""

import argparse
import re
from pathlib import Path

FIGURE = r"(?:[<>]? ?-?[\d.,]+(?:e-?\d+|-[\d.]+)?(?: %)?|never|-)"
CELL = re.compile(rf"({FIGURE})(?: ?± ?([\d.,]+))?(?: \((-?[\w.,-]+(?: %)?)\))?")


def main() -> None:
    """Rewrite the pages that are named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="+", type=Path)
    parser.add_argument("--brackets", help="what figures in brackets are")
    options = parser.parse_args()
    for page in options.pages:
        page.write_text(
            one_figure_a_cell(page.read_text("utf-8"), options.brackets), "utf-8"
        )


def one_figure_a_cell(page: str, brackets: str | None = None) -> str:
    """Return a page, all its tables split."""
    return re.sub(
        r"(^\|.*\n){3,}",
        lambda table: _split_table(table.group(), brackets),
        page,
        flags=re.MULTILINE,
    )


def split(
    heads: list[str], rows: list[list[str]], brackets: str | None = None
) -> tuple[list[str], list[list[str]]]:
    """Return heads and rows with a column for each figure, for each spread another."""
    columns = [
        column
        for n, head in enumerate(heads)
        for name, cells in _parts(head, [row[n] for row in rows])
        for column in _beside(name, cells, brackets)
    ]
    cells = [[cells[n] for _, cells in columns] for n in range(len(rows))]
    return [head for head, _ in columns], cells


Column = tuple[str, list[str]]


def _split_table(table: str, brackets: str | None) -> str:
    head, _, *rows = (
        [cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip()[1:-1])]
        for line in table.splitlines()
    )
    if any(len(row) != len(head) for row in rows):
        return table
    heads, cells = split(head, rows, brackets)
    if heads == head:
        return table
    lines = [heads, ["---"] * len(heads), *cells]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _parts(head: str, cells: list[str]) -> list[Column]:
    """Return the columns of one whose head and cells have as many parts, by " / "."""
    names = head.split(" / ")
    parts = [
        cell.split(" / ") if cell not in ("", "-") else ["-"] * len(names)
        for cell in cells
    ]
    if len(names) == 1 or any(len(part) != len(names) for part in parts):
        return [(head, cells)]
    return [(name, [part[n] for part in parts]) for n, name in enumerate(names)]


def _beside(head: str, cells: list[str], brackets: str | None) -> list[Column]:
    """Return a column, its spread, and what stands in brackets."""
    matches = [CELL.fullmatch(cell or "-") for cell in cells]
    figures = [match.groups() for match in matches if match]
    named = re.fullmatch(r"(.+?) \((.+)\)", head)
    if len(figures) < len(cells):
        return [(head, cells)]
    name, inside = named.groups() if named else (head, brackets)
    spreads, others = ([figure[n] or "-" for figure in figures] for n in (1, 2))
    columns = [(name, [figure[0] for figure in figures])]
    if {*spreads} != {"-"}:
        columns.append(("±", spreads))
    if {*others} != {"-"}:
        columns.append((inside or "", others))
    whole = (len(columns) > 1 or inside == "±") and all(name for name, _ in columns)
    return columns if whole else [(head, cells)]


if __name__ == "__main__":
    main()
