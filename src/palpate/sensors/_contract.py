"""The contract of a tactile sensor: what touching needs, and what a live one adds.

`TouchSensor` is all that exploration asks for: one frame, now. `LiveSensor` is the
same contract for a sensor that runs by itself: it is connected, gives frame after
frame with the time each was taken, counts what was lost, and is disconnected. Every
`LiveSensor` is a `TouchSensor`. A driver says how to open its device, how to wait a
moment for frames and how to close it again; everything that the contract promises is
kept here, by a capture thread, a queue of frames, and looking for a lost device.
`check_sensor` drives a driver through the contract.
"""

import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import DTypeLike

from .._checks import check_count
from .._types import GEOMETRIES, RGB, Array, Floats

if TYPE_CHECKING:
    from ._played import PlayedSensor
    from .ros import Header

# The columns of touches that say where they were made, and their parts in `Reading`.
PLACE_COLUMNS = {
    "position_mm": ("x_mm", "y_mm", "z_mm"),
    "direction": ("direction_x", "direction_y", "direction_z"),
}
_FRESH_S = 2.0  # until a frame comes that was taken since it was asked for


class SensorError(RuntimeError):
    """A sensor that is missing or busy, or a frame that did not arrive or is none."""


# What opening a device may raise; vendors have kinds of their own.
_EXPECTED = SensorError, ValueError, OSError, ImportError


@dataclass(frozen=True, eq=False)
class Reading:
    """A frame as a driver gives it, with what else the device tells of it.

    Parameters
    ----------
    image : ndarray of shape (n_rows, n_cols[, n_channels])
        The frame.
    time_s : float, optional
        When it was taken, on the clock of `time.monotonic`; by default when it came.
    device_time_s : float, optional
        When it was taken, on the clock of the device.
    columns : mapping of str to float
        Readings beside the frame, such as `temperature_c`, `force_n`: the newest of
        each, at whatever rate it comes. They become columns of the touch. Where it was
        made is `x_mm`, `y_mm`, `z_mm` (of the tip) and `direction_x`, `direction_y`,
        `direction_z` (unit vector of the approach).
    """

    image: Array
    time_s: float | None = None
    device_time_s: float | None = None
    columns: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Frame:
    """One reading of a sensor at one time.

    `image` (n_rows, n_cols), or (n_rows, n_cols, n_channels), is read-only, in the
    sensor's unit; `time_s` is on the clock of `time.monotonic`; `number` counts from 0
    on connecting: a gap is a frame lost. `device_time_s` and `columns` are what the
    device told, see `Reading`.
    """

    image: Array
    time_s: float
    number: int
    device_time_s: float | None = None
    columns: Mapping[str, float] = field(default_factory=dict)


@runtime_checkable
class TouchSensor(Protocol):
    """A tactile sensor that can be asked for a frame.

    Attributes
    ----------
    image_shape : tuple of int
        (n_rows, n_cols) of every frame, or (n_rows, n_cols, n_channels).
    geometry : str or None
        How its taxels lie, see `Touches`.
    """

    @property
    def image_shape(self) -> tuple[int, ...]: ...

    @property
    def geometry(self) -> str | None: ...

    def read(self) -> Array:
        """Return a frame taken after this call, shape `image_shape`.

        Raises
        ------
        SensorError
            None arrived in the sensor's own time limit.
        """

    def no_contact(self) -> Array | None:
        """Return the frame of touching nothing, or None where it is not known."""


