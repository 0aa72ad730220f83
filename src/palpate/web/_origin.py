"""What a model remembers of the sensor whose touches of a library it learnt."""

from collections.abc import Iterator
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


def remember_library(
    model: ObjectRecogniser, folder: str | Path, where: str | None
) -> None:
    """Keep in a model what the sensor was like whose touches it learnt.

    `where` is the filter of those touches in the library `folder`.
    """
    with TouchLibrary.open(folder) as library:
        remember_sensor(model, library, library.select(where))


def remember_sensor(
    model: ObjectRecogniser, library: TouchLibrary, touches: Selection
) -> None:
    """Keep what the sensor of these touches was like, where its zero is known."""
    zero = _latest_zero(library, touches)
    if zero is None:
        return
    rows = np.unique(np.linspace(0, len(touches) - 1, _ENOUGH).round().astype(int))
    memory = SensorMemory.of(_images(touches, rows), zero)
    model.remember_sensor(memory.to_dict())


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
