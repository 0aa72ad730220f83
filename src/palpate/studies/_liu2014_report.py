"""The Liu 2014 study as one self-contained HTML page."""

from html import escape
from pathlib import Path
from typing import Any

from ..evaluation import _plots, check_report_path
from ..evaluation._report import STYLE
from ._liu2014_pictures import pictures
from ._liu2014_tables import Table, tables

TITLE = "One press of a pressure array: Liu et al. (2014) beside ours"
CAPTIONS = {
    "stages": "The clean-up of simulated presses, stage by stage, as the paper's "
    "Fig. 10; the last three are thresholded as a whole, and on 2 x 2 and 3 x 3 "
    "partitions.",
    "parts": "Simulated presses of every part, with the outline of where it lay.",
    "conditions": "Load (cover 0.9 mm) and cover (4 kgf), as the paper's Figs 5 and 6 "
    "ask: accuracy, presses whose binary image falls into several pieces, and its "
    "overlap with the part's true face.",
}
REAL = (
    "Real presses are those of 17 objects on another 10 x 10 array, each object in one "
    "pose; in software they are turned by any angle, shifted by up to 2 taxels, their "
    "total made 1 and their gain varied by 20 %. The paper's parts they are not."
)


def write_report(path: str | Path, result: dict[str, Any]) -> Path:
    """Write tables and pictures as one page that loads nothing from elsewhere."""
    target = check_report_path(path)
    drawn = pictures(result)
    sections = [_head(result)]
    sections += [_table(one) for one in tables(result)]
    for name, figure in drawn.items():
        caption = escape(CAPTIONS[name])
        sections.append(f"<p>{_plots._svg(figure)}</p><p class=note>{caption}</p>")
    page = (
        "<!doctype html><html lang=en><meta charset=utf-8>"
        "<meta name=viewport content='width=device-width,initial-scale=1'>"
        f"<title>{escape(TITLE)}</title><style>{STYLE}</style><body>"
        + "".join(sections)
        + "</body></html>"
    )
    target.write_text(page, encoding="utf-8")
    return target


def _head(result: dict[str, Any]) -> str:
    plan = result["plan"]
    real = " ".join(result["skipped"]) or REAL
    how = (
        f"{len(plan['parts'])} simulated parts, {plan['n_presses']} presses each; "
        f"{plan['runs']} runs of twofold cross-validation, seed {plan['seed']}; mean ± "
        "standard deviation over runs, in per cent. nested: parameters chosen inside "
        "the training half; paper: on the runs reported, as the paper did. "
    )
    return f"<h1>{escape(TITLE)}</h1><p>{escape(how + real)}</p>"


def _table(table: Table) -> str:
    title, columns, rows = table
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>"
        for row in rows
    )
    return f"<h2>{escape(title)}</h2><table><tr>{head}</tr>{body}</table>"