class LiveSensor(ABC):
    """Base of sensors that run by themselves; a driver writes three methods.

    A driver writes `_open`, `_grab` and `_close`. Everything but frames is known
    before connecting, or `_open` sets it: `image_shape`, `dtype`. Used as a context
    manager it connects and disconnects itself.

    Parameters
    ----------
    name : str
        What it is called, for people.
    unit : str
        What its numbers count, such as "grey level" or "kPa".
    image_shape : tuple of int
        (n_rows, n_cols) of every frame, or (n_rows, n_cols, n_channels).
    dtype : dtype
        Type of every frame.
    geometry : str, optional
        How its taxels lie, see `Touches`.

    Attributes
    ----------
    channels : tuple of str or None
        Names of the channels of its frames; "r", "g", "b" of three, unless set.
    lost : str
        Why no frames come at present, for people; empty while they do.
    n_frames : int
        Frames taken since it was connected.
    n_dropped : int
        Frames lost since it was connected: damaged, missed, or never read; at least
        one for each failure of the device.
    queue_length : int
        A frame that nobody has read when so many newer ones wait is dropped and
        counted. Frames that come at once wait beside them, up to `burst_length`.
    burst_length : int
        Of more frames that come at once the oldest are dropped and counted.
    retry_s : float
        When the device fails, it is opened again after so many seconds, over and
        over, until it is back or the sensor is disconnected.
    patience_s : float
        Disconnecting waits at most so long (seconds) for the last read to end.
    fixed : dict of str to bool
        Of what the device could change by itself, what it agreed to keep fixed.
    unfixed : str
        What it may change by itself, and what to do, for people; empty where nothing.
    """

    queue_length: ClassVar[int] = 2
    burst_length: ClassVar[int] = 256
    retry_s: float = 0.5
    patience_s: float = 5.0
    unfixed: str = ""

    def __init__(
        self,
        name: str,
        unit: str,
        image_shape: tuple[int, ...],
        dtype: DTypeLike,
        geometry: str | None = None,
    ) -> None:
        self.name, self.unit = name, unit
        if len(image_shape) not in (2, 3):
            raise ValueError(
                "image_shape must be two or three positive integers, got "
                f"{image_shape}. Name rows, columns and, if any, channels."
            )
        names = ("n_rows", "n_cols", "n_channels")
        self.image_shape = tuple(map(check_count, names, image_shape))
        self.dtype = np.dtype(dtype)
        self.channels = channels_of(self.image_shape)
        self.geometry = geometry
        self.lost, self.n_frames, self.n_dropped = "", 0, 0
        self.fixed: dict[str, bool] = {}
        self._queue: deque[Frame] = deque()
        self._arrived = threading.Condition()
        self._stop = threading.Event()
        self._connecting = threading.Lock()
        self._thread: threading.Thread | None = None
        self._latest: Frame | None = None
        self._number = self._largest_burst = 0
        self._connected_s = 0.0

    @property
    def step(self) -> float:
        """The smallest difference that its numbers can show; 0 where not known."""
        return 0.0

    @property
    def connected(self) -> bool:
        """Whether it runs; True also while it tries to find a lost device again."""
        return self._thread is not None and not self._stop.is_set()

    @property
    def desk(self) -> "PlayedSensor | None":
        """What lets things be placed before it by name; None of a real sensor."""
        return None

    def no_contact(self) -> Array | None:
        """Return the frame of touching nothing, or None where it is not known."""
        return None

    def header_at(self, device_time_s: float) -> "Header | None":
        """Return the header of the ROS message of a frame, None where none is kept."""
        return None

    def connect(self) -> Self:
        """Start frames; nothing happens where they run already.

        Raises
        ------
        SensorError
            The device is missing, busy, or not what was promised; says the fix.
        """
        with self._connecting:
            if not self.connected:
                self._connect()
        return self

    def _connect(self) -> None:
        if self._thread is not None and self._thread.is_alive():
            raise SensorError(
                f"{self.name} has not ended its last read. Unplug it, wait, try again."
            )
        self._thread = None
        self._queue.clear()
        self._latest, self.lost = None, ""
        self.n_frames = self.n_dropped = self._number = self._largest_burst = 0
        self._stop.clear()
        self._connected_s = time.monotonic()
        try:
            self._open()
            if self._stop.is_set():  # by another thread, meanwhile
                raise SensorError(f"{self.name} was disconnected.")
        except BaseException as error:  # an interrupt too: it may be half open
            with suppress(Exception):
                self._close()
            if isinstance(error, _EXPECTED) or not isinstance(error, Exception):
                raise
            what = f"{self.name} cannot be opened: {error!r}"
            raise SensorError(f"{what}. Look at its cable and its driver.") from error
        self._thread = threading.Thread(
            target=self._run, name=f"palpate {self.name}", daemon=True
        )
        self._thread.start()

    def disconnect(self) -> None:
        """Stop frames and free the device; nothing happens where none run.

        A device that does not answer is freed when its read ends, never during it.
        """
        self._stop.set()
        if self._thread is None:
            return
        with self._arrived:
            self._arrived.notify_all()
        self._thread.join(timeout=self.patience_s)

    def read_next(self, timeout_s: float = 2.0) -> Frame:
        """Return the oldest frame not returned by this method yet, waiting for it.

        Raises
        ------
        SensorError
            It is not connected, or no frame arrived in `timeout_s` seconds.
        """
        with self._arrived:
            self._wait(lambda: bool(self._queue), timeout_s)
            return self._queue.popleft()

    def read_latest(self, timeout_s: float = 2.0) -> Frame:
        """Return the newest frame there is, waiting only for the very first.

        Raises
        ------
        SensorError
            It is not connected, or has given no frame for `timeout_s` seconds.
        """
        with self._arrived:
            self._wait(lambda: self._latest is not None, timeout_s)
            assert self._latest is not None
            if time.monotonic() - self._latest.time_s > timeout_s:
                raise self._silent(timeout_s)
            return self._latest

    def read(self) -> Array:
        """Return a frame taken after this call, shape `image_shape`.

        Raises
        ------
        SensorError
            It is not connected, or no such frame arrived in 2 seconds.
        """
        asked_s = time.monotonic()
        while True:
            frame = self.read_next()
            if frame.time_s >= asked_s:
                return frame.image
            now_s = time.monotonic()
            if now_s - asked_s > _FRESH_S:
                raise SensorError(
                    f"{self.name} must give frames as they are taken, got one that is "
                    f"{now_s - frame.time_s:.1f} s old. Check the time_s of its driver."
                )

    def __enter__(self) -> Self:
        return self.connect()

    def __exit__(self, *error: object) -> None:
        self.disconnect()

    @abstractmethod
    def _open(self) -> None:
        """Open the device, or raise `SensorError` with the fix."""

    @abstractmethod
    def _grab(self) -> Sequence[Array | Reading]:
        """Wait a moment, return the frames that came; raise where the device is gone.

        Must return at least every half second, if with nothing. Frames are in the order
        in which they were taken; a `Reading` has its time and more.
        """

    @abstractmethod
    def _close(self) -> None:
        """Free the device; must bear being called twice."""

    def _count_missed(self, n_missed: int) -> None:
        """Count frames that the device took but that never came through."""
        self.n_dropped += n_missed
        self._number += n_missed

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                burst = self._grab()
                self._largest_burst = max(self._largest_burst, len(burst))
                self._count_missed(max(0, len(burst) - self.burst_length))
                for reading in burst[-self.burst_length :]:
                    self._put(reading, self.queue_length + len(burst) - 1)
            # A driver's bug must not end the stream unseen, nor must its SystemExit.
            except BaseException as error:
                self._recover(error)
        with suppress(Exception):
            self._close()

    def _recover(self, error: BaseException) -> None:
        promised = self.image_shape, self.dtype
        self._count_missed(1)
        while True:
            self.lost = str(error) if isinstance(error, SensorError) else repr(error)
            with suppress(BaseException):  # that it cannot even be closed is no news
                self._close()
            if self._stop.wait(self.retry_s):
                return
            try:
                self._open()
            except BaseException as still:  # as in `_run`: whatever it is, try again
                error = still
            else:
                # What came back in another size is refused: all who read know this one.
                self.image_shape, self.dtype = promised
                self.lost = ""
                return

    def _put(self, reading: Array | Reading, room: int) -> None:
        """Take in a frame, for which so many may wait in the queue."""
        full = reading if isinstance(reading, Reading) else Reading(reading)
        now_s = time.monotonic()
        taken_s = now_s if full.time_s is None else min(full.time_s, now_s)
        arrived = np.asarray(full.image)
        wrong = _broken_promise(arrived, self.image_shape, self.dtype)
        if not taken_s >= self._connected_s - _FRESH_S:  # or NaN
            wrong = (
                "it must give frames as they are taken: time_s must be of now, got "
                f"{now_s - taken_s:.1f} s ago. Leave it out, or use time.monotonic()"
            )
        if wrong:
            self._count_missed(1)
            self.lost = wrong
            return
        # A copy: drivers read their next frame into the same memory.
        image = np.array(arrived, dtype=self.dtype, order="C")
        image.flags.writeable = False
        self.lost = ""
        about = full.device_time_s, dict(full.columns)
        with self._arrived:
            self._latest = Frame(image, taken_s, self._number, *about)
            self._number += 1
            self.n_frames += 1
            while len(self._queue) >= room:
                self._queue.popleft()
                self.n_dropped += 1
            self._queue.append(self._latest)
            self._arrived.notify_all()

    def _wait(self, ready: Callable[[], bool], timeout_s: float) -> None:
        if not self.connected:
            raise SensorError(f"{self.name} is not connected; call connect() first.")
        self._arrived.wait_for(lambda: ready() or self._stop.is_set(), timeout_s)
        if not ready():
            raise self._silent(timeout_s)

    def _silent(self, timeout_s: float) -> SensorError:
        if not self.connected:
            return SensorError(f"{self.name} was disconnected.")
        if self.lost:
            return SensorError(f"{self.name} is lost: {self.lost}")
        return SensorError(
            f"{self.name} gave no frame in {timeout_s:g} s. "
            "Check its cable and that it is switched on."
        )


