"""`palpate library`: touches on disk, durable and searchable."""

import sys
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ._options import (
    AsJson,
    Reading,
    TouchesPath,
    Where,
    argument,
    flag,
    grouped,
    kind_of,
    option,
    say_limit,
    typed,
    written_file,
)
from ._output import answer, as_typed, counted, say

if TYPE_CHECKING:
    from ..library import TouchLibrary, TouchRow

library = typer.Typer(
    no_args_is_help=True,
    help="Keep touches in a library: a folder that never loses one.",
)

LibraryPath = Annotated[Path, argument("LIBRARY", "The folder of the library.")]
Object = Annotated[str, argument("An object.")]
Filter = Annotated[str | None, argument("FILTER", "A filter, as --where.")]
_OF_SENSOR = {"folder", "touches", "session", "object_name", "n_touches", "as_json"}


@library.command()
@grouped
def add(
    context: typer.Context,
    folder: LibraryPath,
    touches: TouchesPath,
    *,
    session: Annotated[str | None, option("Name of the recording session.")] = None,
    episode: Annotated[str | None, option("Name of the episode.")] = None,
    sensor: Annotated[str | None, option("Name of the sensor.")] = None,
    kind: Annotated[str | None, option("Of --sensor: camera, array...")] = None,
    unit: Annotated[str | None, option("Of --sensor: its unit, as kPa.")] = None,
    pitch_mm: Annotated[float | None, option("Of --sensor: taxels' distance.")] = None,
    topic: Annotated[
        str | None,
        option("Of a bag: the topic to read; of a LeRobotDataset: the feature."),
    ] = None,
    object_name: Annotated[
        str | None, option("--object", "What is touched in all of it.")
    ] = None,
    n_touches: Annotated[
        int, option("-n", "--touches", "Of a running sensor: how many.")
    ] = 12,
    detect: Annotated[
        bool,
        flag(
            "--detect",
            "Of a bag, a table or an archive of frames: they become touches where "
            "contact begins and ends, as those of a film always do. The first ten are "
            "taken for touching nothing.",
        ),
    ] = False,
    reading: Reading,
    as_json: AsJson = False,
) -> None:
    """Add touches; LIBRARY is made where there is none. Adding twice adds once."""
    from ..library import SensorDescription
    from ..sensors import is_address

    if sensor is None and (kind, unit, pitch_mm) != (None, None, None):
        raise ValueError("--kind, --unit and --pitch-mm must come with --sensor NAME.")
    if is_address(str(touches)) and not touches.exists():
        from .record import record_touches

        if object_name is None:
            raise ValueError(
                f"--object NAME must be given with a running sensor, got {touches} "
                "without. Say what is touched."
            )
        for name in typed(context, *sorted({*context.params} - _OF_SENSOR)):
            raise ValueError(
                f"--{name.replace('_', '-')} must be left out with a running sensor, "
                f"got {str(context.params[name])!r}. What the sensor takes stands in "
                "its address, as in 'camera:0?colour=1'."
            )
        n_taken = record_touches(str(touches), folder, object_name, n_touches, session)
        answer(
            as_json,
            {"library": str(folder), "given": n_taken, "added": n_taken},
            f"{counted(n_taken)} of {object_name} in {folder}.",
        )
        if n_taken < n_touches:
            raise typer.Exit(1)
        return
    if typed(context, "n_touches"):
        raise ValueError(
            f"--touches must be left out without a running sensor, got {n_touches}. "
            f"All of {touches} is added."
        )
    described = SensorDescription(sensor, kind, unit, pitch_mm) if sensor else None
    n_given = n_new = n_unlabelled = 0
    texts: list[str] = []
    begin = reading.begin
    detect = detect and kind_of(touches, topic) != "film"
    if detect:  # from all frames together, before a library is made
        from ..sensors import TouchDetector

        detector = TouchDetector(begin=begin)
        frames = replace(reading, begin=None).touches(touches, topic)
        parts = iter([detector.touches_in(frames)])
        say_limit(touches, detector)
    else:
        parts = reading.parts(touches, topic)
    with _opened(folder, create=True) as opened:
        n_there = sum(opened.stats()[:2])
        for part in parts:
            if object_name is not None:
                part = part.with_columns(object=[object_name] * len(part))
            ids = opened.add(part, session=session, episode=episode, sensor=described)
            n_given += len(part)
            if part.object is None:
                n_unlabelled += len(part)
                texts = [n for n, c in part.columns.items() if c.dtype.kind == "U"]
            later = opened.list(None, None, n_there, retracted=True)
            n_new += len({row.id for row in later} & {*ids})  # others may add meanwhile
            n_there += len(later)
        n_touches = opened.stats().n_touches
    if n_unlabelled:
        _say_unlabelled(touches, folder, n_unlabelled, texts)
    answer(
        as_json,
        {"library": str(folder), "given": n_given, "added": n_new},
        f"{n_new} new of {counted(n_given)}; {n_touches} in {folder}.",
    )


