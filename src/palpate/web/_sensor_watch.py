"""Following a sensor: its frames are shown, its touches found and handed on.

One thread follows the frames and never waits for anything else; another hands on
the touches it finds, one after the other. Listeners are sent events from whatever
thread they happen in.
"""

import json
import math
import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from .._checks import size_text
from .._types import Array, Floats
from ..recognition import ObjectRecogniser
from ..sensors import (
    DetectedTouch,
    Frame,
    LiveSensor,
    SensorError,
    SensorMemory,
    TouchDetector,
)
from ._images import FramePainter

_BASELINE_FRAMES, _BASELINE_S = 10, 0.2
_LEAST_CHANGES, _PATIENCE_S = 4, 1.0
_SHOWN_HZ = 45.0
_STATE_EVERY_S = 1.0
_RECENT, _COUNTED = 40, 100
_SILENT_S = 3.0

TakeTouch = Callable[[DetectedTouch, float], None]


@dataclass(frozen=True, eq=False)
class Event:
    """Something that happened: a kind, plain values, and the bytes of a picture.

    Kinds: "frame", "contact", "touch", "state". Of a frame and of a touch `image` is
    what was read, with its channels.
    """

    kind: str
    values: dict[str, Any] = field(default_factory=dict)
    picture: bytes = b""
    image: Array | None = None
    channels: Sequence[str] | None = None

    @cached_property
    def text(self) -> str:
        """Kind and values as JSON, written once for all who are sent it."""
        return json.dumps({"kind": self.kind, **self.values}, default=str)


Listener = Callable[[Event], None]


class Listeners:
    """Functions that are called with every event; one that fails is removed.

    Every event is told which of several sensors it is of, `number`.
    """

    def __init__(self) -> None:
        self.number = 1
        self._lock = threading.Lock()
        # Replaced and never changed: other threads go through it meanwhile.
        self._takes_frames: dict[Listener, bool] = {}

    def __len__(self) -> int:
        return len(self._takes_frames)

    @property
    def n_of_frames(self) -> int:
        """How many take frames, which cost a picture each."""
        return sum(self._takes_frames.values())

    def add(self, listener: Listener, *, frames: bool = True) -> None:
        with self._lock:
            self._takes_frames = {**self._takes_frames, listener: frames}

    def discard(self, listener: Listener) -> None:
        with self._lock:
            kept = self._takes_frames.items()
            self._takes_frames = {other: f for other, f in kept if other != listener}

    def notify(self, event: Event) -> None:
        event.values["sensor_number"] = self.number
        for listener, takes_frames in self._takes_frames.items():
            if event.kind == "frame" and not takes_frames:
                continue
            try:
                listener(event)
            except Exception as error:  # one broken listener must not stop the sensor
                self.discard(listener)
                print(f"A listener is left out after {error!r}.", file=sys.stderr)


class Health:
    """Rates and latencies over the last hundred frames and touches.

    `sensor` is where frames come from, if any; it counts those that were dropped.
    """

    def __init__(self, sensor: LiveSensor | None) -> None:
        self._sensor, self._lock = sensor, threading.Lock()
        self._frames_s: deque[float] = deque(maxlen=_COUNTED)
        self._shown_ms: deque[float] = deque(maxlen=_COUNTED)
        self._touch_ms: deque[float] = deque(maxlen=_COUNTED)
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


