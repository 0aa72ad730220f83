"""Recorded touches as a sensor: a folder or an archive, at a chosen rate."""

from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..touches import Touches, TouchesError
from ._contract import SensorError
from ._played import PlayedSensor

UNLABELLED = "recording"
_ARRAY_SIDE = 48


class ReplaySensor(PlayedSensor):
    """Plays recorded touches as if somebody touched things on the desk.

    Parameters
    ----------
    touches : Touches or path
        The recording: touches, an archive (`.npz`) or a folder of pictures.
    rate_hz : float, default=25
        Frames per second.
    hold, gap : int, default=8, 8
        Frames that each touch is held, and frames of nothing between two; 1 and 0
        play the pictures as they are, one after the other.
    no_contact : ndarray or path, optional
        The frame of touching nothing, where the recording has none. A pressure
        array (at most 48 taxels a side) is taken to read 0 then; other recordings
        are played without frames of nothing.
    name_pattern : str, optional
        For folders: see `Touches.load`.

    Attributes
    ----------
    objects : tuple of str
        What was recorded; `place` chooses among them. Every object's touches are
        played in the order of the recording, and again from the first when they
        are over; an object that is put back goes on where it was.

    Raises
    ------
    SensorError
        The recording cannot be read.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate import Touches
    >>> from palpate.sensors import ReplaySensor
    >>> recorded = Touches(np.ones((3, 4, 4)), object=["cup"] * 3)
    >>> with ReplaySensor(recorded, rate_hz=1000, hold=1, gap=1) as sensor:
    ...     [float(sensor.read_next().image.max()) for _ in range(4)]
    [0.0, 1.0, 0.0, 1.0]
    """

    def __init__(
        self,
        touches: Touches | str | PathLike[str],
        *,
        rate_hz: float = 25.0,
        hold: int = 8,
        gap: int = 8,
        no_contact: NDArray[Any] | str | PathLike[str] | None = None,
        name_pattern: str | None = None,
    ) -> None:
        recorded, source = _recorded(touches, no_contact, name_pattern)
        labels = recorded.object
        if labels is None:
            labels = np.full(len(recorded), UNLABELLED)
        self._images = recorded.images
        self._rows = {str(n): np.flatnonzero(labels == n) for n in np.unique(labels)}
        self._at = dict.fromkeys(self._rows, 0)
        self._no_contact = _rest_frame(recorded)
        super().__init__(
            f"replay of {source}",
            "grey level" if recorded.images.dtype.kind == "u" else "as recorded",
            recorded.images.shape[1:],
            recorded.images.dtype,
            recorded.geometry,
            objects=[str(name) for name in dict.fromkeys(labels.tolist())],
            rate_hz=rate_hz,
            hold=hold,
            gap=gap,
        )

    def no_contact(self) -> NDArray[Any] | None:
        """Return the frame of touching nothing, or None where it is not known."""
        return self._no_contact

    def _next_touch(self, name: str) -> NDArray[Any]:
        rows = self._rows[name]
        touch: NDArray[Any] = self._images[rows[self._at[name] % len(rows)]]
        self._at[name] += 1
        return touch


def _recorded(
    touches: Touches | str | PathLike[str],
    no_contact: NDArray[Any] | str | PathLike[str] | None,
    name_pattern: str | None,
) -> tuple[Touches, str]:
    """Return the recording and what to call it."""
    frame = no_contact if isinstance(no_contact, np.ndarray) else None
    try:
        if isinstance(touches, Touches):
            recorded, source = touches, "touches"
        else:
            path = None if isinstance(no_contact, np.ndarray) else no_contact
            recorded = Touches.load(touches, name_pattern=name_pattern, no_contact=path)
            source = str(touches)
        if frame is not None:
            recorded = recorded.with_columns(no_contact=frame)
    except TouchesError as error:
        raise SensorError(f"The recording cannot be replayed: {error}") from error
    return recorded, source


def _rest_frame(recorded: Touches) -> NDArray[Any] | None:
    if recorded.no_contact is not None:
        return recorded.no_contact.astype(recorded.images.dtype)
    shape = recorded.images.shape[1:]
    if max(shape) > _ARRAY_SIDE:
        return None
    return np.zeros(shape, dtype=recorded.images.dtype)
