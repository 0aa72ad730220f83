"""A camera as a touch sensor: behind a membrane, in a dome, through a gel.

Cameras change their numbers whenever one is plugged in, so one is chosen by its name
or by a path that stays, such as `/dev/v4l/by-id/...`.
"""

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._checks import check_count, check_number, check_option, check_positive
from .._extras import needed
from .._types import Array
from ._contract import LiveSensor, SensorError

# What the Linux driver (V4L2) means by exposure set by hand; others use 0.25 or 0.
_BY_HAND = 1
_WARM_UP = 5
_ABSENT = -1  # what OpenCV reads where the driver has no such control

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
    exposure, gain : float, optional
        In the driver's own unit, kept fixed; None fixes what the camera has settled
        on after a few frames of the first connection, also when it is found again.
    colour : bool, default=False
        Give frames (n_rows, n_cols, 3) of red, green and blue, as the camera does.
    crop : (int, int, int, int), optional
        First row, first column, rows and columns of its picture to take.
    rotation : {0, 90, 180, 270}, default=0
        Degrees to turn what is taken, anticlockwise.
    scale : float, default=1
        Shrink what is taken to this share of its rows and columns, more than 0 and
        at most 1; pixels become means over areas.
    fourcc : str, optional
        How the camera is to send pictures, four letters such as "MJPG".
    open_capture : callable, optional
        Returns an object like `cv2.VideoCapture` for `camera`; for tests, and for
        cameras that OpenCV does not know.

    Attributes
    ----------
    fixed : dict of str to bool
        Of "exposure", "white balance" and, where it has them, "focus" and "gain",
        which the driver agreed to keep fixed; known once connected.
    kept : dict of str to float
        What these are kept at, once connected; -1 where the driver does not say.

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
        gain: float | None = None,
        colour: bool = False,
        crop: tuple[int, int, int, int] | None = None,
        rotation: int = 0,
        scale: float = 1.0,
        fourcc: str | None = None,
        open_capture: OpenCapture | None = None,
    ) -> None:
        unit, more = ("colour level", (3,)) if colour else ("grey level", ())
        self.picture_shape = tuple(map(check_count, ("n_rows", "n_cols"), image_shape))
        self.crop = _checked_crop(crop, self.picture_shape)
        turns = check_option("rotation", rotation, (0, 90, 180, 270)) // 90
        share = check_positive("scale", check_number("scale", scale, high=1.0))
        sides = [max(1, math.floor(n * share + 0.5)) for n in self.crop[2:]]
        shape = (*(sides[::-1] if turns % 2 else sides), *more)
        super().__init__(f"camera {camera}", unit, shape, np.uint8)
        self.camera = camera
        self.rate_hz = check_positive("rate_hz", rate_hz)
        levels = {"exposure": exposure, "gain": gain}
        self.kept = {n: check_number(n, v) for n, v in levels.items() if v is not None}
        if fourcc is not None and not (len(fourcc) == 4 and fourcc.isascii()):
            raise ValueError(
                f"fourcc must be four letters such as MJPG, got {fourcc!r}."
            )
        self.fourcc = fourcc
        self._sides, self._turns = sides, turns
        self._open_capture = open_capture or _open_video
        self._capture: Any = None

    @staticmethod
    def path_of(camera: str) -> str:
        """Return the path (or number) of the one camera that `camera` means.

        Raises
        ------
        SensorError
            There is none, or more than one; the message lists those there are.
        """
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

    def _open(self) -> None:
        import cv2

        self._capture = capture = self._open_capture(self.camera)
        if not capture.isOpened():
            raise SensorError(
                f"The camera {self.camera!r} cannot be opened. Close the program that "
                "uses it, plug it in again, or check that you may read its device."
            )
        if self.fourcc is not None:
            capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*self.fourcc))
        n_rows, n_cols = self.picture_shape
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, n_cols)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, n_rows)
        capture.set(cv2.CAP_PROP_FPS, self.rate_hz)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        self._check_picture(capture)
        self._fix(capture)
        self._check_picture(capture)  # so that no frame from before is given

    def _check_picture(self, capture: Any) -> None:
        for _ in range(_WARM_UP):
            arrived, picture = capture.read()
        if not arrived:
            raise SensorError(
                f"The camera {self.camera!r} opens but gives no picture. Another "
                "program may be using it; close that, or plug the camera in again."
            )
        self._check_size(picture)

    def _check_size(self, picture: Array) -> None:
        if picture.ndim < len(self.image_shape):
            raise SensorError(
                f"The camera {self.camera!r} must give colours, got grey levels. Leave "
                "colour out."
            )
        if picture.shape[:2] != self.picture_shape:
            wanted, got = self.picture_shape, picture.shape[:2]
            raise SensorError(
                f"The camera {self.camera!r} must give {wanted[0]} rows x {wanted[1]} "
                f"columns, got {got[0]} x {got[1]}. Ask for shape={got[0]}x{got[1]}."
            )

    def _fix(self, capture: Any) -> None:
        """Switch off what changes the picture by itself; keep what it first was at."""
        import cv2

        controls = {
            "exposure": (cv2.CAP_PROP_AUTO_EXPOSURE, _BY_HAND, cv2.CAP_PROP_EXPOSURE),
            "white balance": (cv2.CAP_PROP_AUTO_WB, 0, cv2.CAP_PROP_WB_TEMPERATURE),
            "focus": (cv2.CAP_PROP_AUTOFOCUS, 0, cv2.CAP_PROP_FOCUS),
            "gain": (None, 0, cv2.CAP_PROP_GAIN),
        }
        settled = {name: capture.get(control[2]) for name, control in controls.items()}
        self.kept, previous, self.fixed = settled | self.kept, self.kept, {}
        for name, (automatic, off, level) in controls.items():
            is_there = capture.get(level if automatic is None else automatic) != _ABSENT
            if not is_there and name in ("focus", "gain") and name not in previous:
                continue  # nothing there that could change
            value = self.kept[name]
            obeys = automatic is None or capture.set(automatic, off)
            obeys = obeys and (value == _ABSENT or capture.set(level, value))
            self.fixed[name] = bool(obeys)
        loose = " and ".join(name for name, kept in self.fixed.items() if not kept)
        self.unfixed = loose and (
            f"The driver of camera {self.camera!r} does not keep {loose} fixed: the "
            "picture may change untouched. Fix that with another program, or keep the "
            "light as it is and take the baseline often."
        )

    def _grab(self) -> Sequence[Array]:
        import cv2

        arrived, picture = self._capture.read()
        if not arrived:
            raise SensorError(
                f"the camera {self.camera!r} stopped giving pictures. Plug it in again."
            )
        self._check_size(picture)
        row, col, n_rows, n_cols = self.crop
        taken = picture[row : row + n_rows, col : col + n_cols]
        if picture.ndim == 3:
            colour = len(self.image_shape) == 3
            to = cv2.COLOR_BGR2RGB if colour else cv2.COLOR_BGR2GRAY
            taken = cv2.cvtColor(taken, to)
        if self._sides != [n_rows, n_cols]:
            taken = cv2.resize(taken, self._sides[::-1], interpolation=cv2.INTER_AREA)
        return [np.rot90(taken, self._turns)]

    def _close(self) -> None:
        if self._capture is not None:
            self._capture.release()
        self._capture = None


def _checked_crop(
    crop: Sequence[int] | None, shape: Sequence[int]
) -> tuple[int, int, int, int]:
    window = (0, 0, *shape) if crop is None else tuple(crop)
    if len(window) == 4:
        row, col, n_rows, n_cols = map(int, window)
        within = row + n_rows <= shape[0] and col + n_cols <= shape[1]
        if min(row, col) >= 0 and min(n_rows, n_cols) > 0 and within:
            return row, col, n_rows, n_cols
    raise ValueError(
        "crop must be first row, first column, rows, columns within "
        f"{shape[0]} x {shape[1]}, got {','.join(map(str, window))}. Take less of them."
    )


def camera_names() -> list[tuple[str, str]]:
    """Return (name, path) of every camera that is plugged in.

    `ImportError` names the extra that is missing.
    """
    what = "Choosing a camera by its name (a path such as /dev/video0 needs nothing)"
    listed = needed("cv2_enumerate_cameras", "camera", what).enumerate_cameras()
    names = {str(info.path or info.index): info.name for info in listed}
    return [(name, path) for path, name in names.items()]


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

    place = CameraSensor.path_of(camera)
    # What is wrong is said once, in a sentence of our own.
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    return cv2.VideoCapture(int(place) if place.isdigit() else place)