def _broken_promise(image: Array, shape: tuple[int, ...], dtype: np.dtype[Any]) -> str:
    """Return how a frame is not what a driver promised, or nothing."""
    if image.shape != shape:
        return f"its frames are {image.shape}, it promised {shape}"
    if dtype.kind in "iu" and image.dtype != dtype:
        low, high, limits = image.min(), image.max(), np.iinfo(dtype)
        if not (low >= limits.min and high <= limits.max):  # NaN is in no limits
            return f"its frames hold {low} to {high}, which its dtype {dtype} cannot"
        between = image[image != np.rint(image)]
        if between.size:
            return f"its frames hold {between[0]:g}, which its dtype {dtype} cannot"
    if dtype.kind == "f" and np.isinf(image.astype(dtype, copy=False)).any():
        return "its frames hold infinity; NaN marks a dead taxel"
    return ""


def channels_of(image_shape: Sequence[int]) -> tuple[str, ...] | None:
    """Return what the channels of frames are called unless told, None without any."""
    if len(image_shape) == 2:
        return None
    return RGB if image_shape[2] == len(RGB) else tuple(map(str, range(image_shape[2])))


def as_kind(image: Floats, dtype: np.dtype[Any]) -> Array:
    """Return an image in a sensor's type of numbers, rounded where those are whole."""
    return (np.rint(image) if dtype.kind in "iu" else image).astype(dtype)


