"""Pages of HTML that are written for people: reports, sheets, certificates.

A page is one file that loads nothing from elsewhere. Its sections are made by those who
have something to tell; matplotlib, which draws for them, is imported where it is used.
"""

import base64
import io
import re
from collections.abc import Collection, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ._durable import check_folder_of
from ._extras import needed
from ._types import RGB, Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK = "#1f2933"
# Apart for the colour-blind too, in this order; the site's pictures have the same.
COLOURS = ("#0b6e8a", "#d55e00", "#e0a100", "#6b4e9b", "#5a6572", "#7fb8a4")
OURS, CONTROL_COLOURS = COLOURS[0], COLOURS[1:5]
# Of taxels that are dead: blue, green, red.
_DEAD = (60, 60, 220)
_TYPED = re.compile(r"`([^`]+)`|(?<![\w-])--[a-z][a-z-]*")
PAGE_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#1f2933;background:#fff;
max-width:62rem;margin:2rem auto;padding:0 1rem}
code{white-space:nowrap;font:inherit}h1{font-size:1.6rem}h2{font-size:1.15rem;margin-top:2.2rem}
table{border-collapse:collapse}
td,th{padding:.15rem .7rem;text-align:right;border-bottom:1px solid #dde3e8}
td:first-child,th:first-child{text-align:left}
.row{display:flex;flex-wrap:wrap;gap:1.5rem;align-items:flex-start}
.line{display:flex;align-items:center;border-bottom:1px solid #eef1f4}
.name{width:13rem;overflow-wrap:anywhere}
.touches img{height:84px;max-width:calc(100% - 4px);border-radius:4px;margin:2px}
.why{display:flex;gap:.6rem;margin:.4rem 0}
.why div{width:9rem;font-size:.8rem;line-height:1.25;overflow-wrap:anywhere}
.why div:first-child{width:19rem;display:flex;flex-wrap:wrap;align-content:flex-start;
gap:.6rem;border-right:1px solid #dde3e8}.why div:first-child span{flex:1 1 7rem}
.why img{display:block;height:72px;max-width:100%;border-radius:4px;margin-bottom:2px}
.note,figcaption{color:#5a6572}svg{max-width:100%;height:auto}
table,figure div{display:block;max-width:100%;overflow-x:auto}
figure{display:flex;flex-wrap:wrap;gap:1rem;margin:2.5rem 0}figcaption{flex:1 1 18rem}
figure svg{min-width:calc(var(--inches)*72px)}
@media(max-width:36rem){body{margin:1rem auto;padding:0 .7rem}
table{font-size:.85rem}td,th{padding:.15rem .3rem}th:first-child{min-width:8rem}
.why{flex-wrap:wrap;gap:.3rem .5rem;border-top:1px solid #dde3e8;padding-top:.4rem}
.why div{width:calc(33% - .5rem)}.why div:first-child{width:100%;border:0}
.why div:first-child span{width:auto}}
"""


def check_report_path(path: str | Path) -> Path:
    """Return `path` if a report can be written there, or explain."""
    needed("matplotlib", "plot", "A report")
    target = Path(path)
    if target.suffix != ".html":
        raise ValueError(f"A report must end in .html, got {target.name!r}.")
    check_folder_of(target)
    return target


def report_page(title: str, sections: Sequence[str]) -> str:
    """Return sections of HTML as one page in the style of reports."""
    return (
        "<!doctype html><html lang=en><meta charset=utf-8>"
        "<meta name=viewport content='width=device-width,initial-scale=1'>"
        f"<title>{escape(title)}</title><style>{PAGE_STYLE}</style><body>"
        f"{''.join(sections)}</body></html>"
    )


def html_table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]
) -> str:
    """Return lines of text under a title as a table of HTML."""
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>"
        for row in rows
    )
    above = f"<h2>{escape(title)}</h2>" if title else ""
    return f"{above}<table><tr>{head}</tr>{body}</table>"


def worded(sentence: str) -> str:
    """Return a sentence as HTML, in which what is to be typed stands as such.

    That is between backticks, or an option, which then does not break after its dashes.
    """
    text = escape(sentence)
    return _TYPED.sub(lambda typed: f"<code>{typed[1] or typed[0]}</code>", text)


def as_shown(images: Array, channels: Collection[str] | None) -> Array:
    """Return images (n_touches, n_rows, n_cols[, n_channels]) as people look at them.

    With channels "r", "g" and "b" these three in that order, else the mean over all;
    images without an axis of channels stay as they are.
    """
    if channels is None or images.ndim == 3:
        return images
    names = list(channels)
    if set(RGB) <= set(names):
        return images[..., [names.index(name) for name in RGB]]
    return np.asarray(images.mean(axis=-1, dtype=np.float64))


def png_address(image: Array, side: int) -> str:
    """Return an image (n_rows, n_cols[, 3]) as a PNG in a data address.

    Contrast is stretched from its 0.5th to its 99.5th percentile; dead taxels (NaN) are
    red. `side` is the longer side of the picture in pixels.
    """
    import cv2

    levels = np.asarray(image, dtype=np.float64)
    is_nan = np.isnan(levels)
    live = np.zeros(1) if is_nan.all() else levels[~is_nan]
    levels = np.where(is_nan, live.min(), levels)
    dead: Array = np.any(np.atleast_3d(is_nan), axis=2)
    low, high = np.percentile(live, [0.5, 99.5])
    with np.errstate(over="ignore", invalid="ignore"):
        grey = np.clip((levels - low) / max(high - low, 1e-12), 0, 1) * 255
    n_rows, n_cols = levels.shape[:2]
    scale = side / max(n_rows, n_cols)
    size = (max(1, round(n_cols * scale)), max(1, round(n_rows * scale)))
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST
    drawn = cv2.resize(np.nan_to_num(grey).astype(np.uint8), size, interpolation=how)
    if levels.ndim == 3:
        drawn = cv2.cvtColor(drawn, cv2.COLOR_RGB2BGR)
    if dead.any():
        marked = cv2.resize(dead.astype(np.float32), size, interpolation=how) > 0
        if levels.ndim == 2:
            drawn = cv2.cvtColor(drawn, cv2.COLOR_GRAY2BGR)
        drawn[marked] = _DEAD
    data = cv2.imencode(".png", drawn)[1].tobytes()
    return "data:image/png;base64," + base64.b64encode(data).decode()


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
        hidden = [*place.spines] if pictures else ["top", "right"]
        place.spines[hidden].set_visible(False)
    return figure, axes


def draw_confusion(
    axes: Any, confusion: Array, names: Sequence[str], size: float
) -> None:
    """Draw shares as colours, those of at most 20 labels also as per cent."""
    shown = [name.replace("$", r"\$") for name in names]  # no formulas
    axes.imshow(confusion, cmap="GnBu", vmin=0, vmax=1)
    axes.set_xticks(range(len(names)), shown, rotation=60, ha="right", fontsize=size)
    axes.set_yticks(range(len(names)), shown, fontsize=size)
    if len(names) <= 20:
        for row, column in np.argwhere(confusion >= 0.005):
            share = confusion[row, column]
            style = {"fontsize": size - 1, "color": "white" if share > 0.6 else INK}
            text = f"{100 * share:.0f}"
            axes.text(column, row, text, ha="center", va="center", **style)


def svg(figure: "Figure", alt: str) -> str:
    """Return a figure as SVG text that a page can hold, `alt` for who cannot see it."""
    from matplotlib import rc_context

    text = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "palpate"}):
        figure.savefig(text, format="svg", metadata={"Date": None}, transparent=True)
    whole = text.getvalue()
    named = f'<svg role="img" aria-label="{escape(alt)}"'
    return named + whole[whole.index("<svg") + 4 :]