class SensorWatch:
    """Follows a sensor from `start` to `stop`.

    `take` is called with the image of each touch and the time its last frame was
    taken (`time.monotonic`), in a thread of its own; `listeners` are sent frames
    ("frame") and what the sensor is like ("contact"). `misfit` says why the model
    cannot recognise touches of this sensor; it is empty where it can. `address` tells
    it from others of the same name, where there are several.
    """

    def __init__(
        self,
        sensor: LiveSensor,
        take: TakeTouch,
        listeners: Listeners,
        health: Health,
        summary: str,
    ) -> None:
        self.sensor = sensor
        self.detector = TouchDetector(sensor.no_contact(), summary=summary)
        self._take, self._listeners, self._health = take, listeners, health
        self._memory: SensorMemory | None = None
        self.misfit = self.failed = self.address = ""
        self._recent: list[Array] = []
        self._warnings: list[str] = []
        self._resting: list[Array] | None = None
        self._asking, self._n_presses = False, 0
        self.press: Array | None = None
        self._lock, self._taking = threading.Lock(), threading.Lock()
        self._stop = threading.Event()
        self._detected: queue.Queue[tuple[DetectedTouch, float] | None] = queue.Queue()
        self._threads: list[threading.Thread] = []
        self._heard_s = math.inf

    @cached_property
    def _painter(self) -> FramePainter:
        """Made for the first frame: until it is connected a sensor may have no size."""
        of_array = self.sensor.geometry == "array"
        return FramePainter(self.sensor.image_shape, self.sensor.channels, of_array)

    def start(self) -> None:
        """Connect the sensor and follow it; nothing happens where that is done."""
        if self._threads:
            return
        self.sensor.connect()
        self.failed, self._heard_s = "", time.monotonic()
        for work in (self._follow, self._hand_on):
            thread = threading.Thread(target=work, daemon=True)
            self._threads.append(thread)
            thread.start()

    def stop(self) -> None:
        self._stop.set()
        self._detected.put(None)
        self.sensor.disconnect()
        for thread in self._threads:
            thread.join(timeout=5.0)

    def take_baseline(
        self,
        *,
        force: bool = False,
        ask_press: bool = False,
        timeout_s: float = _SILENT_S,
    ) -> None:
        """Take the baseline, the frame of touching nothing, from the next frames.

        Waits at most `timeout_s` (seconds) for each of them.
        With `ask_press` touches are then only tried, the last one is `press`, until
        `end_press` or `undo_baseline`.
        """
        frames: list[Array] = []
        if self.detector.touching and not force:
            latest = self.sensor.read_latest().image
            with self._lock:
                if self.detector.touching:  # still: is refused with the reason
                    self.detector.take_baseline([latest] * _BASELINE_FRAMES)
        with self._taking:  # one after the other
            self._resting = frames
            n_frames, began_s = 0, time.monotonic()
            now_s, deadline = began_s, began_s + timeout_s
            while not _is_baseline(frames, now_s - began_s) and now_s < deadline:
                time.sleep(0.01)
                now_s = time.monotonic()
                if len(frames) > n_frames:
                    n_frames, deadline = len(frames), now_s + timeout_s
            self._resting = None
        if len(frames) < _BASELINE_FRAMES:
            why = self.sensor.lost or "Check that it is switched on."
            raise SensorError(
                f"{self.sensor.name} gave too few frames for a baseline: "
                f"{len(frames)} of {_BASELINE_FRAMES}, then none for {timeout_s:g} s. "
                f"{why}"
            )
        with self._lock:
            self.detector.step = self.sensor.step
            self.detector.take_baseline(frames, force=force)
            self._recent, self.press = [], None
            self._asking = ask_press
        self._compare()

    def undo_baseline(self) -> None:
        """Go back to the baseline before, none where there was none."""
        with self._lock:
            self.detector.undo_baseline()
        self.end_press()
        self._compare()

    def end_press(self) -> None:
        """Take touches as they are meant again."""
        self._asking, self.press = False, None

    def press_difference(self) -> Floats:
        """Return how the test press differs from the baseline, upwards, or explain."""
        press, baseline = self.press, self.detector.baseline
        if press is None or baseline is None:
            raise SensorError("There was no test press. Press the sensor once.")
        difference: Floats = np.abs(press.astype(np.float64) - baseline)
        return difference

    def to_dict(self) -> dict[str, Any]:
        sensor, desk = self.sensor, self.sensor.desk
        has_baseline = self.detector.baseline is not None
        return {
            "name": f"{sensor.name} ({self.address})" if self.address else sensor.name,
            "unit": sensor.unit,
            "shape": list(sensor.image_shape),
            "lost": self.failed or sensor.lost or self._silence(),
            "baseline": has_baseline,
            "zero": has_baseline,  # the name before; goes with the next release
            "touching": self.detector.touching,
            "press": self._press_to_dict() if self._asking else None,
            "offer": self.detector.baseline_offer(time.monotonic()),
            "fixed": sensor.fixed,
            "warnings": [*self._warnings, *filter(None, [sensor.unfixed])],
            "desk": None
            if desk is None
            else {"objects": list(desk.objects), "placed": desk.placed},
        }

    def _silence(self) -> str:
        """Say that no frames come, where the sensor does not say why."""
        if time.monotonic() - self._heard_s < _SILENT_S:
            return ""
        why = "Check its cable and that it is switched on."
        return f"{self.sensor.name} gives no frames. {why}"

    def _press_to_dict(self) -> dict[str, Any]:
        """Return what is known of the test press; an array reads higher if pressed."""
        press, baseline, lower = self.press, self.detector.baseline, False
        if press is not None and baseline is not None and self._painter.coloured:
            lower = bool(np.nanmean(press.astype(np.float64) - baseline) < 0)
        return {"found": press is not None, "lower": lower, "number": self._n_presses}

    def compare_with(self, model: ObjectRecogniser | None) -> None:
        """Compare the sensor with what it was when a model learnt, from now on."""
        stored = None if model is None else model.memory_.sensor
        self._memory = None if stored is None else SensorMemory.from_dict(stored)
        learnt = None if model is None else tuple(model.encoder_.image_shape_)
        seen = tuple(self.sensor.image_shape)
        self.misfit = ""
        if learnt is not None and learnt != seen:
            how = (
                "; of a camera, rotation, crop and scale in its address bring pictures "
                "to a size"
            )
            if len(learnt) != len(seen):
                how = f", with colour={len(learnt) - 2}"
            self.misfit = (
                f"The model must be of images of {_kind(seen, learnt)}, which "
                f"{self.sensor.name} gives, got one of {_kind(learnt, seen)}. "
                "Learn a model of its own from touches of this sensor, or start with "
                f"the sensor that the model learnt from{how}."
            )
        self._compare()

    def _compare(self) -> None:
        """Say what has left tolerance since the model learnt."""
        baseline, memory = self.detector.baseline, self._memory
        warnings = [self.misfit]
        if not self.misfit and baseline is not None and memory is not None:
            warnings = [memory.baseline_warning(baseline.astype(np.float64))]
            recent = list(self._recent)
            if recent and not warnings[0]:
                warnings.append(memory.gain_warning(recent, baseline))
        self._warnings = [warning for warning in warnings if warning]

    def _follow(self) -> None:
        shown_s = stated_s = 0.0
        touching = False
        while not self._stop.is_set():
            frame = None
            try:
                frame = self.sensor.read_next(0.5)
                self._step(frame)
                self.failed = ""
            except SensorError as error:
                if frame is not None:  # of another size than the frame of no contact
                    self.failed = str(error)
            now_s = time.monotonic()
            if frame is not None and now_s - shown_s >= 1 / _SHOWN_HZ:
                shown_s = now_s
                self._show(frame)
            late = now_s - stated_s > _STATE_EVERY_S
            if late or touching != self.detector.touching:
                touching, stated_s = self.detector.touching, now_s
                values = {"sensor": self.to_dict(), "health": self._health.to_dict()}
                self._listeners.notify(Event("contact", values))

    def _step(self, frame: Frame) -> None:
        self._heard_s = time.monotonic()
        self._health.count_frame(frame.time_s)
        resting = self._resting
        if resting is not None:
            resting.append(frame.image)
            return
        with self._lock:
            self.detector.step = self.sensor.step
            touch = self.detector.update(frame)
        if touch is not None and self._asking:
            self.press, self._n_presses = touch.image, self._n_presses + 1
        elif touch is not None:
            self._detected.put((touch, frame.time_s))

    def _show(self, frame: Frame) -> None:
        if not self._listeners.n_of_frames:
            return
        picture = self._painter.paint(frame.image)
        self._health.count_shown(frame.time_s)
        values = {
            "type": self._painter.content_type,
            "number": frame.number,
            "touching": self.detector.touching,
        }
        shown = picture, frame.image, self.sensor.channels
        self._listeners.notify(Event("frame", values, *shown))

    def _hand_on(self) -> None:
        while (detected := self._detected.get()) is not None:
            touch, ended_s = detected
            with self._lock:
                self._recent = [*self._recent[1 - _RECENT :], touch.image]
            with suppress(Exception):  # what cannot be told must not end the touches
                self._take(touch, ended_s)
                self._compare()


def _is_baseline(frames: Sequence[Array], lasted_s: float) -> bool:
    """Tell whether frames are enough: ten, over ten periods of the mains.

    A driver that is asked too often gives each reading of its device many times: for a
    second more readings are waited for.
    """
    if len(frames) < _BASELINE_FRAMES or lasted_s < _BASELINE_S:
        return False
    same = (np.array_equal(a, b, equal_nan=True) for a, b in pairwise(frames))
    n_changes = sum(not again for again in same)
    return n_changes == 0 or n_changes >= _LEAST_CHANGES or lasted_s > _PATIENCE_S


def _kind(image_shape: tuple[int, ...], other: tuple[int, ...]) -> str:
    """Say how large images are, and whether in colour where others differ in that."""
    colour = " in colour" if len(image_shape) == 3 else " in grey"
    return size_text(image_shape[:2]) + colour * (len(image_shape) != len(other))


def _median(values: deque[float]) -> float | None:
    return float(np.median(values)) if values else None
