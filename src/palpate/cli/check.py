"""`palpate check`: what is wrong with touches, before anything is learnt from them."""

from dataclasses import replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ._notes import STILLS, left_aside, named_in_ways, read_as
from ._options import AsJson, Page, Reading, TouchesPath, grouped, kind_of
from ._output import answer, as_typed, counted, stages

if TYPE_CHECKING:
    from ..touches import PictureCheck, Touches

SHEET_OBJECTS, SHEET_TOUCHES, SHEET_SIDE = 60, 8, 96
_ROWS_SHOWN, _NAMED, _ALIKE = 40, 3, 5
_TOUCH_FILES = (".csv", ".npy")  # of folders without pictures, one touch each
# A step from touch to touch is small below this share of what touches of one object
# differ by; of recorded touches 8 % are at most, of frames of one grasp 74 %.
_SMALL_STEP, _LOOKED_AT, _SIDE = 0.2, 200, 48
_STYLE = (
    "<style>:is(td,th){text-align:left}.sheet{display:flex;flex-wrap:wrap;gap:.5rem}"
    ".sheet div{width:6rem;"
    "font-size:.75rem;line-height:1.25;overflow-wrap:anywhere}"
    ".sheet img{display:block;max-width:100%;outline:1px solid #b8c2cc}</style>"
)
# What is odd about pictures that can be used: on the sheet, and in a note.
_ODD = {
    "turned": ("turned upright", "turned upright, as the camera noted (Exif)"),
    "coloured": (
        "in colour",
        "in colour among grey ones, read in grey, to be taken out if of another sensor",
    ),
    "grey": ("in grey", "in grey among those in colour"),
    "flat": ("flat", "flat, of one level all over, to be recorded again or left out"),
    "copies": ("a copy", "there twice"),
}


@grouped
def check(
    touches: TouchesPath,
    *,
    reading: Reading,
    report: Page = None,
    as_json: AsJson = False,
) -> None:
    """Look at touches before learning: bad pictures, counts, what is no touch.

    For example: palpate check touches/. Every picture that cannot be used is listed
    with its fix; exit code 1 if there are some. --report writes the same with a sheet
    of touches of each object.
    """
    from .._durable import write_text
    from ..evaluation import named_alone
    from ..touches import TouchesError

    with stages() as stage:
        stage(f"looking at {touches}")
        pictures = _pictures(reading, touches)
        usable = replace(reading, skip_bad=True) if pictures.bad else reading
        try:
            read, problem = usable.touches(touches, quiet=True), ""
        except TouchesError as error:
            if not pictures.bad:
                raise
            read, problem = None, as_typed(str(error))
        stage("what is no touch")
        alone = {} if read is None or read.object is None else named_alone(read)
    odd = _odd(pictures)
    notes = _notes(pictures, odd, 0 if read is None else len(read))
    if read and pictures.is_of_pictures:
        notes.append(named_in_ways(reading, touches, read))
    elif read:
        notes += [left_aside(reading, touches, read), _copies(read)]
    notes = [note for note in notes if note]
    checked: dict[str, Any] = {
        "touches": str(touches),
        "problem": problem,
        "n_touches": 0 if read is None else len(read),
        "size": None if read is None else " x ".join(map(str, read.images.shape[1:])),
        "read_as": "" if read is None else read_as(reading, touches, read),
        "bad": [{**bad._asdict(), "fix": as_typed(bad.fix)} for bad in pictures.bad],
        "odd": odd,
        "notes": notes,
        "objects": [] if read is None else _objects(read),
        "alone": alone,
    }
    checked["advice"] = _advice(checked, read, reading)
    if report is not None:
        write_text(report, _page(checked, read))
    answer(as_json, checked, *_parts(checked), report)
    if checked["bad"]:
        raise typer.Exit(1)


def _pictures(reading: Reading, touches: Path) -> "PictureCheck":
    """Look at every picture, if `touches` is a folder of pictures."""
    from ..touches import PictureCheck

    if kind_of(touches) != "folder":
        return PictureCheck()
    return PictureCheck.of_folder(
        touches,
        name_pattern=reading.name_pattern,
        levels=reading.levels,
        no_contact=reading.no_contact,
        colour=bool(reading.colour),
        max_pixels=reading.max_pixels,
    )


def _odd(pictures: "PictureCheck") -> dict[str, list[Any]]:
    """Return the pictures that can be used and are odd, by what is odd about them."""
    few = "coloured" if len(pictures.coloured) < len(pictures.grey) else "grey"
    odd: dict[str, list[Any]] = {
        "turned": pictures.turned,
        few: getattr(pictures, few),
        "flat": pictures.flat,
        "copies": [[*pair] for pair in pictures.same],
    }
    return {kind: names for kind, names in odd.items() if names}


