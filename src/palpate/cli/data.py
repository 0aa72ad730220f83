"""`palpate data`: touches that others published, fetched from their public sources."""

import sys
import warnings
from typing import Annotated, Any

import typer

from ._options import AsJson, RecordedData, argument, option
from ._output import answer, say, stages

data = typer.Typer(
    no_args_is_help=True,
    help="Fetch touches that others published, and read what is known of them.",
)
Name = Annotated[
    str, argument("NAME", "A set or ready model; see `palpate data list`.")
]


@data.command("list")
def list_sets(data: RecordedData = None, as_json: AsJson = False) -> None:
    """List sets and ready models, and whether they are there or can be fetched."""
    from ..datasets import READY, card, names, where

    here, rows = where(data), []
    for description in map(card, names()):
        there = all((here / place).exists() for place in description["makes"])
        state = "there" if there else "no" if "why_not" in description else "to fetch"
        row = {key: description[key] for key in ("name", "what", "licence")}
        rows.append(row | {"state": state})
    lines = [f"{row['name']:16s}{row['state']:10s}{row['what']}" for row in rows]
    models = []
    for model in READY.values():
        state = "there" if model.file(data).is_file() else "to make"
        what = f"model: {model.what}"
        models.append({"name": model.name, "what": what, "state": state})
    lines += [
        f"{model['name']:16s}{model['state']:10s}{model['what']}" for model in models
    ]
    answer(as_json, {"folder": str(here), "sets": rows, "models": models}, *lines)


@data.command()
def fetch(
    name: Name,
    *,
    data: RecordedData = None,
    mirror: Annotated[str | None, option("URL in place of https://HOST.")] = None,
    as_json: AsJson = False,
) -> None:
    """Fetch a set once, check it, and make its touch archive; prints the path.

    Or make a ready model of a simulated sensor: sim-array, sim-dome, sim-gel.
    """
    from .. import datasets

    if name in datasets.names():
        source, licence = (datasets.card(name)[key] for key in ("source", "licence"))
        say(f"{source['page']}\nLicence: {licence}", file=sys.stderr)
    with warnings.catch_warnings(record=True) as noted, stages() as stage:
        warnings.simplefilter("always", UserWarning)
        path = datasets.fetch(name, folder=data, mirror=mirror, progress=stage)
    notes = [str(note.message) for note in noted]
    for note in notes:
        say(note, file=sys.stderr)
    answer(as_json, {"name": name, "path": str(path), "notes": notes}, path)


@data.command()
def where(data: RecordedData = None, as_json: AsJson = False) -> None:
    """Print the folder of recorded touches."""
    from .. import datasets

    folder = datasets.where(data)
    answer(as_json, {"folder": str(folder), "there": folder.is_dir()}, folder)


@data.command()
def card(name: Name, as_json: AsJson = False) -> None:
    """Print a set's source, licence, leaks, best figures, and what it is not for."""
    from .. import datasets

    description = datasets.card(name)
    columns = description.get("convert", {}).get("columns", {})
    description["holds"] |= {key: how["means"] for key, how in columns.items()}
    keys = (key for key in description if key not in ("convert", "arrays", "name"))
    answer(as_json, description, *(_as_lines(key, description[key]) for key in keys))


def _as_lines(key: str, value: Any) -> str:
    if isinstance(value, dict):
        value = [f"{name}: {item}" for name, item in value.items()]
    if not isinstance(value, list):
        return f"{key}: {value}"
    lines = ("; ".join(v.values()) if isinstance(v, dict) else v for v in value)
    return "\n  ".join([f"{key}:", *lines])
