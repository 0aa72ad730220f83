"""The contract as a check that authors of drivers can run."""

import time
from itertools import pairwise
from typing import Any

import numpy as np

from ..touches import GEOMETRIES
from ._contract import Frame, LiveSensor, SensorError, TouchSensor


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
    sensor.disconnect()
    _refuses_frames(sensor, "after disconnect()")
    with sensor as again:
        _check_frame(sensor, again.read_next())
    _say(not sensor.connected, "a with block must disconnect at its end")


def _check_promises(sensor: LiveSensor) -> None:
    """What must be known before connecting."""
    _say(isinstance(sensor, TouchSensor), "a sensor must keep TouchSensor's contract")
    _say(not sensor.connected, "check_sensor must be given one not connected yet")
    shape: Any = sensor.image_shape
    whole = isinstance(shape, tuple) and (len(shape) == 2 or shape[2:] == (3,))
    whole = whole and all(isinstance(n, int) and n > 0 for n in shape)
    promise = "image_shape must be a tuple of two positive integers, and 3 in colour"
    _say(whole, promise)
    _say(isinstance(sensor.unit, str) and sensor.unit != "", "unit must be a text")
    _say(isinstance(sensor.name, str) and sensor.name != "", "name must be a text")
    _say(isinstance(sensor.dtype, np.dtype), "dtype must be a numpy dtype")
    known = (None, *GEOMETRIES)
    _say(sensor.geometry in known, f"geometry must be one of {known}")


def _check_frames(sensor: LiveSensor, n_frames: int) -> None:
    started_s = time.monotonic()
    first = sensor.read_next()
    frames = [first, *(sensor.read_next() for _ in range(n_frames - 1))]
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
    rest = sensor.no_contact()
    if rest is not None:
        _say(rest.shape == sensor.image_shape, "no_contact() must give image_shape")


def _check_frame(sensor: LiveSensor, frame: Frame) -> None:
    image = frame.image
    _say(image.shape == sensor.image_shape, f"frames must be {sensor.image_shape}")
    _say(image.dtype == sensor.dtype, f"frames must be {sensor.dtype}")
    _say(not image.flags.writeable, "frames must be read-only")
    _say(not np.isinf(image).any(), "frames must hold no infinity")


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
