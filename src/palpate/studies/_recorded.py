"""The recorded touches of a study, or why there are none; and their labels."""

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..touches import Touches


def recorded_touches(
    data: str | Path | None, archive: Path, what: str, source: str
) -> Touches | str:
    """Return the touches of an archive, or the sentence that says what is left out.

    Parameters
    ----------
    data : path or None
        Folder of recorded touches; by default the one that PALPATE_DATA names.
    archive : Path
        The archive's place in it.
    what : str
        What the touches are called, "real presses".
    source : str
        Where they are published.

    Raises
    ------
    ValueError
        When `data` is given and the archive is not in it.
    """
    named = data if data is not None else os.environ.get("PALPATE_DATA")
    if not named:
        return (
            f"The rows of {what} ({archive.stem}) are left out: name their "
            "folder with --data or PALPATE_DATA."
        )
    path = Path(named) / archive
    if path.is_file():
        return Touches.load(path)
    if data is not None:
        raise ValueError(
            f"--data must name a folder that holds {archive}, got {named}. "
            f"Fetch the recordings from {source}, or leave --data out."
        )
    return (
        f"The rows of {what} are left out: the folder of PALPATE_DATA has no {archive}."
    )


def labels(touches: Touches) -> NDArray[np.str_]:
    """Return the object of every touch; refuse touches without."""
    if touches.object is None:
        raise ValueError(
            f"The touches must have a column 'object', got {touches!r}. Label them."
        )
    return touches.object
