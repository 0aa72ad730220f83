"""The touches of a study: recorded ones, or why there are none; and their labels."""

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..touches import Touches

Codes = NDArray[np.intp]


class Archive(NamedTuple):
    """Recorded touches: their place in the folder, what they are, where published."""

    place: Path
    what: str
    source: str


BATHTIP = Archive(
    Path("bathtip") / "bathtip50.npz",
    "a real dome camera",
    "github.com/Exhor/deep_visuotactile_classification",
)


def recorded_touches(data: str | Path | None, archive: Archive) -> Touches | str:
    """Return the touches of an archive, or the sentence that says what is left out.

    They are in `data`, by default the folder of PALPATE_DATA; a ValueError says that a
    folder given by name does not hold them.
    """
    place, what, source = archive
    named = data if data is not None else os.environ.get("PALPATE_DATA")
    if not named:
        return (
            f"The rows of {what} ({place.stem}) are left out: name their "
            "folder with --data or PALPATE_DATA."
        )
    path = Path(named) / place
    if path.is_file():
        return Touches.load(path)
    if data is not None:
        raise ValueError(
            f"--data must name a folder that holds {place}, got {named}. "
            f"Fetch the recordings from {source}, or leave --data out."
        )
    return (
        f"The rows of {what} are left out: the folder of PALPATE_DATA has no {place}."
    )


def labels(touches: Touches, column: str = "object") -> NDArray[np.str_]:
    """Return the object, or category, of every touch; refuse touches without."""
    found: NDArray[np.str_] | None = getattr(touches, column)
    if found is None:
        raise ValueError(
            f"The touches must have a column {column!r}, got {touches!r}. Label them."
        )
    return found


def coded(touches: Touches, column: str = "object") -> Codes:
    """Return labels as numbers, in the order of their names, shape (n_touches,)."""
    codes: Codes = np.unique(labels(touches, column), return_inverse=True)[1]
    return codes
