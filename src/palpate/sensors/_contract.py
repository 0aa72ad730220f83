"""The contract of a tactile sensor: what touching needs, and what a live one adds.

`TouchSensor` is all that exploration asks for: one frame, now. `LiveSensor` is the
same contract for a sensor that runs by itself: it is connected, gives frame after
frame with the time each was taken, counts what was lost, and is disconnected. Every
`LiveSensor` is a `TouchSensor`.
"""

import time
from abc import abstractmethod
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray


class SensorError(RuntimeError):
    """A sensor that is missing or busy, or a frame that did not arrive or is none."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One reading of a sensor at one time.

    Attributes
    ----------
    image : ndarray of shape (n_rows, n_cols)
        Read-only, in the sensor's unit.
    time_s : float
        When it was taken, on the clock of `time.monotonic` (seconds).
    number : int
        Its number since the sensor was connected, from 0; a gap is a frame lost.
    """

    image: NDArray[Any]
    time_s: float
    number: int


@runtime_checkable
class TouchSensor(Protocol):
    """A tactile sensor that can be asked for a frame.

    Attributes
    ----------
    image_shape : tuple of int
        (n_rows, n_cols) of every frame.
    geometry : str or None
        How its taxels lie, see `Touches`.
    """

    @property
    def image_shape(self) -> tuple[int, int]: ...

    @property
    def geometry(self) -> str | None: ...

    def read(self) -> NDArray[Any]:
        """Return a frame taken after this call, shape `image_shape`.

        Raises
        ------
        SensorError
            None arrived in the sensor's own time limit.
        """
        ...

    def no_contact(self) -> NDArray[Any] | None:
        """Return the frame of touching nothing, or None where it is not known."""
        ...


class LiveSensor(TouchSensor):
    """A tactile sensor that runs by itself once it is connected.

    Everything but frames is known before connecting. Used as a context manager it
    connects and disconnects itself.

    Attributes
    ----------
    name : str
        What it is called, for people.
    image_shape : tuple of int
        (n_rows, n_cols) of every frame.
    dtype : numpy.dtype
        Type of every frame.
    unit : str
        What its numbers count, such as "grey level" or "kPa".
    geometry : str or None
        How its taxels lie, see `Touches`.
    step : float
        The smallest difference that its numbers can show; 0 where not known.
    """

    name: str
    unit: str
    dtype: np.dtype[Any]

    @property
    def step(self) -> float:
        """The smallest difference that its numbers can show; 0 where not known."""
        return 0.0

    @property
    @abstractmethod
    def connected(self) -> bool:
        """Whether it runs; True also while it tries to find a lost device again."""

    @property
    @abstractmethod
    def lost(self) -> str:
        """Why no frames come at present, for people; empty while they do."""

    @property
    @abstractmethod
    def n_frames(self) -> int:
        """Frames taken since it was connected."""

    @property
    @abstractmethod
    def n_dropped(self) -> int:
        """Frames lost since it was connected: damaged, missed, or never read."""

    @abstractmethod
    def connect(self) -> Self:
        """Start frames; nothing happens where they run already.

        Raises
        ------
        SensorError
            The device is missing, busy, or not what was promised; says the fix.
        """

    @abstractmethod
    def disconnect(self) -> None:
        """Stop frames and free the device; nothing happens where none run."""

    @abstractmethod
    def read_next(self, timeout_s: float = 2.0) -> Frame:
        """Return the oldest frame not returned by this method yet, waiting for it.

        Raises
        ------
        SensorError
            It is not connected, or no frame arrived in `timeout_s` seconds.
        """

    @abstractmethod
    def read_latest(self, timeout_s: float = 2.0) -> Frame:
        """Return the newest frame there is, waiting only for the very first.

        Raises
        ------
        SensorError
            It is not connected, or has given no frame for `timeout_s` seconds.
        """

    def read(self) -> NDArray[Any]:
        """Return a frame taken after this call."""
        asked_s = time.monotonic()
        while True:
            frame = self.read_next()
            if frame.time_s >= asked_s:
                return frame.image

    def __enter__(self) -> Self:
        return self.connect()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.disconnect()