def _say_unlabelled(path: Path, folder: Path, n_touches: int, texts: list[str]) -> None:
    """Say that touches were added without an object, and which columns hold text."""
    has = f" (it has {', '.join(texts[:5])})" if texts else ""
    say(
        f"{counted(n_touches)} of {path} have no object: give --object NAME, or call "
        f"the column of names object{has}. To take out those that are in the library "
        f"now: `palpate library retract {folder} --where 'object is null' --reason "
        "WHY`.",
        file=sys.stderr,
    )


@library.command("list")
def list_touches(
    folder: LibraryPath,
    where: Where = None,
    limit: Annotated[int, option("At most so many.")] = 50,
    offset: Annotated[int, option("After so many.")] = 0,
    retracted: Annotated[bool, flag("--retracted", "Retracted ones too.")] = False,
    objects: Annotated[bool, flag("--objects", "List objects instead.")] = False,
    as_json: AsJson = False,
) -> None:
    """List touches (or objects) in the order in which they were added."""
    if objects and (where is not None or offset or retracted):
        raise ValueError(
            "--objects must stand without --where, --offset and --retracted, which "
            "choose touches. Leave these out: all objects are listed."
        )
    rows: list[Any]
    with _opened(folder) as opened:
        opened.refuse_unknown(where)
        rows = opened.list(where, limit, offset, retracted=retracted)
        if objects:
            rows = opened.objects()
    plain = [row._asdict() for row in rows]
    names = list(plain[0]) if objects and plain else _COLUMNS_SHOWN
    cells = [[_shown(row[name]) for name in names] for row in plain]
    if not objects:
        cells = [[key[:_ID_SHOWN], *rest] for key, *rest in cells]
    shown = str(folder), list(names), cells
    answer(as_json, {"library": str(folder), "rows": plain}, shown)


