"""Touches as a notebook shows them: a small table, and the first few pictures."""

from collections.abc import Mapping
from html import escape

import numpy as np

from .._checks import check_count
from .._extras import needed
from .._page import as_shown, png_address
from .._types import Array

PICTURES = 8  # shown of a set
SIDE_PX = 96  # of each
_NAMES = 12  # listed
_LETTERS = 60  # of each name
_EVEN = "display:inline-block;margin:2px;text-align:center;vertical-align:top"


def touches_html(
    images: Array, columns: Mapping[str, Array], whole: Mapping[str, Array]
) -> str:
    """Return a set of touches as HTML that loads nothing from elsewhere."""
    n_touches = len(images)
    size = f"{' x '.join(map(str, images.shape[1:]))} {images.dtype}"
    rows = [("touches", str(n_touches)), ("images", size)]
    for name, many in (("object", "objects"), ("category", "categories")):
        if name in columns:
            counts = np.unique_counts(columns[name])
            each = [f"{_cut(name)} ({n})" for name, n in zip(*counts, strict=True)]
            rows.append((f"{len(each)} {many}", _listed(each)))
    for what, arrays in (("columns", columns), ("whole set", whole)):
        each = []
        for name, array in arrays.items():
            shape = " x ".join(map(str, array.shape)) or "one"
            kind = "text" if array.dtype.kind in "US" else array.dtype
            each.append(f"{_cut(name)} ({shape} {kind})")
        rows.append((what, _listed(each)))
    table = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th>"
        f"<td style='text-align:left'>{escape(value)}</td></tr>"
        for name, value in rows
    )
    labels = columns.get("object", np.full(n_touches, ""))
    shown = as_shown(images[:PICTURES], whole.get("channels"))
    pictures = "".join(
        f"<div style='{_EVEN}'><img src='{png_address(image, SIDE_PX)}' alt='touch'>"
        f"<br><small>{escape(_cut(label)[:16])}</small></div>"
        for image, label in zip(shown, labels[:PICTURES], strict=True)
    )
    return f"<div><table>{table}</table><div>{pictures}</div></div>"


def touches_axes(
    images: Array, columns: Mapping[str, Array], whole: Mapping[str, Array], most: int
) -> Array:
    """Draw the first `most` touches with their objects' names; see `Touches.plot`."""
    pyplot = needed("matplotlib.pyplot", "plot", "A picture of touches")
    n_shown = min(check_count("most", most), len(images))
    n_cols = max(1, min(n_shown, 6))
    n_rows = max(1, -(-n_shown // n_cols))
    axes = pyplot.subplots(
        n_rows,
        n_cols,
        squeeze=False,
        figsize=(1.6 * n_cols, 1.8 * n_rows),
        layout="constrained",
    )[1]
    shown = as_shown(images[:n_shown], whole.get("channels")).astype(np.float64)
    if shown.ndim == 4 and shown.size:  # colours from 0 to 1, alike in all pictures
        low, high = np.nanmin(shown), np.nanmax(shown)
        shown = (shown - low) / max(high - low, 1e-12)
    labels = columns.get("object", np.full(n_shown, ""))
    for place in axes.flat:
        place.set_axis_off()
    for place, image, label in zip(axes.flat, shown, labels, strict=False):
        place.imshow(image, cmap="gray", interpolation="nearest")
        place.set_title(_cut(label)[:16], fontsize=8)
    return np.asarray(axes)


def _listed(each: list[str]) -> str:
    more = [f"and {len(each) - _NAMES} more"] if len(each) > _NAMES else []
    return ", ".join(each[:_NAMES] + more) or "none"


def _cut(name: object) -> str:
    text = str(name)
    return text if len(text) <= _LETTERS else text[:_LETTERS] + "..."
