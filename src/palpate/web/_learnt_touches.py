"""What a model remembers of the touches it learnt: their ids, sensor and features.

`touch_ids_` of a model holds the library's id of every touch it learnt, empty for
those of no library; `sensor_` is a `SensorMemory` as plain values.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._types import Array, Floats
from ..library import LibraryError, Selection, TouchLibrary
from ..recognition import ObjectRecogniser
from ..sensors import SensorMemory

# So many touches, spread over all, tell what a sensor answers.
_ENOUGH = 200
_AT_ONCE = 16
_TRIES = 5
_SHOWN = 6


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
    """Keep what the sensor of these touches was like, where its baseline is known."""
    baseline = _latest_baseline(library, touches)
    if baseline is None:
        return
    rows = np.unique(np.linspace(0, len(touches) - 1, _ENOUGH).round().astype(int))
    memory = SensorMemory.of(_images(touches, rows), baseline)
    model.sensor_ = memory.to_dict()


def sensor_memory(model: ObjectRecogniser | None) -> SensorMemory | None:
    """Return what a model remembers of the sensor it learnt from, None for nothing."""
    stored = getattr(model, "sensor_", None)
    return None if stored is None else SensorMemory.from_dict(stored)


class Neighbours:
    """Nearest learnt touches, each feature measured in its own spread.

    Parameters
    ----------
    recogniser : ObjectRecogniser
        Fitted; learnt from a library, it knows the ids of its touches.
    stored_ids : collection of str
        Ids of the touches in the library at hand.
    """

    def __init__(
        self, recogniser: ObjectRecogniser, stored_ids: Collection[str]
    ) -> None:
        features = recogniser.features_
        spread = features.std(axis=0)
        self._scale = np.where(spread > 0, spread, 1.0)
        self._features = features / self._scale
        self._labels = recogniser.labels_
        ids = getattr(recogniser, "touch_ids_", np.empty(0, "U1")).tolist()
        if len(ids) != len(features):
            ids = [""] * len(features)
        stored = set(stored_ids)
        self._ids = [key if key in stored else None for key in ids]

    def of(self, features: Floats) -> list[dict[str, Any]]:
        """Return the nearest touches of features (1, n_features), nearest first.

        `id` is None where the touch is not in the library.
        """
        apart = self._features - features / self._scale
        distance = np.sqrt(np.mean(apart**2, axis=1))
        some = np.argsort(distance, kind="stable")[:_SHOWN]
        return [
            {
                "id": self._ids[row],
                "object": str(self._labels[row]),
                "distance": float(distance[row]),
            }
            for row in some
        ]


def _latest_baseline(library: TouchLibrary, touches: Selection) -> Array | None:
    """Return the newest no-contact image that has the size of these touches."""
    shape = touches.touches([len(touches) - 1]).images.shape[1:]
    sessions: list[Any] = [None]
    if touches.session is not None:
        named = [s for s in touches.session.tolist()[::-1] if s not in ("", None)]
        sessions = [*dict.fromkeys(named)] or sessions
    for session in sessions:
        try:
            baseline = library.no_contact(session)
        except LibraryError:  # damaged: `palpate library check` tells of it
            continue
        if baseline is not None and baseline.shape == shape:
            return baseline
    return None


def _images(touches: Selection, rows: NDArray[np.intp]) -> Iterator[Array]:
    """Read images in pieces, so that few are in memory at once."""
    for start in range(0, len(rows), _AT_ONCE):
        yield from touches.touches(rows[start : start + _AT_ONCE]).images