def check_sensor(sensor: LiveSensor, *, n_frames: int = 10) -> None:
    """Drive a sensor through its contract and say what it breaks.

    Parameters
    ----------
    sensor : LiveSensor
        Not connected yet; the device must be there and give frames.
    n_frames : int, default=10
        Frames to read in a row.

    Raises
    ------
    AssertionError
        The contract is broken; the message says which part.
    SensorError
        The device itself failed.

    Examples
    --------
    >>> from palpate import Touches
    >>> from palpate.sensors import ReplaySensor, check_sensor
    >>> check_sensor(ReplaySensor(Touches([[[0, 1]], [[1, 0]]]), rate_hz=500))
    """
    check_count("n_frames", n_frames)
    _check_promises(sensor)
    _refuses_frames(sensor, "before connect()")
    _say(sensor.connect() is sensor, "connect() must return the sensor")
    try:
        _say(sensor.connect() is sensor, "connect() twice must change nothing")
        _say(sensor.connected, "connected must be True after connect()")
        _check_frames(sensor, n_frames)
    finally:
        sensor.disconnect()
    _say(not sensor.connected, "connected must be False after disconnect()")
    running = [thread.name for thread in threading.enumerate()]
    stopped = f"palpate {sensor.name}" not in running
    _say(stopped, "_grab() must return at least every half second")
    sensor.disconnect()
    _refuses_frames(sensor, "after disconnect()")
    with sensor as again:
        _check_frame(sensor, again.read_next())
    _say(not sensor.connected, "a with block must disconnect at its end")


