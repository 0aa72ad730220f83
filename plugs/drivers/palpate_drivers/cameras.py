"""Gels before a USB camera: DIGIT and GelSight Mini, as any UVC camera.

Both are UVC devices that the system knows without a vendor's package. What differs from
other cameras is here: what of the picture is gel, which way up it is, and the light,
which is steady once the camera has run for a minute.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.sensors import CameraSensor

Picture = NDArray[np.uint8]


class Framed:
    """A capture of OpenCV whose pictures are cut, turned and made smaller.

    Parameters
    ----------
    capture : object
        Like `cv2.VideoCapture`.
    full : (int, int)
        (n_rows, n_cols) that the camera is asked for.
    change : callable
        Makes of such a picture what the sensor gives.
    settings : dict
        Properties of OpenCV that are set once, by their numbers.
    """

    def __init__(
        self,
        capture: Any,
        full: tuple[int, int],
        change: Callable[[Picture], Picture],
        settings: dict[int, float],
    ) -> None:
        self._capture, self._full, self._change = capture, full, change
        for number, value in settings.items():
            capture.set(number, value)

    def isOpened(self) -> bool:  # as OpenCV calls it
        """Whether the camera is there."""
        return bool(self._capture.isOpened())

    def set(self, number: int, value: float) -> bool:
        """Set a property; the size is that of the whole picture."""
        import cv2

        rows, cols = cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_WIDTH
        value = {rows: self._full[0], cols: self._full[1]}.get(number, value)
        return bool(self._capture.set(number, value))

    def get(self, number: int) -> float:
        """Return a property."""
        return float(self._capture.get(number))

    def read(self) -> tuple[bool, Any]:
        """Return whether a picture came, and what is gel of it."""
        arrived, picture = self._capture.read()
        if arrived and picture.shape[:2] == self._full:  # else the sensor refuses it
            picture = self._change(picture)
        return arrived, picture

    def release(self) -> None:
        """Free the camera."""
        self._capture.release()


def digit(
    place: str,
    *,
    rate_hz: float = 60.0,
    exposure: float | None = None,
    light: int = 15,
    mirror: bool = False,
    open_capture: Callable[[str], Any] | None = None,
) -> CameraSensor:
    """Return a DIGIT: 320 x 240 pixels upright, in colour, its lights at 0 to 15.

    The camera lies on its side: pictures of 240 x 320 are turned by a quarter. Its
    lights are set by the property that UVC calls zoom.
    """
    import cv2

    def upright(picture: Picture) -> Picture:
        turned = np.rot90(picture)
        return np.ascontiguousarray(turned[:, ::-1] if mirror else turned)

    settings = {cv2.CAP_PROP_ZOOM: float(light)}
    opened = _opened((240, 320), upright, settings, open_capture)
    options: dict[str, Any] = {"rate_hz": rate_hz, "exposure": exposure}
    return CameraSensor(place, (320, 240), colour=True, open_capture=opened, **options)


def gelsight_mini(
    place: str,
    *,
    image_shape: tuple[int, int] = (240, 320),
    rate_hz: float = 25.0,
    exposure: float | None = None,
    border: float = 1 / 7,
    mirror: bool = False,
    open_capture: Callable[[str], Any] | None = None,
) -> CameraSensor:
    """Return a GelSight Mini: 2464 x 3280 pixels, its border cut off, made smaller.

    `border` is the share of rows and of columns cut off at each side, where the housing
    is seen; what is left becomes `image_shape` by means over areas.
    """
    import cv2

    full, (n_rows, n_cols) = (2464, 3280), image_shape
    if not 0 <= border < 0.5:
        raise ValueError(f"border must be a share below 0.5, got {border}.")
    top, left = (int(side * border) for side in full)

    def gel(picture: Picture) -> Picture:
        inside = picture[top : full[0] - top, left : full[1] - left]
        small = cv2.resize(inside, (n_cols, n_rows), interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(small[:, ::-1] if mirror else small, np.uint8)

    opened = _opened(full, gel, {}, open_capture)
    options: dict[str, Any] = {"rate_hz": rate_hz, "exposure": exposure}
    return CameraSensor(place, image_shape, colour=True, open_capture=opened, **options)


def _opened(
    full: tuple[int, int],
    change: Callable[[Picture], Picture],
    settings: dict[int, float],
    open_capture: Callable[[str], Any] | None,
) -> Callable[[str], Framed]:
    def usual(camera: str) -> Any:
        import cv2

        address = CameraSensor.path_of(camera)
        return cv2.VideoCapture(int(address) if address.isdigit() else address)

    return lambda name: Framed((open_capture or usual)(name), full, change, settings)