def _notes(
    pictures: "PictureCheck", odd: dict[str, list[Any]], n_read: int
) -> list[str]:
    if not pictures.is_of_pictures:
        return [
            f"{counted(len(names), 'file')} of {ending} read in grey, none looked at: "
            "save them as PNG"
            for ending, names in pictures.others.items()
        ]
    notes = []
    for kind, pairs in odd.items():
        names = [" and ".join(p) if kind == "copies" else p for p in pairs]
        many = counted(len(names), "picture")
        notes.append(f"{many} {_ODD[kind][1]}: {_first(names)}")
    if pictures.coloured and "coloured" not in odd:
        many = counted(len(pictures.coloured), "picture")
        notes.append(
            f"{many} in colour read in grey: --colour, if colour tells, as on a gel"
        )
    for ending, names in pictures.others.items():
        mend = ": save as PNG" * (ending in STILLS)
        if ending in _TOUCH_FILES and len(names) > n_read:
            mend = ": if these are the touches, take the pictures out"
        many = counted(len(names), "file")
        notes.append(f"{many} of {ending} left alone ({_first(names)}){mend}")
    if empty := pictures.empty:
        notes.append(f"{counted(len(empty), 'folder')} empty: {_first(empty)}")
    return notes


def _copies(touches: "Touches") -> str:
    """Say which touches are another one to the bit, but for those of one level."""
    from .._checks import listed

    first: dict[bytes, int] = {}
    pairs = []
    for row, image in enumerate(touches.images):
        before = first.setdefault(image.tobytes(), row)
        if before != row and (image != image.flat[0]).any():
            pairs.append(f"{row} as {before}")
    return f"{counted(len(pairs))} there twice: {listed(pairs, 3)}" if pairs else ""


def _first(names: list[str]) -> str:
    """Return the first few names, and where the rest is."""
    more = f" and {len(names) - _NAMED} more (--json lists all)"
    return ", ".join(names[:_NAMED]) + more * (len(names) > _NAMED)


def _objects(touches: "Touches") -> list[dict[str, Any]]:
    import numpy as np

    if touches.object is None:
        return []
    rows = []
    for name in np.unique(touches.object).tolist():
        these = touches.object == name
        sessions = None
        if touches.session is not None:
            sessions = len(np.unique(touches.session[these]))
        rows.append({"object": name, "touches": int(these.sum()), "sessions": sessions})
    return rows


def _advice(
    checked: dict[str, Any], touches: "Touches | None", reading: Reading
) -> list[str]:
    """Return what to do before learning, the most harmful first."""
    if touches is None:
        return []
    from ..evaluation import few_touches

    objects, path = checked["objects"], Path(checked["touches"])
    if not objects:
        return [_label_advice(path, touches)]
    advice = []
    if checked["bad"]:
        advice.append(
            "mend the pictures that cannot be used, or learn without them: --skip-bad"
        )
    advice += [_sets_of_same_names(touches), *_name_advice(objects)]
    if len(objects) == 1:
        advice.append("there is one object: add others, or nothing can be told apart")
    advice.append(few_touches({row["object"]: row["touches"] for row in objects}))
    advice.append(_frames_of_touches(touches))
    most_sessions = max(row["sessions"] or 1 for row in objects)
    if most_sessions < 2:
        advice.append(
            "all is of one session, as far as is written: mount the sensor anew for "
            "half of the touches, in folders such as mug/day1 and mug/day2, or a "
            "column session; else expect less on another day"
        )
    if touches.geometry != "none" and not _knows_rest(path, touches, reading):
        how = "--no-contact FILE"
        takes = kind_of(path) in ("film", "file") or touches.files is not None
        if touches.images.dtype.kind != "u" or not takes:  # no picture has the unit
            how = "in Python, touches.with_columns(no_contact=frame).save(FILE)"
        advice.append(
            f"a picture of touching nothing helps, and a replay needs one: {how}"
        )
    advice.append(_alone_advice(checked["alone"], most_sessions))
    return [*filter(None, advice)]


def _label_advice(path: Path, touches: "Touches") -> str:
    """Return how touches without objects are labelled."""
    from .._types import PICTURES

    kind = kind_of(path)
    if kind == "film":
        film = f"`palpate library add LIBRARY {path} --object NAME`"
        return f"nothing is labelled: {film}, film by film, and learn LIBRARY"
    fix = "put the pictures of each object into a folder of its name"
    if kind != "folder":
        has = ", ".join([*touches.columns][:_NAMED])
        has = f" (it has {has})" if has else ""
        fix = f"call the column of names object{has}, or, in Python, save "
        fix += "Touches(images, object=names); put a single picture into a folder"
    if kind == "folder" or path.suffix.lower() in PICTURES:
        fix += ", or see --name-pattern"
    return f"nothing is labelled: {fix}"


