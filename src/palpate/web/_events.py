"""What listeners of a live session are sent, and how fast frames and touches go.

Events are sent from whatever thread they happen in.
"""

import json
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from threading import Lock
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

    @cached_property
    def text(self) -> str:
        """Kind and values as JSON, written once for all who are sent it."""
        return json.dumps({"kind": self.kind, **self.values}, default=str)


Listener = Callable[[Event], None]


class Listeners:
    """Functions that are called with every event; one that fails is removed."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._all: tuple[Listener, ...] = ()

    def __len__(self) -> int:
        return len(self._all)

    def add(self, listener: Listener) -> None:
        """Call this one too."""
        with self._lock:
            self._all = (*self._all, listener)

    def discard(self, listener: Listener) -> None:
        """Call this one no more."""
        with self._lock:
            self._all = tuple(one for one in self._all if one != listener)

    def notify(self, event: Event) -> None:
        """Call all with an event, in the thread in which it happened."""
        for listener in self._all:
            try:
                listener(event)
            except Exception:  # one broken listener must not stop the sensor
                self.discard(listener)


class Health:
    """Rates and latencies over the last hundred frames and touches.

    `sensor` is where frames come from, if any; it counts those that were dropped.
    """

    def __init__(self, sensor: LiveSensor | None) -> None:
        self._sensor, self._lock = sensor, Lock()
        self._frames_s: deque[float] = deque(maxlen=_KEPT)
        self._shown_ms: deque[float] = deque(maxlen=_KEPT)
        self._touch_ms: deque[float] = deque(maxlen=_KEPT)
        self._n_frames = 0

    def count_frame(self, taken_s: float) -> None:
        """Count a frame taken at a time on the monotonic clock (seconds)."""
        with self._lock:
            self._frames_s.append(taken_s)
            self._n_frames += 1

    def count_shown(self, taken_s: float) -> None:
        """Count a frame that is on its way to the page now."""
        with self._lock:
            self._shown_ms.append(1e3 * (time.monotonic() - taken_s))

    def count_touch(self, latency_ms: float) -> None:
        """Count a touch that has moved the belief."""
        with self._lock:
            self._touch_ms.append(latency_ms)

    def to_dict(self) -> dict[str, Any]:
        """Return frame rate (Hz), counts, median latencies (ms, None before any)."""
        with self._lock:
            times, n_frames = list(self._frames_s), self._n_frames
            shown, touched = _median(self._shown_ms), _median(self._touch_ms)
        recent = len(times) > 1 and time.monotonic() - times[-1] < 2
        span_s = times[-1] - times[0] if recent else 0.0
        return {
            "rate_hz": (len(times) - 1) / span_s if span_s else 0.0,
            "n_frames": n_frames,
            "n_dropped": 0 if self._sensor is None else self._sensor.n_dropped,
            "frame_ms": shown,
            "belief_ms": touched,
        }


def _median(values: deque[float]) -> float | None:
    return float(np.median(values)) if values else None
