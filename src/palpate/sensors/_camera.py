"""A camera as a touch sensor: behind a membrane, in a dome, through a gel.

Cameras change their numbers whenever one is plugged in, so one is chosen by its name
or by a path that stays, such as `/dev/v4l/by-id/...`.
"""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._checks import check_number, check_positive
from .._extras import needed
from .._types import Array
from ._contract import LiveSensor, SensorError

# What the Linux driver (V4L2) means by exposure set by hand; others use 0.25 or 0.
_BY_HAND = 1
_WARM_UP = 5

OpenCapture = Callable[[str], Any]


class CameraSensor(LiveSensor):
    """Frames of a camera in grey levels or in colour, the newest first.

    Parameters
    ----------
    camera : str
        A part of the camera's name (as `camera_names` lists it) that only one
        camera has, or a path: `/dev/v4l/by-id/...`, `/dev/video0`, or a number.
    image_shape : (int, int), default=(480, 640)
        (n_rows, n_cols) to ask the camera for.
    rate_hz : float, default=30
        Frames per second to ask for.
    exposure : float, optional
        Exposure in the driver's own unit, kept fixed; None fixes what the camera
        has settled on after a few frames.
    colour : bool, default=False
        Give frames (n_rows, n_cols, 3) of red, green and blue, as the camera does.
    open_capture : callable, optional
        Returns an object like `cv2.VideoCapture` for `camera`; for tests, and for
        cameras that OpenCV does not know.

    Attributes
    ----------
    fixed : dict of str to bool
        Of "exposure", "white balance" and "focus", which the driver agreed to keep
        fixed; known once connected.

    Notes
    -----
    Without `colour` each pixel is its luma. An automatic exposure answers a touch by
    changing the whole picture, which is why it is switched off where the driver lets
    it be.
    """

    queue_length = 2

    def __init__(
        self,
        camera: str,
        image_shape: tuple[int, int] = (480, 640),
        *,
        rate_hz: float = 30.0,
        exposure: float | None = None,
        colour: bool = False,
        open_capture: OpenCapture | None = None,
    ) -> None:
        unit, more = ("colour level", (3,)) if colour else ("grey level", ())
        super().__init__(f"camera {camera}", unit, (*image_shape, *more), np.uint8)
        self.camera = camera
        self.rate_hz = check_positive("rate_hz", rate_hz)
        self.exposure = None if exposure is None else check_number("exposure", exposure)
        self.fixed: dict[str, bool] = {}
        self._open_capture = open_capture or _open_video
        self._capture: Any = None

    def _open(self) -> None:
        self._capture = self._open_capture(self.camera)
        try:
            self._set_up(self._capture)
        except SensorError:
            self._close()
            raise

    def _set_up(self, capture: Any) -> None:
        import cv2

        if not capture.isOpened():
            raise SensorError(
                f"The camera {self.camera!r} cannot be opened. Close the program that "
                "uses it, plug it in again, or check that you may read its device."
            )
        n_rows, n_cols = self.image_shape[:2]
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, n_cols)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, n_rows)
        capture.set(cv2.CAP_PROP_FPS, self.rate_hz)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        for _ in range(_WARM_UP):
            arrived, picture = capture.read()
        if not arrived:
            raise SensorError(
                f"The camera {self.camera!r} opens but gives no picture. Another "
                "program may be using it; close that, or plug the camera in again."
            )
        if picture.ndim < len(self.image_shape):
            raise SensorError(
                f"The camera {self.camera!r} must give colours, got grey levels. Leave "
                "colour out."
            )
        if picture.shape[:2] != (n_rows, n_cols):
            got_rows, got_cols = picture.shape[:2]
            raise SensorError(
                f"The camera {self.camera!r} must give {n_cols} x {n_rows} pixels, got "
                f"{got_cols} x {got_rows}. Ask for {got_cols}x{got_rows}."
            )
        # What changes the picture by itself is switched off, where the driver obeys.
        settled = capture.get(cv2.CAP_PROP_EXPOSURE)
        exposure = settled if self.exposure is None else self.exposure
        by_hand = capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _BY_HAND)
        self.fixed = {
            "exposure": bool(by_hand and capture.set(cv2.CAP_PROP_EXPOSURE, exposure)),
            "white balance": bool(capture.set(cv2.CAP_PROP_AUTO_WB, 0)),
            "focus": bool(capture.set(cv2.CAP_PROP_AUTOFOCUS, 0)),
        }

    def _grab(self) -> Sequence[Array]:
        arrived, picture = self._capture.read()
        if not arrived:
            raise SensorError(
                f"the camera {self.camera!r} stopped giving pictures. Plug it in again."
            )
        if picture.ndim == 3:
            import cv2

            colour = len(self.image_shape) == 3
            to = cv2.COLOR_BGR2RGB if colour else cv2.COLOR_BGR2GRAY
            picture = cv2.cvtColor(picture, to)
        return [picture]

    def _close(self) -> None:
        if self._capture is not None:
            self._capture.release()
        self._capture = None


def camera_names() -> list[tuple[str, str]]:
    """Return (name, path) of every camera that is plugged in.

    Raises
    ------
    ImportError
        The package that knows names is missing; the message names the extra.
    """
    what = "Choosing a camera by its name (a path such as /dev/video0 needs nothing)"
    listed = needed("cv2_enumerate_cameras", "camera", what).enumerate_cameras()
    found = {str(info.path or info.index): info.name for info in listed}
    return [(name, path) for path, name in found.items()]


def find_camera(camera: str) -> str:
    """Return the path (or number) of the one camera that `camera` means, or explain."""
    if camera.isdigit():
        return camera
    if os.sep in camera:
        if not Path(camera).exists():
            raise SensorError(f"There is no camera at {camera}.{_listed()}")
        return str(Path(camera).resolve())
    wanted = camera.lower()
    fits = [path for name, path in camera_names() if wanted in name.lower()]
    if len(fits) != 1:
        how_many = "No camera has" if not fits else f"{len(fits)} cameras have"
        raise SensorError(f"{how_many} {camera!r} in the name.{_listed()}")
    return fits[0]


def _listed() -> str:
    try:
        cameras = camera_names()
    except ImportError as error:
        return f" {error}"
    if not cameras:
        return " None is plugged in; check its cable."
    return " There are: " + ", ".join(f"{n!r} ({p})" for n, p in cameras) + "."


def _open_video(camera: str) -> Any:
    import cv2

    place = find_camera(camera)
    return cv2.VideoCapture(int(place) if place.isdigit() else place)