def _name_advice(objects: list[dict[str, Any]]) -> list[str]:
    """Return which names are alike, or must not be given."""
    advice = []
    spelt: dict[str, list[str]] = {}
    for row in objects:
        name = " ".join(row["object"].casefold().split())
        spelt.setdefault(name, []).append(row["object"])
    if alike := [names for names in spelt.values() if len(names) > 1]:
        same = [name for names in alike for name in names]
        in_blanks = any(name != " ".join(name.split()) for name in same)
        pairs = ", ".join(" and ".join(names) for names in alike[:_NAMED])
        how = "capitals or blanks" if in_blanks else "capitals"
        advice.append(
            f"objects whose names differ in {how} alone ({pairs}) count as "
            "different ones: give them one name if they are one"
        )
    if any(row["object"] == "unknown" for row in objects):
        advice.append(
            "no object can be called unknown, which is said of things never learnt: "
            "name it otherwise, or give it by itself to `palpate evaluate --unknown`"
        )
    return advice


def _alone_advice(alone: dict[str, Any], n_sessions: int) -> str:
    """Return that something which is no touch names objects, "" where nothing does."""
    for name, control in alone.items():
        if control["right"] > control["chance"] + (1 - control["chance"]) / 3:
            split = "session" if n_sessions > 1 else "last"
            right = f"{100 * control['right']:.1f} %"
            return (
                f"{name} alone, which is no touch, names {right} "
                "right: record objects in turns, not one after the other, and look at "
                f"the controls of `palpate evaluate --split {split}`"
            )
    return ""


def _knows_rest(path: Path, touches: "Touches", reading: Reading) -> bool:
    """Tell whether there is a frame of no contact; recordings may have several."""
    several = kind_of(path) in ("library", "Parquet file") and not reading.no_contact
    if touches.no_contact is not None or not several:
        return touches.no_contact is not None
    with reading.selection(path) as chosen:
        return chosen.no_contact is not None


