"""Images going out as pictures for a page, and coming in as pictures or numbers.

Arrays are shown in false colour (viridis, which keeps its order in grey and for
colour-blind eyes), pictures of cameras in grey. What comes from outside goes
through the same decoder as folders of touches, in memory: sizes are known before
anything is decoded, and a picture that is cut or altered is refused.
"""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .._types import Array
from ..touches import TouchesError, decode_bytes

ARRAY_SIDE = 48
MAX_PIXELS = 4_000_000
_QUALITY = 80
_THUMBNAIL = 96
_KINDS = ("image/png", "image/jpeg")


class FramePainter:
    """Turns frames into JPEG or PNG bytes; keeps the range of what it has shown.

    Images of at most 48 taxels a side are of an array, shown in false colour.
    """

    def __init__(self, image_shape: tuple[int, int]) -> None:
        self.coloured = max(image_shape) <= ARRAY_SIDE
        self.content_type = "image/png" if self.coloured else "image/jpeg"
        self._low, self._high = float("inf"), float("-inf")

    def paint(self, image: Array) -> bytes:
        """Return a frame as the bytes of a picture of `content_type`."""
        shown = self.levels(image)
        if self.coloured:
            return _png(shown)
        coded = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
        return coded.tobytes()

    def levels(self, image: Array) -> NDArray[np.uint8]:
        """Return a frame as it is shown: blue, green and red, or grey."""
        if self.coloured:
            return self._false_colour(image)
        return image if image.dtype == np.uint8 else self._stretched(image)

    def _false_colour(self, image: Array) -> NDArray[np.uint8]:
        levels = self._stretched(image)
        painted = cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)
        painted[np.isnan(image.astype(np.float64))] = (90, 90, 90)
        return painted.astype(np.uint8, copy=False)

    def _stretched(self, image: Array) -> NDArray[np.uint8]:
        """Return 0 to 255 over the widest range seen so far."""
        if np.isnan(image.astype(np.float64)).all():
            return np.zeros(image.shape, np.uint8)
        self._low = min(self._low, float(np.nanmin(image)))
        self._high = max(self._high, float(np.nanmax(image)))
        span = max(self._high - self._low, float(np.finfo(np.float32).tiny))
        share = np.nan_to_num((image.astype(np.float64) - self._low) / span)
        return (share * 255).astype(np.uint8)


def thumbnail(image: Array) -> bytes:
    """Return one touch as a small PNG, stretched to its own range."""
    painter = FramePainter(image.shape)
    scale = _THUMBNAIL / max(image.shape)
    size = tuple(max(1, round(side * scale)) for side in image.shape[::-1])
    how = cv2.INTER_NEAREST if painter.coloured else cv2.INTER_AREA
    return _png(cv2.resize(painter.levels(image), size, interpolation=how))


def read_picture(data: bytes, content_type: str) -> NDArray[np.uint8 | np.uint16]:
    """Return the grey levels of a JPEG or PNG of at most 4 megapixels, or explain."""
    if content_type.partition(";")[0].strip().lower() not in _KINDS:
        raise TouchesError(
            f"A picture must be image/png or image/jpeg, got {content_type!r}."
        )
    levels: NDArray[np.uint8 | np.uint16] = decode_bytes(data, max_pixels=MAX_PIXELS)
    return levels


def read_numbers(rows: Sequence[Sequence[float | None]]) -> NDArray[np.float32]:
    """Return rows of taxels as an image, or explain; None is a dead taxel."""
    if len({len(row) for row in rows}) != 1 or not rows[0]:
        raise ValueError("The image must have rows of one length, at least 1.")
    with np.errstate(over="ignore"):
        image = np.array(rows, dtype=np.float32)
    if np.isinf(image).any():
        raise ValueError("The image must be finite (null for a dead taxel).")
    return image


def check_image(
    image: Array, shape: Sequence[int], dtype: np.dtype[Any] | None
) -> Array:
    """Return an image of the right size as the right type, or explain."""
    if image.shape != tuple(shape):
        got = " x ".join(map(str, image.shape))
        raise ValueError(
            f"The image must have {shape[0]} x {shape[1]} taxels, got {got}."
        )
    if dtype is None or dtype == image.dtype:
        return image
    if dtype.kind in "iu":
        limits = np.iinfo(dtype)
        whole = bool(np.isfinite(image).all() and (np.rint(image) == image).all())
        if not whole or image.min() < limits.min or image.max() > limits.max:
            raise ValueError(
                f"The image must hold whole numbers from {limits.min} to "
                f"{limits.max}, as the touches before it do."
            )
    return image.astype(dtype)


def _png(picture: Array) -> bytes:
    return cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