def _check_promises(sensor: LiveSensor) -> None:
    _say(isinstance(sensor, TouchSensor), "a sensor must keep TouchSensor's contract")
    _say(not sensor.connected, "check_sensor must be given one not connected yet")
    shape: Any = sensor.image_shape
    whole = isinstance(shape, tuple) and len(shape) in (2, 3)
    whole = whole and all(isinstance(n, int) and n > 0 for n in shape)
    _say(whole, "image_shape must be a tuple of two or three positive integers")
    n_channels = () if sensor.channels is None else (len(sensor.channels),)
    _say(shape[2:] == n_channels, "channels must name each channel of image_shape")
    _say(isinstance(sensor.unit, str) and sensor.unit != "", "unit must be a text")
    _say(isinstance(sensor.name, str) and sensor.name != "", "name must be a text")
    _say(isinstance(sensor.dtype, np.dtype), "dtype must be a numpy dtype")
    geometries = (None, *GEOMETRIES)
    _say(sensor.geometry in geometries, f"geometry must be one of {geometries}")


def _check_frames(sensor: LiveSensor, n_frames: int) -> None:
    started_s = time.monotonic()
    frames = []
    for _ in range(n_frames):
        frames.append(sensor.read_next())
        old_s = time.monotonic() - frames[-1].time_s
        _say(old_s <= _FRESH_S, f"time_s must be of now, got {old_s:.1f} s ago")
    for frame in frames:
        _check_frame(sensor, frame)
        late = frame.time_s > time.monotonic()
        _say(not late, "time_s must be on time.monotonic()'s clock, not in the future")
    times = [frame.time_s for frame in frames]
    _say(times == sorted(times), "read_next() must give frames in the order of time")
    numbers = [frame.number for frame in frames]
    rising = all(b > a for a, b in pairwise(numbers))
    _say(rising, "read_next() must never give one frame twice: numbers must rise")
    latest = sensor.read_latest()
    _check_frame(sensor, latest)
    _say(latest.number >= numbers[-1], "read_latest() must not be older than read_next")
    asked_s = time.monotonic()
    image = sensor.read()
    _say(image.shape == sensor.image_shape, "read() must give image_shape")
    fresh = sensor.read_latest().time_s >= asked_s >= started_s
    _say(fresh, "read() must give a frame taken after the call")
    _say(sensor.n_frames >= n_frames, "n_frames must count the frames taken")
    _say(sensor.n_dropped >= 0, "n_dropped must not be negative")
    largest, most = sensor._largest_burst, sensor.burst_length
    kept = f"_grab() returned {largest} frames at once, of which {most} are kept"
    _say(largest <= most, f"{kept}; return them more often")
    span = numbers[-1] + 1 - numbers[0]
    counted = span - len(numbers) <= sensor.n_dropped
    _say(counted, "n_dropped must count the frames that numbers leave out")
    rest = sensor.no_contact()
    if rest is not None:
        _say(rest.shape == sensor.image_shape, "no_contact() must give image_shape")


def _check_frame(sensor: LiveSensor, frame: Frame) -> None:
    image = frame.image
    _say(image.shape == sensor.image_shape, f"frames must be {sensor.image_shape}")
    _say(image.dtype == sensor.dtype, f"frames must be {sensor.dtype}")
    _say(not image.flags.writeable, "frames must be read-only")
    _say(not np.isinf(image).any(), "frames must hold no infinity")
    numeric = all(
        isinstance(name, str) and np.isscalar(value) and np.isreal(value)
        for name, value in frame.columns.items()
    )
    _say(numeric, "columns of a frame must be numbers with a name each")


def _refuses_frames(sensor: LiveSensor, when: str) -> None:
    for read in (sensor.read_next, sensor.read_latest):
        try:
            read(0.01)
        except SensorError:
            continue
        _say(False, f"{read.__name__}() must raise SensorError {when}")


def _say(kept: bool, promise: str) -> None:
    if not kept:
        raise AssertionError(f"The sensor breaks its contract: {promise}.")