def _frames_of_touches(touches: "Touches") -> str:
    """Say that most touches are almost the same as the one before, as frames are."""
    import numpy as np

    assert touches.object is not None
    thin = max(max(touches.images.shape[1:3]) // _SIDE, 1)
    n_near, n_steps = 0, 0
    for name in np.unique(touches.object):
        rows = np.flatnonzero(touches.object == name)[:_LOOKED_AT]
        images = touches.images[rows][:, ::thin, ::thin]
        levels = np.nan_to_num(images.astype(np.float64)).reshape(len(rows), -1)
        steps = np.linalg.norm(np.diff(levels, axis=0), axis=1)
        others = np.linalg.norm(levels - np.roll(levels, len(rows) // 2, 0), axis=1)
        n_near += int((steps < _SMALL_STEP * np.median(others)).sum())
        n_steps += len(steps)
    if 2 * n_near <= n_steps:
        return ""
    return (
        f"{n_near} of {n_steps} touches are almost the same as the one before: if "
        "these are frames of one touch, keep one frame of each touch, or figures will "
        "be too good and beliefs too sure (in Python TouchDetector().touches_in finds "
        "them)"
    )


def _sets_of_same_names(touches: "Touches") -> str:
    """Return what to do where most folders hold objects of the same names, or ""."""
    if touches.object is None or touches.category is None:
        return ""
    above: dict[str, list[str]] = {}
    for name in sorted(set(map(str, touches.object))):
        folder, _, rest = name.partition("/")
        above.setdefault(rest, []).append(folder)
    n_folders = len({folder for inside in above.values() for folder in inside})
    most = max(1, n_folders / 2)
    names = [rest for rest in sorted(above) if rest and len(above[rest]) > most]
    if len(names) < 2:
        return ""
    folders = above[names[0]]
    few = ", ".join(names[:_NAMED]) + ", ..." * (len(names) > _NAMED)
    of_folders = " and ".join(f"{folder}/" for folder in folders[:_NAMED])
    return (
        f"the same names ({few}) are in {of_folders}, and count as different objects: "
        "if each folder is a set of its own, one to learn and one to test, give it by "
        f"itself, as .../{folders[0]}; if all are one set, say --levels object/session "
        "where the outer folders are the objects, session/object where they are days, "
        "-/object where they say nothing"
    )


def _rows(bad: list[dict[str, Any]]) -> list[list[str]]:
    """Return a row for each bad picture, one for many that are wrong in one way."""
    from .._checks import listed

    rows: list[list[str]] = []
    alike: dict[tuple[str, str], list[str]] = {}
    folders: dict[tuple[str, str], dict[str, int]] = {}
    for picture in bad:
        why = picture["problem"], picture["fix"]
        if folder := picture["folder"]:
            counts = folders.setdefault(why, {})
            counts[folder] = counts.get(folder, 0) + 1
        else:
            alike.setdefault(why, []).append(picture["picture"])
    for why, names in alike.items():
        if len(names) > _ALIKE:
            rows.append([f"{_first(names)}: {counted(len(names), 'picture')}", *why])
        else:
            rows += [[name, *why] for name in names]
    for why, counts in folders.items():
        named = listed([f"{folder}/" for folder in counts], _NAMED)
        many = counted(sum(counts.values()), "picture")
        rows.append([f"{named} ({many})", *why])
    return rows


def _parts(checked: dict[str, Any]) -> list[Any]:
    """Return what people are to know: sentences, and tables as `table` takes them."""
    name, bad, objects = checked["touches"], checked["bad"], checked["objects"]
    many = f"{counted(checked['n_touches'])} of {checked['size']}"
    many += " (rows x columns)" * bool(bad)  # pictures: width x height
    parts: list[Any] = [f"{name}: {many} can be used."]
    if checked["problem"]:
        none = f"{name}: nothing can be learnt from it as it is."
        parts = [none, checked["problem"]]
    if checked["read_as"]:
        parts.append(f"{checked['read_as'].capitalize()}.")
    if bad:
        title = f"{counted(len(bad), 'picture')} cannot be used"
        columns = ["picture", "what is wrong", "to do"]
        parts.append((title, columns, _rows(bad), (), True))
    parts += [f"Note: {note}." for note in checked["notes"]]
    if objects:
        columns = [key for key in objects[0] if objects[0][key] is not None]
        rows = [[str(row[key]) for key in columns] for row in objects[:_ROWS_SHOWN]]
        parts.append((counted(len(objects), "object"), columns, rows))
        if len(objects) > _ROWS_SHOWN:
            parts.append(f"and {len(objects) - _ROWS_SHOWN} more")
    for name, control in checked["alone"].items():
        parts.append(
            f"{name} alone would name {100 * control['right']:.1f} % of each object's "
            f"last touches right (chance {100 * control['chance']:.1f} %)."
        )
    return parts + [f"- {what[0].upper()}{what[1:]}." for what in checked["advice"]]


def _page(checked: dict[str, Any], touches: "Touches | None") -> str:
    from .._page import html_table, report_page, worded

    title, *parts = _parts(checked)
    sections = [_STYLE, f"<h1>{escape(title)}</h1>"]
    for part in parts:
        is_text = isinstance(part, str)
        sections.append(f"<p>{worded(part)}" if is_text else html_table(*part[:3]))
    if touches is not None and touches.object is not None:
        sections.append(_sheet(touches, checked))
    return report_page(title, sections)


def _sheet(touches: "Touches", checked: dict[str, Any]) -> str:
    """Return touches of each object, evenly out of its recording, as HTML.

    Each has the name of its file, and what is odd about it.
    """
    import numpy as np

    from .._numbers import evenly_spaced
    from .._page import as_shown, png_address

    objects, odd = checked["objects"], _odd_words(checked["odd"])
    names = touches.columns.get("source_path", np.full(len(touches), ""))
    parts = ["<h2>Touches of each object, evenly out of its recording</h2>"]
    if checked["bad"]:
        parts.append("<p class=note>Pictures that cannot be used are not shown.</p>")
    for entry in objects[:SHEET_OBJECTS]:
        rows = np.flatnonzero(touches.object == entry["object"])
        rows = rows[evenly_spaced(len(rows), SHEET_TOUCHES)]
        pictures = "".join(
            _sheet_picture(png_address(image, SHEET_SIDE), int(row), name, odd)
            for row, name, image in zip(
                rows,
                names[rows].astype(str),
                as_shown(touches.images[rows], touches.channels),
                strict=True,
            )
        )
        many = counted(entry["touches"])
        parts.append(
            f"<p>{escape(entry['object'])}: {many}</p><div class=sheet>{pictures}</div>"
        )
    if len(objects) > SHEET_OBJECTS:
        parts.append(f"<p>and {len(objects) - SHEET_OBJECTS} more objects</p>")
    return "".join(parts)


def _sheet_picture(address: str, row: int, name: str, odd: dict[str, str]) -> str:
    """Return a touch of the sheet above the name of its file and what is odd."""
    image = f"<img alt='touch {row}' title='{escape(name)}' src='{address}'>"
    words = [name.rpartition("/")[2], odd.get(name, "")]
    return f"<div>{image}{'<br>'.join(escape(word) for word in words if word)}</div>"


def _odd_words(odd: dict[str, list[Any]]) -> dict[str, str]:
    """Return in a few words what is odd about pictures, by name."""
    words: dict[str, list[str]] = {}
    for kind, names in odd.items():
        for name in names:
            picture = name[0] if kind == "copies" else name
            words.setdefault(picture, []).append(_ODD[kind][0])
    return {name: ", ".join(each) for name, each in words.items()}
