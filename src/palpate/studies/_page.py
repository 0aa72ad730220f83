"""A study as one self-contained HTML page: tables, then pictures."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from ..evaluation import PAGE_STYLE, check_report_path, plots

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Table = tuple[str, list[str], list[list[str]]]


def write_page(
    path: str | Path,
    title: str,
    text: str,
    tables: Sequence[Table],
    figures: Mapping[str, "Figure"],
    captions: Mapping[str, str],
) -> Path:
    """Write a page that loads nothing from elsewhere."""
    target = check_report_path(path)
    sections = [f"<h1>{escape(title)}</h1><p>{escape(text)}</p>"]
    sections += [_table(one) for one in tables]
    for name, figure in figures.items():
        caption = escape(captions[name])
        sections.append(f"<p>{plots._svg(figure)}</p><p class=note>{caption}</p>")
    page = (
        "<!doctype html><html lang=en><meta charset=utf-8>"
        "<meta name=viewport content='width=device-width,initial-scale=1'>"
        f"<title>{escape(title)}</title><style>{PAGE_STYLE}</style><body>"
        + "".join(sections)
        + "</body></html>"
    )
    target.write_text(page, encoding="utf-8")
    return target


def _table(table: Table) -> str:
    title, columns, rows = table
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>"
        for row in rows
    )
    return f"<h2>{escape(title)}</h2><table><tr>{head}</tr>{body}</table>"
