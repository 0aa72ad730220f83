"""What a model remembers of where it comes from: touches of a library, a sensor.

`touch_ids_` of a model holds the library's id of every touch it learnt, empty for
those of no library; `sensor_` is a `SensorMemory` as plain values.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..library import LibraryError, Selection, TouchLibrary
from ..recognition import ObjectRecogniser
from ..sensors import SensorMemory

# So many touches, spread over all, tell what a sensor answers.
_ENOUGH = 200
_AT_ONCE = 16
_TRIES = 5


def chosen_touches(
    library: TouchLibrary, where: str | None
) -> tuple[Selection, list[str]]:
    """Return touches of a library and their ids, in one order.

    Raises
    ------
    LibraryError
        None is found, they differ in size, or some are left out again and again
        while they are looked for.
    """
    for _ in range(_TRIES):
        before = [row.id for row in library.list(where, limit=None)]
        chosen = library.select(where)
        after = [row.id for row in library.list(where, limit=None)]
        if after[: len(before)] == before:  # some may have been added, none left out
            return chosen, after[: len(chosen)]
    raise LibraryError(
        "The touches of the library must stay while they are read, but some are left "
        "out or renamed again and again. Wait until that is over."
    )


def touch_ids(model: ObjectRecogniser) -> dict[str, list[str]]:
    """Return the ids of the touches that a model learnt, by label; empty: unknown."""
    labels = model.labels_
    ids = getattr(model, "touch_ids_", np.empty(0, "U1"))
    if len(ids) != len(labels):
        ids = np.full(len(labels), "", dtype="U1")
    return {
        str(name): [str(key) for key in ids[labels == name]] for name in model.classes_
    }


def set_touch_ids(model: ObjectRecogniser, ids: Mapping[str, Sequence[str]]) -> None:
    """Keep the ids of the touches of each label, in the order they were learnt in."""
    labels = model.labels_
    kept = np.full(len(labels), "", dtype="U32")
    for name in model.classes_:
        known = ids.get(str(name), ())
        if len(known) == int((labels == name).sum()):
            kept[labels == name] = known
    model.touch_ids_ = kept


def remember_library(
    model: ObjectRecogniser,
    folder: str | Path,
    where: str | None,
    *,
    before: Mapping[str, Sequence[str]] | None = None,
    raw: bool = True,
) -> None:
    """Keep in a model which touches of a library it learnt, and their sensor.

    Parameters
    ----------
    model : ObjectRecogniser
        Fitted on `TouchLibrary.select(where)`, or extended by its new objects.
    folder : path
        The library.
    where : str or None
        The filter of the touches it learnt.
    before : mapping, optional
        `touch_ids` of a model before it was extended; what it remembers of its sensor
        stays.
    raw : bool, default=True
        Whether it learnt images as the sensor gave them; else no sensor is kept.
    """
    with TouchLibrary.open(folder) as library:
        chosen, ids = chosen_touches(library, where)
        labels = chosen.object if model.label == "object" else chosen.category
        keys = np.array(ids)
        found = {
            str(n): keys[labels == n].tolist() for n in np.unique(np.asarray(labels))
        }
        set_touch_ids(model, {**found, **(before or {})})
        if raw and before is None:
            remember_sensor(model, library, chosen)


def remember_sensor(
    model: ObjectRecogniser, library: TouchLibrary, touches: Selection
) -> None:
    """Keep what the sensor of these touches was like, where its zero is known."""
    zero = _latest_zero(library, touches)
    if zero is None:
        return
    rows = np.unique(np.linspace(0, len(touches) - 1, _ENOUGH).round().astype(int))
    memory = SensorMemory.of(_images(touches, rows), zero)
    model.sensor_ = memory.to_dict()


def _latest_zero(library: TouchLibrary, touches: Selection) -> NDArray[Any] | None:
    """Return the newest no-contact image that has the size of these touches."""
    shape = touches.touches([len(touches) - 1]).images.shape[1:]
    sessions: list[Any] = [None]
    if touches.session is not None:
        named = [s for s in touches.session.tolist()[::-1] if s not in ("", None)]
        sessions = [*dict.fromkeys(named)] or sessions
    for session in sessions:
        try:
            zero = library.no_contact(session)
        except LibraryError:  # damaged: `palpate library check` tells of it
            continue
        if zero is not None and zero.shape == shape:
            return zero
    return None


def _images(touches: Selection, rows: NDArray[np.intp]) -> Iterator[NDArray[Any]]:
    """Read images in pieces, so that few are in memory at once."""
    for start in range(0, len(rows), _AT_ONCE):
        yield from touches.touches(rows[start : start + _AT_ONCE]).images
