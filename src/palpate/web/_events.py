"""What listeners of a live session are sent, and how fast frames and touches go.

Events are sent from whatever thread they happen in.
"""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..sensors import LiveSensor

_KEPT = 100


@dataclass(frozen=True, eq=False)
class Event:
    """Something that happened: a kind, plain values, and the bytes of a picture.

    Kinds: "frame", "contact", "touch", "state".
    """

    kind: str
    values: dict[str, Any] = field(default_factory=dict)
    picture: bytes = b""


Listener = Callable[[Event], None]


class Listeners(set[Listener]):
    """Functions that are called with every event; one that fails is removed."""

    def notify(self, event: Event) -> None:
        """Call all with an event, in the thread in which it happened."""
        for listener in tuple(self):
            try:
                listener(event)
            except Exception:  # one broken listener must not stop the sensor
                self.discard(listener)


class Health:
    """Rates and latencies over the last hundred frames and touches.

    Parameters
    ----------
    sensor : LiveSensor or None
        What the frames come from; it counts those that were dropped.
    """

    def __init__(self, sensor: LiveSensor | None) -> None:
        self._sensor = sensor
        self._frames_s: deque[float] = deque(maxlen=_KEPT)
        self._shown_ms: deque[float] = deque(maxlen=_KEPT)
        self._touch_ms: deque[float] = deque(maxlen=_KEPT)
        self._n_frames = 0

    def count_frame(self, taken_s: float) -> None:
        """Count a frame taken at a time on the monotonic clock (seconds)."""
        self._frames_s.append(taken_s)
        self._n_frames += 1

    def count_shown(self, taken_s: float) -> None:
        """Count a frame that is on its way to the page now."""
        self._shown_ms.append(1e3 * (time.monotonic() - taken_s))

    def count_touch(self, latency_ms: float) -> None:
        """Count a touch that has moved the belief."""
        self._touch_ms.append(latency_ms)

    def to_dict(self) -> dict[str, Any]:
        """Return frame rate (Hz), counts, median latencies (ms, None before any)."""
        times = list(self._frames_s)
        recent = len(times) > 1 and time.monotonic() - times[-1] < 2
        span_s = times[-1] - times[0] if recent else 0.0
        return {
            "rate_hz": (len(times) - 1) / span_s if span_s else 0.0,
            "n_frames": self._n_frames,
            "n_dropped": 0 if self._sensor is None else self._sensor.n_dropped,
            "frame_ms": _median(self._shown_ms),
            "belief_ms": _median(self._touch_ms),
        }


def _median(values: deque[float]) -> float | None:
    return float(np.median(list(values))) if values else None
