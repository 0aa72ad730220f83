"""A study's result for people: cells and tables of text, figures, one HTML page.

matplotlib is the extra `plot`, imported where it is used.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

from .._durable import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Row = dict[str, Any]
# A title, the names of the columns, and lines of text.
Table = tuple[str, list[str], list[list[str]]]
Figures = dict[str, "Figure"]
Value = TypeVar("Value")


def held(rows: Iterable[Row], **wanted: Any) -> list[Row]:
    """Return the rows that have these entries."""
    return [r for r in rows if all(r.get(k) == v for k, v in wanted.items())]


def pick(rows: Iterable[Row], **wanted: Any) -> Row | None:
    """Return the first row that has these entries, or None."""
    return next(iter(held(rows, **wanted)), None)


def unique(values: Iterable[Value]) -> list[Value]:
    """Return different values in the order in which they come first."""
    return list(dict.fromkeys(values))


def different(rows: Iterable[Row], *keys: str) -> list[tuple[Any, ...]]:
    """Return the different combinations of these entries, in their order."""
    return unique(tuple(row[key] for key in keys) for row in rows)


def spread(values: Any) -> float | None:
    """Return the standard deviation (n - 1) of an array; None for a single value."""
    return float(values.std(ddof=1)) if len(values) > 1 else None


def row(
    name: str, ours: float, sd: float | None = None, paper: float | None = None
) -> Row:
    """Return what every row has, to be joined with what tells it from the others."""
    return {"name": name, "paper": paper, "ours": float(ours), "sd": sd}


def mean_row(name: str, values: Any, paper: float | None = None) -> Row:
    """Return `row` of an array's mean and standard deviation."""
    return row(name, values.mean(), spread(values), paper)


def cell(row: Row | None) -> str:
    """Return mean and standard deviation, or a dash."""
    if row is None:
        return "-"
    deviation = "" if row["sd"] is None else f" ± {row['sd']:.1f}"
    return f"{row['ours']:.1f}{deviation}"


def paper(row: Row | None, frame: str = "{}") -> str:
    """Return the paper's figure in a frame such as " ({})", or nothing."""
    known = None if row is None else row["paper"]
    return "" if known is None else frame.format(f"{known:g}")


def with_paper(row: Row | None) -> str:
    """Return mean and standard deviation, the paper's figure in brackets."""
    return cell(row) + paper(row, " ({})")


def pivot(
    rows: Iterable[Row],
    keys: Sequence[str],
    columns: Iterable[Row],
    show: Callable[[Row | None], str],
    names: Mapping[str, str] = MappingProxyType({}),
) -> list[list[str]]:
    """Return lines: a combination of the entries `keys`, then a cell per column."""
    rows, columns, lines = list(rows), list(columns), []
    for known in different(rows, *keys):
        mine = held(rows, **dict(zip(keys, known, strict=True)))
        cells = [show(pick(mine, **column)) for column in columns]
        lines.append([*(names.get(key, key) for key in known), *cells])
    return lines


def panels(
    n_rows: int,
    n_columns: int,
    size: tuple[float, float],
    *,
    pictures: bool = False,
    **shared: Any,
) -> tuple["Figure", Any]:
    """Return a figure (size in inches) and its axes, shape (n_rows, n_columns)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(n_rows, n_columns, squeeze=False, **shared)
    for place in axes.ravel():
        if pictures:
            place.set(xticks=[], yticks=[])
        else:
            place.spines[["top", "right"]].set_visible(False)
    return figure, axes


def write_page(
    target: Path, title: str, text: str, tables: Iterable[Table], figures: Figures
) -> Path:
    """Write a page that loads nothing from elsewhere; figures by their captions."""
    from ..evaluation import html_table, plots, report_page

    sections = [f"<h1>{escape(title)}</h1><p>{escape(text)}</p>"]
    sections += [html_table(*table) for table in tables]
    for caption, figure in figures.items():
        drawn, below = plots._svg(figure), escape(caption)
        sections.append(f"<p>{drawn}</p><p class=note>{below}</p>")
    write_text(target, report_page(title, sections))
    return target
