"""One self-contained HTML page that a person would rather look at than numbers."""

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from .._durable import write_text
from .._types import Floats
from ..touches import as_shown, png_address
from . import plots
from ._controls import as_good_alone
from ._metrics import calibration_bins, spread
from ._report_why import explanations
from ._trial import Trial, scored

EXAMPLES = 6
SIDE = 120
PAIRS = 5
PICTURES_PER_PAIR = 4
PAGE_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#1f2933;background:#fff;
max-width:62rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.6rem}h2{font-size:1.15rem;margin-top:2.2rem}
table{border-collapse:collapse}
td,th{padding:.15rem .7rem;text-align:right;border-bottom:1px solid #dde3e8}
td:first-child,th:first-child{text-align:left}
.row{display:flex;flex-wrap:wrap;gap:1.5rem;align-items:flex-start}
.line{display:flex;align-items:center;border-bottom:1px solid #eef1f4}
.name{width:13rem;overflow-wrap:anywhere}
.touches img{height:84px;border-radius:4px;margin:2px}
.why{display:flex;gap:.6rem;margin:.4rem 0}
.why div{width:9rem;font-size:.8rem;line-height:1.25;overflow-wrap:anywhere}
.why div:first-child{width:19rem;display:flex;gap:.6rem;border-right:1px solid #dde3e8}
.why img{display:block;height:72px;border-radius:4px;margin-bottom:2px}
.note{color:#5a6572}svg{max-width:100%;height:auto}
"""


def check_report_path(path: str | Path) -> Path:
    """Return `path` if a report can be written there, or explain."""
    plots.require_matplotlib()
    target = Path(path)
    if target.suffix != ".html":
        raise ValueError(f"A report must end in .html, got {target.name!r}.")
    if not target.parent.is_dir():
        raise ValueError(f"There is no folder {target.parent} to write to; make it.")
    return target


def write_report(
    path: str | Path, figures: dict[str, Any], trials: Sequence[Trial]
) -> Path:
    """Write accuracy, confusion, calibration, reasons and touches as one page.

    Parameters
    ----------
    path : str or Path
        Ending in `.html`; nothing else is written and nothing is loaded from
        elsewhere when it is looked at.
    figures : dict
        From `evaluate`.
    trials : sequence of Trial
        From `evaluate`.
    """
    target = check_report_path(path)
    sections = [
        _head(figures),
        _accuracy(figures, trials),
        "".join(f"<p><b>{escape(one)}</b></p>" for one in as_good_alone(figures)),
        _decisions(figures["decision"]),
        _confusion(figures, trials),
        explanations(figures, trials),
        _examples(trials),
    ]
    title = f"palpate: {figures['n_labels']} {figures['label']} labels"
    write_text(target, report_page(title, sections))
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
    return f"<h2>{escape(title)}</h2><table><tr>{head}</tr>{body}</table>"


def _head(figures: dict[str, Any]) -> str:
    how = figures["split"] or "separate test touches"
    folds = f", {figures['n_folds']} folds" if figures["n_folds"] > 1 else ""
    chosen = figures["chosen"]
    found = "".join(f"<br>Found: {escape(one)}." for one in chosen.get("found", ()))
    return (
        f"<h1>Recognising {figures['n_labels']} {figures['label']} labels by touch</h1>"
        f"<p>Preset <b>{escape(figures['preset'])}</b>, "
        f"{figures['n_train_touches']} training and {figures['n_test_touches']} "
        f"test touches ({escape(how)}{folds}), "
        f"{figures['orders']} random orders of each object's touches.<br>"
        f"<span class=note>Encoding: {escape(str(chosen['encoding']))} "
        f"({escape(str(chosen['why']))}; geometry {escape(str(chosen['geometry']))})."
        f"{found}</span></p>"
    )


def _accuracy(figures: dict[str, Any], trials: Sequence[Trial]) -> str:
    plot = plots.accuracy_curve(figures, *_curve(trials))
    bins = {}
    for k in figures["accuracy"]:
        ends = scored(trials, int(k))
        confidence = np.concatenate([one.confidence for one in ends])
        bins[k] = calibration_bins(confidence, np.concatenate([e.hit for e in ends]))
    return (
        "<h2>Accuracy against touches, and whether the belief can be trusted</h2>"
        f"<div class=row>{plot}{plots.calibration_plot(bins)}</div>"
        "<p class=note>Left: mean and one standard deviation over objects (over folds "
        "where there are several). Dashed: what nuisance values achieve by themselves."
        " Right: a belief of 0.9 should be right nine times in ten.</p>"
        + _table(figures)
    )


def _table(figures: dict[str, Any]) -> str:
    keys = list(figures["accuracy"])
    rows = [
        ("right, %", figures["accuracy"], 100, 1),
        ("standard deviation, %", figures["accuracy_sd"], 100, 1),
        ("log loss, nats", figures["log_loss"], 1, 2),
        ("calibration error", figures["ece"], 1, 3),
    ]
    for name, control in figures["controls"].items():
        rows.append((f"control: {name}, %", control or {}, 100, 1))
    if "category_accuracy" in figures:
        rows.append(("category right, %", figures["category_accuracy"], 100, 1))
    if "unknown_auroc" in figures:
        rows.append(("unknown objects, ROC area", figures["unknown_auroc"], 1, 3))
    head = "".join(f"<th>{k}</th>" for k in keys)
    body = "".join(
        f"<tr><td>{escape(name)}</td>"
        + "".join(
            f"<td>{scale * values[k]:.{digits}f}</td>" if k in values else "<td>-</td>"
            for k in keys
        )
        + "</tr>"
        for name, values, scale, digits in rows
    )
    return f"<table><tr><th>after touches</th>{head}</tr>{body}</table>"


def _decisions(decision: dict[str, Any]) -> str:
    """Say how episodes ended, and what the error asked for is worth."""
    n_episodes = decision["n_episodes"]
    shares = [decision[key] / n_episodes for key in ("right", "wrong", "refused")]
    shares.append(decision["undecided"])
    heads = ["named right", "named wrong", "called unknown", "undecided", "touches"]
    cells = [f"{100 * share:.1f} %" for share in shares]
    cells.append(f"{decision['mean_touches']:.1f}")
    n_objects = decision["n_objects"]
    short = "" if decision["can_be_verified"] else ": too few to show the error asked"
    return html_table(
        f"Stopping at an error of {decision['error']:g}, a refusal of "
        f"{decision['refusal']:g}",
        heads,
        [cells],
    ) + (
        f"<p class=note>At most {100 * decision['bound']:.0f} % of new objects that "
        f"are named would be named wrong, at 95 % confidence from {n_objects} objects"
        f"{short}.</p>"
    )


def _confusion(figures: dict[str, Any], trials: Sequence[Trial]) -> str:
    k = [int(key) for key in figures["accuracy"]][min(1, len(figures["accuracy"]) - 1)]
    names = [str(name) for name in trials[0].recogniser.classes_]
    confusion = np.mean([one.confusion for one in scored(trials, k)], axis=0)
    off = confusion.copy()
    np.fill_diagonal(off, 0)
    order = np.argsort(off, axis=None)[::-1][:PAIRS].tolist()
    pairs = [divmod(place, len(names)) for place in order if off.flat[place] > 0]
    shown = "".join(_pair(trials, names, pair, off[pair]) for pair in pairs)
    return (
        f"<h2>What is taken for what, after {k} touches</h2>"
        + plots.confusion_plot(confusion, names)
        + "<h2>Most confused pairs</h2>"
        + (shown or "<p>No label was ever taken for another.</p>")
    )


def _pair(
    trials: Sequence[Trial], names: list[str], pair: tuple[int, int], share: float
) -> str:
    true, said = (escape(names[i]) for i in pair)
    cells = "".join(
        "<div><div class=touches>"
        f"{_pictures(trials, names[i], PICTURES_PER_PAIR)}</div>"
        f"<span class=note>{escape(names[i])}</span></div>"
        for i in pair
    )
    title = f"<b>{true}</b> taken for <b>{said}</b>"
    return f"<p>{title}: {100 * share:.0f} %</p><div class=row>{cells}</div>"


def _examples(trials: Sequence[Trial]) -> str:
    names = [str(name) for name in trials[0].recogniser.classes_]
    lines = "".join(
        f"<div class=line><div class=name>{escape(name)}</div>"
        f"<div class=touches>{_pictures(trials, name, EXAMPLES)}</div></div>"
        for name in names
    )
    return f"<h2>Touches of each label</h2>{lines}"


def _pictures(trials: Sequence[Trial], name: str, count: int) -> str:
    """Return evenly spaced training touches of a label, cleaned up, as images."""
    trial = trials[0]
    rows = np.flatnonzero(trial.recogniser.memory_.labels == name)
    some = rows[np.unique(np.linspace(0, len(rows) - 1, count).astype(int))]
    touches = trial.fold.train[some]
    cleaned = as_shown(trial.recogniser.encoder_.clean(touches), touches.channels)
    alt = escape(f"touch of {name}")
    return "".join(
        f"<img src='{png_address(image, SIDE)}' alt='{alt}'>" for image in cleaned
    )


def _curve(trials: Sequence[Trial]) -> tuple[Floats, Floats]:
    """Return mean and spread of accuracy after 1, 2, 3... touches.

    As far as every object has that many touches.
    """
    shortest = min(b.shape[1] for trial in trials for b in trial.episodes.beliefs)
    each = [[one.accuracy for one in scored(trials, k)] for k in range(1, shortest + 1)]
    per_fold = np.array([[over.mean() for over in folds] for folds in each])
    over = [folds[0] for folds in each] if len(trials) == 1 else per_fold
    return per_fold.mean(axis=1), np.array([float(spread(one)) for one in over])
