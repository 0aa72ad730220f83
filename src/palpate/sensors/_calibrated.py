"""A sensor whose readings are put through a calibration before anybody sees them."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from .._types import Array, Floats
from ._contract import Frame, LiveSensor, Reading, SensorError

_TICK_S = 0.3  # between looks at whether to stop


class Calibration(Protocol):
    """A map of images to those of another unit, such as `TaxelCalibration`."""

    image_shape_: tuple[int, int]

    def transform(self, X: Array) -> Floats: ...


class CalibratedSensor(LiveSensor):
    """Another sensor's frames in the unit of a calibration.

    Parameters
    ----------
    sensor : LiveSensor
        Not connected yet.
    calibration : Calibration
        A `TaxelCalibration`, or another fitted estimator of images.
    unit : str, default="kPa"
        What its numbers count.

    Raises
    ------
    ValueError
        The calibration is of an array of another size. Of a sensor that learns its
        size on connecting, that is a `SensorError` then.
    """

    queue_length = 64

    def __init__(
        self, sensor: LiveSensor, calibration: Calibration, unit: str = "kPa"
    ) -> None:
        self.inner, self.calibration = sensor, calibration
        if misfit := self._misfit():
            raise ValueError(misfit)
        shape, geometry = sensor.image_shape, sensor.geometry
        super().__init__(sensor.name, unit, shape, np.float64, geometry)
        self.channels = sensor.channels
        self._next_number = 0

    def no_contact(self) -> Array | None:
        """Return the frame of touching nothing, or None where it is not known."""
        rest = self.inner.no_contact()
        return None if rest is None else self._calibrated(rest)

    def _misfit(self) -> str:
        has, wants = self.inner.image_shape, tuple(self.calibration.image_shape_)
        if has == wants:
            return ""
        sizes = (" x ".join(map(str, shape)) for shape in (wants, has))
        return "The calibration is of {} taxels, the sensor has {}.".format(*sizes)

    def _calibrated(self, image: Array) -> Array:
        return np.asarray(self.calibration.transform(image[np.newaxis])[0])

    def _open(self) -> None:
        self.inner.connect()
        if misfit := self._misfit():
            self.inner.disconnect()
            raise SensorError(misfit)
        self.fixed, self.unfixed = self.inner.fixed, self.inner.unfixed
        self._next_number = 0

    def _grab(self) -> Sequence[Reading]:
        try:
            frame = self.inner.read_next(_TICK_S)
        except SensorError:
            self.lost = self.inner.lost
            return []
        return [self._reading(frame)]

    def _reading(self, frame: Frame) -> Reading:
        self._count_missed(max(0, frame.number - self._next_number))
        self._next_number = frame.number + 1
        image = self._calibrated(frame.image)
        return Reading(image, frame.time_s, frame.device_time_s, frame.columns)

    def _close(self) -> None:
        self.inner.disconnect()
