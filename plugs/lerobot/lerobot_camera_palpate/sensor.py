"""A camera of LeRobot as a sensor of palpate: `--sensor lerobot:opencv?config=...`."""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.sensors import LiveSensor, SensorError

_WAIT_MS = 200


class LeRobotSensor(LiveSensor):
    """Frames of a camera of LeRobot, in red, green and blue.

    Parameters
    ----------
    place : str
        The type of camera: `opencv`, `intelrealsense`, `zmq`, or one of a plugin.
    image_shape : (int, int)
        (n_rows, n_cols) that the camera gives.
    config : str
        Its configuration as JSON, such as `{"index_or_path": 0, "fps": 30}`.
    """

    def __init__(
        self, place: str, *, image_shape: tuple[int, int], config: str = "{}"
    ) -> None:
        shape = (*image_shape, 3)
        super().__init__(f"lerobot {place}", "colour level", shape, np.uint8)
        try:
            self._config = dict(json.loads(config))
        except (ValueError, TypeError) as error:
            raise ValueError(
                f"config must be a JSON object, got {config!r}: {error}."
            ) from error
        self._kind = place
        self._camera: Any = None

    def _open(self) -> None:
        try:
            self._camera = self._make_camera()
            self._camera.connect()
        except Exception as error:  # each camera of LeRobot raises its own kinds
            raise SensorError(
                f"The camera {self._kind!r} of LeRobot cannot be opened: {error}"
            ) from error

    def _make_camera(self) -> Any:
        from lerobot.cameras.configs import CameraConfig
        from lerobot.cameras.utils import make_cameras_from_configs
        from lerobot.utils.import_utils import register_third_party_plugins

        for kind in ("opencv", "realsense", "zmq", "reachy2_camera"):
            try:
                __import__(f"lerobot.cameras.{kind}")
            except ImportError:  # a camera that is not installed is not offered
                continue
        register_third_party_plugins()
        kinds = CameraConfig.get_known_choices()
        if self._kind not in kinds:
            raise SensorError(f"it must be one of {', '.join(sorted(kinds))}")
        chosen = CameraConfig.get_choice_class(self._kind)(**self._config)
        return make_cameras_from_configs({"camera": chosen})["camera"]

    def _grab(self) -> list[NDArray[Any]]:
        try:
            return [self._camera.async_read(timeout_ms=_WAIT_MS)]
        except TimeoutError:
            return []

    def _close(self) -> None:
        camera, self._camera = self._camera, None
        if camera is not None and camera.is_connected:
            camera.disconnect()
