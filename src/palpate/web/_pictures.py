"""Frames as pictures for a page, and pictures from outside as images.

Arrays are shown in false colour (viridis, which keeps its order in grey and for
colour-blind eyes), pictures of cameras in grey. What comes from outside goes
through the same decoder as folders of touches, in memory: sizes are known before
anything is decoded, and a picture that is cut or altered is refused.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..touches import TouchesError, decode_bytes

ARRAY_SIDE = 48
_QUALITY = 80
_THUMBNAIL = 96
_KINDS = ("image/png", "image/jpeg")


class FramePainter:
    """Turns frames into JPEG or PNG bytes; keeps the range of what it has shown.

    Parameters
    ----------
    image_shape : (int, int)
        (n_rows, n_cols); at most 48 a side is an array, shown in false colour.
    """

    def __init__(self, image_shape: tuple[int, int]) -> None:
        self.coloured = max(image_shape) <= ARRAY_SIDE
        self.content_type = "image/png" if self.coloured else "image/jpeg"
        self._low, self._high = float("inf"), float("-inf")

    def paint(self, image: NDArray[Any]) -> bytes:
        """Return a frame as the bytes of a picture of `content_type`."""
        import cv2

        if self.coloured:
            return _png(self._false_colour(image))
        grey = image if image.dtype == np.uint8 else self._stretched(image)
        coded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
        return coded.tobytes()

    def _false_colour(self, image: NDArray[Any]) -> NDArray[np.uint8]:
        import cv2

        levels = self._stretched(image)
        painted = cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)
        painted[np.isnan(image.astype(np.float64))] = (90, 90, 90)
        return painted.astype(np.uint8, copy=False)

    def _stretched(self, image: NDArray[Any]) -> NDArray[np.uint8]:
        """Return 0 to 255 over the widest range seen so far."""
        if np.isnan(image.astype(np.float64)).all():
            return np.zeros(image.shape, np.uint8)
        self._low = min(self._low, float(np.nanmin(image)))
        self._high = max(self._high, float(np.nanmax(image)))
        span = max(self._high - self._low, float(np.finfo(np.float32).tiny))
        share = np.nan_to_num((image.astype(np.float64) - self._low) / span)
        return (share * 255).astype(np.uint8)


def thumbnail(image: NDArray[Any]) -> bytes:
    """Return one touch as a small PNG, stretched to its own range."""
    import cv2

    painter = FramePainter(image.shape)
    if painter.coloured:
        shown = painter._false_colour(image)
    else:
        shown = image if image.dtype == np.uint8 else painter._stretched(image)
    scale = _THUMBNAIL / max(image.shape)
    size = tuple(max(1, round(side * scale)) for side in image.shape[::-1])
    how = cv2.INTER_NEAREST if painter.coloured else cv2.INTER_AREA
    return _png(cv2.resize(shown, size, interpolation=how))


def read_picture(
    data: bytes, content_type: str, max_pixels: int
) -> NDArray[np.uint8 | np.uint16]:
    """Return the grey levels of a JPEG or PNG that came from outside.

    Raises
    ------
    TouchesError
        It is no whole picture, or too large; the message says which.
    """
    if content_type.partition(";")[0].strip().lower() not in _KINDS:
        raise TouchesError(
            f"A picture must be image/png or image/jpeg, got {content_type!r}."
        )
    levels: NDArray[np.uint8 | np.uint16] = decode_bytes(data, max_pixels=max_pixels)
    return levels


def _png(picture: NDArray[Any]) -> bytes:
    import cv2

    return cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
