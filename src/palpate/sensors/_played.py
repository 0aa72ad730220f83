"""Sensors that play touches: pictures of touches made into a stream of frames.

Something lies on the desk and is touched again and again: some frames of nothing,
the way in, the touch held, the way out.
"""

import threading
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .._checks import check_count, check_option, check_positive
from ._streaming import StreamingSensor

Image = NDArray[Any]
_LONGEST_WAIT_S = 0.2


class PlayedSensor(StreamingSensor):
    """Base of sensors that play touches of what is placed on the desk.

    Parameters
    ----------
    name, unit, image_shape, dtype, geometry
        See `StreamingSensor`.
    objects : sequence of str
        What can be placed.
    rate_hz : float
        Frames per second.
    hold, gap, ramp : int
        Frames that a touch is held, frames of nothing between two touches, and
        frames of the way in (and as many of the way out).
    """

    queue_length = 256

    def __init__(
        self,
        name: str,
        unit: str,
        image_shape: tuple[int, int],
        dtype: DTypeLike,
        geometry: str | None,
        *,
        objects: Sequence[str],
        rate_hz: float,
        hold: int,
        gap: int,
        ramp: int = 0,
    ) -> None:
        super().__init__(name, unit, image_shape, dtype, geometry)
        self.objects = tuple(objects)
        self.rate_hz = check_positive("rate_hz", rate_hz)
        self._hold = check_count("hold", hold)
        self._gap = check_count("gap", gap, at_least=0)
        self._ramp = check_count("ramp", ramp, at_least=0)
        self._placed: str | None = self.objects[0] if self.objects else None
        self._frames: deque[Image] = deque()
        self._lock = threading.Lock()
        self._due_s = 0.0

    @property
    def placed(self) -> str | None:
        """What lies on the desk; None for nothing."""
        return self._placed

    def place(self, name: str | None) -> None:
        """Put something else on the desk, or nothing; the touch under way ends.

        Raises
        ------
        ValueError
            It is not one of `objects`.
        """
        if name is not None:
            check_option("name", name, self.objects)
        with self._lock:
            self._placed = name
            self._frames.clear()
            rest = self.no_contact()
            if rest is not None:
                self._frames.extend([rest] * max(self._gap, 2))

    @abstractmethod
    def _next_touch(self, name: str) -> Image | None:
        """Return the next touch of an object, or None while it is being made."""

    def _with_noise(self, image: Image) -> Image:
        """Return a frame as the sensor would give it."""
        return image

    def _open(self) -> None:
        self._due_s = time.monotonic()

    def _close(self) -> None:
        pass

    def _grab(self) -> list[Image]:
        self._due_s += 1 / self.rate_hz
        late_s = time.monotonic() - self._due_s
        if late_s > 1.0:  # the machine slept: go on from now, at the same rate
            self._due_s += late_s
        while (left_s := self._due_s - time.monotonic()) > 0:
            if self._stop.wait(min(left_s, _LONGEST_WAIT_S)):
                return []
        with self._lock:
            if not self._frames:
                self._frames.extend(self._cycle())
            image = self._frames.popleft() if self._frames else self._rest()
        return [] if image is None else [self._with_noise(image)]

    def _rest(self) -> Image | None:
        return self.no_contact()

    def _cycle(self) -> list[Image]:
        """Return the frames of one touch, from nothing to nothing."""
        touch = None if self._placed is None else self._next_touch(self._placed)
        if touch is None:
            return []
        rest = self.no_contact()
        if rest is None:
            return [touch] * self._hold
        shares = np.arange(1, self._ramp + 1) / (self._ramp + 1)
        way_in = [self._between(rest, touch, float(share)) for share in shares]
        held = [touch] * self._hold
        return [rest] * self._gap + way_in + held + way_in[::-1]

    def _between(self, rest: Image, touch: Image, share: float) -> Image:
        """Return a picture of part of the way in; a blend, not physics."""
        blend = rest + share * (touch.astype(np.float64) - rest)
        if self.dtype.kind in "iu":
            blend = np.rint(blend)
        return blend.astype(self.dtype)
