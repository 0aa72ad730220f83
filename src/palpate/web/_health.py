"""How the loop is doing: frame rate, latency from a frame to what it changed."""

import time
from collections import deque
from threading import Lock
from typing import Any

import numpy as np

_KEPT = 100


class Health:
    """Rates and latencies over the last hundred frames and touches."""

    def __init__(self) -> None:
        self._lock = Lock()
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

    def told(self) -> dict[str, Any]:
        """Return the figures: Hz, counts, and medians in ms (None before any)."""
        with self._lock:
            times = list(self._frames_s)
            recent = len(times) > 1 and time.monotonic() - times[-1] < 2
            span_s = times[-1] - times[0] if recent else 0.0
            return {
                "rate_hz": (len(times) - 1) / span_s if span_s else 0.0,
                "n_frames": self._n_frames,
                "frame_ms": _median(self._shown_ms),
                "belief_ms": _median(self._touch_ms),
            }


def _median(values: deque[float]) -> float | None:
    return float(np.median(values)) if values else None