@library.command()
def show(
    folder: LibraryPath,
    touch: Annotated[str, argument("Id of a touch, or how it begins, as listed.")],
    output: Annotated[
        Path | None,
        written_file("-o", "--output", ending=".npy", text="Its image, .npy."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show what is known of one touch; write its image with -o."""
    import numpy as np

    from .._durable import replacing

    if not touch.isalnum():
        raise ValueError(f"The id of a touch must be hexadecimal, got {touch!r}.")
    touch = touch.lower()
    with _opened(folder) as opened:
        rows_of_id = opened.list(f"id contains '{touch}'", limit=None, retracted=True)
        rows = [row for row in rows_of_id if row.id.startswith(touch)]
        if len(rows) != 1:
            raise ValueError(
                f"The id must be that of one touch, got {touch!r}, which begins "
                f"{len(rows)} of them. See `palpate library list`."
            )
        image, values = opened.image(rows[0].id), rows[0]._asdict()
        if not rows[0].retracted:
            part = opened.touches(f"id = '{rows[0].id}'")
            more = {n: c[0] for n, c in part.columns.items() if n not in values}
            few = {n: c for n, c in more.items() if c.size <= _CELLS_SHOWN}
            # What JSON cannot hold, such as dates, as it is written.
            plain = {n: c.dtype.kind in "biufU" for n, c in few.items()}
            values |= {n: c.tolist() if plain[n] else str(c) for n, c in few.items()}
    values |= {"least": image.min().item(), "largest": image.max().item()}
    if output is not None:
        with replacing(output) as file:
            np.save(file, image, allow_pickle=False)
    lines = (f"{name:10s} {_shown(value)}" for name, value in values.items())
    answer(as_json, values, *lines)


@library.command()
def export(
    folder: LibraryPath,
    output: Annotated[
        str,
        option(
            "-o",
            "--output",
            "An .npz, a .parquet (of a store too: s3://...), or a folder for a "
            "LeRobotDataset.",
        ),
    ],
    where: Where = None,
    by: Annotated[
        str | None,
        option("Of Parquet: a folder with a file for each object, or session..."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write touches to an archive, to Parquet or to a LeRobotDataset."""
    with _opened(folder) as opened:
        opened.refuse_unknown(where)
        n_touches = opened.export(output, where, by=by)
    written = {"written": str(output), "n_touches": n_touches}
    answer(as_json, written, f"{counted(n_touches)} in {output}.")


@library.command()
def check(
    folder: LibraryPath,
    repair: Annotated[
        bool,
        flag("--repair", "Keep what is whole, and set the damaged file aside."),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Compare everything with its digests; exit code 1 where something is wrong."""
    from ..library import TouchLibrary, check_library

    repaired = TouchLibrary.repair_folder(folder) if repair else None
    report = check_library(folder)
    lines = [as_typed(str(report))]
    if repaired is not None and repaired.rebuilt:
        if repaired.lost or repaired.n_changes_lost:
            lines.insert(
                0,
                f"Lost: {counted(len(repaired.lost))}, "
                f"{counted(repaired.n_changes_lost, 'change')}. Touches can be added "
                "again.",
            )
        lines.insert(
            0,
            f"{counted(repaired.n_touches)} and "
            f"{counted(repaired.n_changes, 'change')} kept in a new database; the "
            f"damaged one is {repaired.set_aside}.",
        )
    values = report._asdict()
    values["problems"] = [problem._asdict() for problem in report.problems]
    values["repair"] = None if repaired is None else repaired._asdict()
    answer(as_json, values, *lines)
    if not report.ok:
        raise typer.Exit(1)


@library.command()
def backup(
    folder: LibraryPath,
    to: Annotated[Path, argument("TO", "A new folder for the copy.")],
    as_json: AsJson = False,
) -> None:
    """Copy a library, also while others add to it."""
    with _opened(folder) as opened:
        n_touches = opened.backup(to)
    copied = {"library": str(folder), "backup": str(to), "n_touches": n_touches}
    answer(as_json, copied, f"{counted(n_touches)} in {to}.")


@library.command()
def migrate(
    old: Annotated[Path, argument("OLD", "A library of format 1 or 2.")],
    new: Annotated[Path, argument("NEW", "A new folder for the library of today.")],
    as_json: AsJson = False,
) -> None:
    """Make a library of today of an old one, which stays as it is.

    One that was stopped goes on when it is called again.
    """
    from ..library import TouchLibrary

    report = TouchLibrary.migrate(old, new)
    lines = [f"{counted(report.n_touches)} in {new}; {old} is as it was."]
    if report.lost:
        lines.append(
            f"Not there, since their images in {old} are missing or altered: "
            f"{', '.join(report.lost)}."
        )
    if report.lost_arrays:
        lines.append(
            f"Lost in {old}: {', '.join(report.lost_arrays)} of some recordings; their "
            "touches are there without it."
        )
    if report.n_unknown_files:
        lines.append(
            f"{report.n_unknown_files} files in {old} are not known to its database: "
            "`palpate library check --repair` of the palpate that made it takes them "
            "in; migrate again then, to another folder."
        )
    answer(as_json, {"library": str(new), **report._asdict()}, *lines)
    if report.lost or report.n_unknown_files or report.lost_arrays:
        raise typer.Exit(1)


@library.command("history")
def show_history(folder: LibraryPath, as_json: AsJson = False) -> None:
    """Show every rename, merge, retraction and restoration."""
    with _opened(folder) as opened:
        changes = [change._asdict() for change in opened.history()]
    rows = [
        [
            datetime.fromtimestamp(change["time_s"]).isoformat(" ", "seconds"),
            change["action"],
            _what(change["content"]),
        ]
        for change in changes
    ]
    listed = str(folder), ["time", "change", "what"], rows
    answer(as_json, {"library": str(folder), "changes": changes}, listed)


def _what(content: dict[str, Any]) -> str:
    """Return what a change did, on one line."""
    names = ("old", "new", "source", "into", "object", "reason")
    parts = [f"{name} {content[name]}" for name in names if content.get(name)]
    touches = [counted(len(content["ids"]))] if "ids" in content else []
    return ", ".join(touches + parts)


@library.command()
def stats(folder: LibraryPath, as_json: AsJson = False) -> None:
    """Show how much the library holds."""
    with _opened(folder) as opened:
        counts = opened.stats()._asdict()
        sensors = [sensor._asdict() for sensor in opened.sensors()]
    lines = [f"{name:15s} {value:,}" for name, value in counts.items()]
    for sensor in sensors:
        described = ", ".join(str(value) for value in sensor.values() if value)
        lines.append(f"{'sensor':15s} {described}")
    answer(as_json, {**counts, "sensors": sensors}, *lines)


@library.command()
def rename(
    folder: LibraryPath,
    old: Object,
    new: Annotated[str, argument("Its new name.")],
    as_json: AsJson = False,
) -> None:
    """Give an object another name."""
    with _opened(folder) as opened:
        opened.rename_object(old, new)
    answer(as_json, {"old": old, "new": new}, f"{old} is now {new}.")


@library.command()
def merge(
    folder: LibraryPath,
    source: Object,
    into: Annotated[str, argument("What it really is.")],
    as_json: AsJson = False,
) -> None:
    """Make two objects one."""
    with _opened(folder) as opened:
        opened.merge_objects(source, into)
    merged = {"source": source, "into": into}
    answer(as_json, merged, f"{source} is now part of {into}.")


@library.command()
def retract(
    folder: LibraryPath,
    filter_text: Filter = None,
    *,
    where: Where = None,
    reason: Annotated[str, option("Why.")],
    as_json: AsJson = False,
) -> None:
    """Leave touches out from now on; they are kept and can be restored."""
    with _opened(folder) as opened:
        ids = [row.id for row in _meant(opened, filter_text, where)]
        n_retracted = opened.retract(ids, reason=reason)
    message = f"{counted(n_retracted)} retracted."
    answer(as_json, {"retracted": n_retracted}, message)


@library.command()
def restore(
    folder: LibraryPath,
    filter_text: Filter = None,
    *,
    where: Where = None,
    as_json: AsJson = False,
) -> None:
    """Take retracted touches back in."""
    with _opened(folder) as opened:
        rows = _meant(opened, filter_text, where, retracted=True)
        n_restored = opened.restore([row.id for row in rows if row.retracted])
    answer(as_json, {"restored": n_restored}, f"{counted(n_restored)} back.")


_ID_SHOWN = 12
_CELLS_SHOWN = 8  # of a column, for each touch: a place, a pose, a wrench; no frames
_COLUMNS_SHOWN = ("id", "object", "session", "episode", "order", "force_n", "retracted")


def _opened(folder: Path, *, create: bool = False) -> "TouchLibrary":
    from ..library import TouchLibrary

    return TouchLibrary.open(folder, create=create)


def _meant(
    opened: "TouchLibrary", filter_text: str | None, where: str | None, **how: Any
) -> "list[TouchRow]":
    """Return the touches of the one filter, which may be given in two ways."""
    if (filter_text is None) == (where is None):
        got = "neither" if where is None else "both"
        raise ValueError(f"Give either FILTER or --where FILTER, got {got}.")
    chosen = where if filter_text is None else filter_text
    opened.refuse_unknown(chosen)
    return opened.list(chosen, limit=None, **how)


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.12g}" if isinstance(value, float) else str(value)
