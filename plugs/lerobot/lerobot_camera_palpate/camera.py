"""A sensor of palpate in the shape that LeRobot expects of a camera."""

from typing import Any

import numpy as np
from lerobot.cameras.camera import Camera
from numpy.typing import NDArray

from palpate.sensors import SensorError, open_sensor

from .config import PalpateCameraConfig

_MS = 1000.0


class PalpateCamera(Camera):  # type: ignore[misc]
    """Frames (height, width, 3) of 8 bits: grey three times, colours, or x, y, z.

    Width, height and frames a second may be left out of the configuration; given
    ones must be those of the sensor. Dead taxels (NaN) are 0.
    """

    def __init__(self, config: PalpateCameraConfig) -> None:
        super().__init__(config)
        if not config.low < config.high:
            raise ValueError(
                f"low must be below high, got {config.low}, {config.high}."
            )
        self._sensor = open_sensor(config.sensor)
        self._low, self._high = config.low, config.high
        size = self._sensor.image_shape
        if len(size) == 3 and size[2] > 3:
            raise ValueError(
                f"{config.sensor} must have at most 3 channels, got {size}."
            )
        configured = (config.height or size[0], config.width or size[1])
        if configured != size[:2]:
            raise ValueError(
                f"height and width must be those of {config.sensor}, {size[0]} x "
                f"{size[1]}, got {configured[0]} x {configured[1]}. Leave them out."
            )
        self.height, self.width = size[0], size[1]
        self.fps = config.fps or round(getattr(self._sensor, "rate_hz", 30))

    @property
    def is_connected(self) -> bool:
        """Whether frames come."""
        return self._sensor.connected

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Return nothing: sensors are named by their addresses."""
        return []

    def connect(self, warmup: bool = True) -> None:
        """Start the sensor, and wait for its first frame."""
        try:
            self._sensor.connect()
            if warmup:
                self._sensor.read_latest()
        except SensorError as error:
            self._sensor.disconnect()
            raise ConnectionError(str(error)) from error

    def read(self) -> NDArray[Any]:
        """Return a frame taken after this call."""
        try:
            return self._picture(self._sensor.read())
        except SensorError as error:
            raise TimeoutError(str(error)) from error

    def async_read(self, timeout_ms: float = 200.0) -> NDArray[Any]:
        """Return the oldest frame not returned yet, waiting for it."""
        try:
            return self._picture(self._sensor.read_next(timeout_ms / _MS).image)
        except SensorError as error:
            raise TimeoutError(str(error)) from error

    def read_latest(self, max_age_ms: int = 500) -> NDArray[Any]:
        """Return the newest frame."""
        try:
            return self._picture(self._sensor.read_latest(max_age_ms / _MS).image)
        except SensorError as error:
            raise TimeoutError(str(error)) from error

    def disconnect(self) -> None:
        """Stop the sensor."""
        self._sensor.disconnect()

    def _picture(self, image: NDArray[Any]) -> NDArray[Any]:
        if image.dtype != np.uint8 or (self._low, self._high) != (0, 255):
            share = (image.astype(np.float64) - self._low) / (self._high - self._low)
            image = np.rint(np.nan_to_num(share).clip(0, 1) * 255).astype(np.uint8)
        if image.ndim == 2:
            image = image[..., None]
        channels = [min(channel, image.shape[2] - 1) for channel in range(3)]
        return np.ascontiguousarray(image[..., channels])
