"""What drivers share: a capture thread, a queue of frames, and finding a lost device.

A driver says how to open its device, how to wait a moment for frames and how to
close it again; everything that the contract promises is kept here.
"""

import threading
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .._checks import check_count
from ._contract import Frame, LiveSensor, SensorError


class StreamingSensor(LiveSensor):
    """Base of drivers; a driver writes `_open`, `_grab` and `_close`.

    Parameters
    ----------
    name, unit : str
        See `LiveSensor`.
    image_shape : (int, int)
        (n_rows, n_cols) of every frame.
    dtype : dtype
        Type of every frame.
    geometry : str, optional
        How taxels lie.

    Notes
    -----
    A frame that nobody has read when `queue_length` newer ones wait is dropped and
    counted. When the device fails, it is opened again every `retry_s` seconds until
    it is back or the sensor is disconnected.
    """

    queue_length: ClassVar[int] = 2
    retry_s: float = 0.5

    def __init__(
        self,
        name: str,
        unit: str,
        image_shape: tuple[int, int],
        dtype: DTypeLike,
        geometry: str | None = None,
    ) -> None:
        n_rows, n_cols = image_shape
        self.name, self.unit = name, unit
        self._shape = check_count("n_rows", n_rows), check_count("n_cols", n_cols)
        self.dtype = np.dtype(dtype)
        self._geometry = geometry
        self._queue: deque[Frame] = deque()
        self._arrived = threading.Condition()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._latest: Frame | None = None
        self._lost, self._n_frames, self._n_dropped, self._number = "", 0, 0, 0

    @property
    def image_shape(self) -> tuple[int, int]:
        """(n_rows, n_cols) of every frame."""
        return self._shape

    @property
    def geometry(self) -> str | None:
        """How taxels lie, see `Touches`."""
        return self._geometry

    @property
    def connected(self) -> bool:
        """Whether it runs; True also while a lost device is looked for."""
        return self._thread is not None

    @property
    def lost(self) -> str:
        """Why no frames come at present; empty while they do."""
        return self._lost

    @property
    def n_frames(self) -> int:
        """Frames taken since it was connected."""
        return self._n_frames

    @property
    def n_dropped(self) -> int:
        """Frames lost since it was connected."""
        return self._n_dropped

    def no_contact(self) -> NDArray[Any] | None:
        """Return the frame of touching nothing, or None where it is not known."""
        return None

    def connect(self) -> Self:
        """Open the device and start the capture thread."""
        if self._thread is not None:
            return self
        self._queue.clear()
        self._latest, self._lost = None, ""
        self._n_frames = self._n_dropped = self._number = 0
        self._stop.clear()
        self._open()
        self._thread = threading.Thread(
            target=self._run, name=f"palpate {self.name}", daemon=True
        )
        self._thread.start()
        return self

    def disconnect(self) -> None:
        """Stop the capture thread and close the device."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._stop.set()
        with self._arrived:
            self._arrived.notify_all()
        thread.join(timeout=5.0)
        self._close()

    def read_next(self, timeout_s: float = 2.0) -> Frame:
        """Return the oldest frame not returned yet, waiting for it."""
        with self._arrived:
            self._wait(lambda: bool(self._queue), timeout_s)
            return self._queue.popleft()

    def read_latest(self, timeout_s: float = 2.0) -> Frame:
        """Return the newest frame, waiting only for the very first."""
        with self._arrived:
            self._wait(lambda: self._latest is not None, timeout_s)
            assert self._latest is not None
            if time.monotonic() - self._latest.time_s > timeout_s:
                raise self._silent(timeout_s)
            return self._latest

    @abstractmethod
    def _open(self) -> None:
        """Open the device, or raise `SensorError` with the fix."""

    @abstractmethod
    def _grab(self) -> Sequence[NDArray[Any]]:
        """Wait a moment, return the frames that came; raise where the device is gone.

        Must return at least every half second, if with nothing.
        """

    @abstractmethod
    def _close(self) -> None:
        """Free the device; must bear being called twice."""

    def _count_missed(self, n_missed: int) -> None:
        """Count frames that the device took but that never came through."""
        self._n_dropped += n_missed
        self._number += n_missed

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                for image in self._grab():
                    self._put(image)
            except Exception as error:  # a driver's bug must not end the stream unseen
                self._recover(error)

    def _recover(self, error: Exception) -> None:
        """Try to open the device again until it is back."""
        self._lost = _in_words(error)
        self._free()
        while not self._stop.wait(self.retry_s):
            try:
                self._open()
            except Exception as still:  # as in `_run`: whatever it is, try again
                self._lost = _in_words(still)
                self._free()
            else:
                self._lost = ""
                return

    def _free(self) -> None:
        """Close a device that failed; that it cannot even be closed is no news."""
        with suppress(Exception):
            self._close()

    def _put(self, image: NDArray[Any]) -> None:
        taken_s = time.monotonic()
        kept = np.ascontiguousarray(image, dtype=self.dtype)
        if kept.shape != self._shape:
            self._count_missed(1)
            return
        kept.flags.writeable = False
        with self._arrived:
            self._latest = Frame(kept, taken_s, self._number)
            self._number += 1
            self._n_frames += 1
            if len(self._queue) >= self.queue_length:
                self._queue.popleft()
                self._n_dropped += 1
            self._queue.append(self._latest)
            self._arrived.notify_all()

    def _wait(self, ready: Any, timeout_s: float) -> None:
        if self._thread is None:
            raise SensorError(f"{self.name} is not connected; call connect() first.")
        self._arrived.wait_for(lambda: ready() or self._stop.is_set(), timeout_s)
        if not ready():
            raise self._silent(timeout_s)

    def _silent(self, timeout_s: float) -> SensorError:
        if self._thread is None:
            return SensorError(f"{self.name} was disconnected.")
        if self._lost:
            return SensorError(f"{self.name} is lost: {self._lost}")
        return SensorError(
            f"{self.name} gave no frame in {timeout_s:g} s. "
            "Check its cable and that it is switched on."
        )


def _in_words(error: Exception) -> str:
    return str(error) if isinstance(error, SensorError) else repr(error)
