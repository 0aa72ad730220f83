"""Images going out as pictures for a page, and coming in as pictures or numbers.

Arrays are shown in false colour (viridis, which keeps its order in grey and for
colour-blind eyes), pictures of cameras in grey. What comes from outside goes
through the same decoder as folders of touches, in memory: sizes are known before
anything is decoded, and a picture that is cut or altered is refused.
"""

import io
import json
import re
import time
from collections.abc import Sequence
from contextlib import suppress
from types import NoneType
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from .._checks import ARRAY_SIDE, size_text
from .._page import as_shown
from .._types import RGB, Array
from ..touches import TouchesError, decode_bytes

MAX_PIXELS, MOST_CHANNELS = 4_000_000, 64
_QUALITY = 80
_THUMBNAIL = 96
_GAP = (16, 14, 11)  # what lies behind pictures on the page; blue first
NPY = "application/x-npy"
KINDS = ("image/png", "image/jpeg", NPY)
# Of a body of JSON: where its rows begin, where the next does, and where they end; how
# long a row may be, and all that is not rows (bytes).
_BEGIN = re.compile(rb'(?<!\\)("image"\s*:)\s*\[\s*(?=\[)')
_NEXT, _END = re.compile(rb"\s*,\s*(?=\[)"), re.compile(rb"\s*\]")
_LONGEST_ROW, _LONGEST_REST = 2**18, 2**16
# After each row of a body over so many bytes others may go on.
_LONG_BODY, _PAUSE_S = 2**18, 2e-4
_BODY = 'The body must be {"image": [[0, 1], [2, null]]} with rows of numbers'
NO_IMAGE = f"{_BODY}, got none."


class FramePainter:
    """Turns frames into JPEG or PNG bytes; keeps the range of what it has shown.

    Frames with the channels "r", "g" and "b" are shown in these colours, of others the
    mean. Images of an array, of at most 48 taxels a side or with `false_colour`, are
    shown in false colour unless they have colours of their own; what has no reading is
    a gap.
    """

    def __init__(
        self,
        image_shape: Sequence[int],
        channels: Sequence[str] | None = None,
        false_colour: bool = False,
    ) -> None:
        has_colours = set(RGB) <= set(channels or ())
        self.coloured = not has_colours and (
            false_colour or max(image_shape[:2]) <= ARRAY_SIDE
        )
        self._channels = channels
        self.content_type = "image/png" if self.coloured else "image/jpeg"
        self._low, self._high = float("inf"), float("-inf")

    def paint(self, image: Array) -> bytes:
        shown = self.levels(image)
        if self.coloured:
            return _png(shown)
        coded = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
        return coded.tobytes()

    def levels(self, image: Array) -> NDArray[np.uint8]:
        """Return a frame as it is shown: blue, green and red, or grey."""
        image = as_shown(image[np.newaxis], self._channels)[0]
        if self.coloured:
            levels = self._stretched(image)
            painted = cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)
            painted[np.isnan(image.astype(np.float64))] = _GAP
            return painted.astype(np.uint8, copy=False)
        if image.ndim == 3:  # OpenCV writes blue first
            image = np.ascontiguousarray(image[..., ::-1])
        return image if image.dtype == np.uint8 else self._stretched(image)

    def _stretched(self, image: Array) -> NDArray[np.uint8]:
        """Return 0 to 255 over the widest range seen so far."""
        if np.isnan(image.astype(np.float64)).all():
            return np.zeros(image.shape, np.uint8)
        self._low = min(self._low, float(np.nanmin(image)))
        self._high = max(self._high, float(np.nanmax(image)))
        span = max(self._high - self._low, float(np.finfo(np.float32).tiny))
        share = np.nan_to_num((image.astype(np.float64) - self._low) / span)
        return (share * 255).astype(np.uint8)


def thumbnail(
    image: Array, channels: Sequence[str] | None = None, side: int = _THUMBNAIL
) -> bytes:
    """Return one touch as a PNG of `side` pixels, stretched to its own range."""
    painter = FramePainter(image.shape, channels)
    n_rows, n_cols = image.shape[:2]
    scale = side / max(n_rows, n_cols)
    size = max(1, round(n_cols * scale)), max(1, round(n_rows * scale))
    how = cv2.INTER_NEAREST if painter.coloured else cv2.INTER_AREA
    if scale > 1 and not painter.coloured:
        how = cv2.INTER_LINEAR
    return _png(cv2.resize(painter.levels(image), size, interpolation=how))


def read_picture(data: bytes, content_type: str, colour: bool) -> Array:
    """Return the levels of a JPEG or PNG of at most 4 megapixels, or explain.

    Grey, or with `colour` red, green and blue where it has them. Or numbers, as
    `numpy.save` writes them, (n_rows, n_cols[, n_channels]), as they are.
    """
    kind = content_type.partition(";")[0].strip().lower()
    if kind not in KINDS:
        raise TouchesError(
            f"A picture must be {', '.join(KINDS[:-1])} or {NPY}, got {content_type!r}."
        )
    if kind == NPY:
        return _read_npy(data)
    with suppress(TouchesError):  # as of a grey one, before it is decoded
        if colour:
            return decode_bytes(data, max_pixels=MAX_PIXELS, colour=True)
    return decode_bytes(data, max_pixels=MAX_PIXELS)


def _read_npy(data: bytes) -> Array:
    file = io.BytesIO(data)
    try:
        if np.lib.format.read_magic(file)[0] != 1:
            raise ValueError
        shape, by_column, kind = np.lib.format.read_array_header_1_0(file)
        if len(shape) not in (2, 3) or kind.kind not in "iuf":
            raise ValueError
        if max(shape[2:], default=0) > MOST_CHANNELS:
            raise ValueError
        image = np.frombuffer(data, kind, offset=file.tell())
        image = image.reshape(shape, order="F" if by_column else "C")
        if not image.size:
            raise ValueError
    except Exception:  # numpy raises many kinds on a damaged head
        raise TouchesError(
            "The array must be whole numbers or floats of shape (n_rows, n_cols"
            f"[, at most {MOST_CHANNELS} channels]) as numpy.save writes them, got "
            f"{len(data)} other bytes. Send a PNG instead."
        ) from None
    return _finite(np.ascontiguousarray(image.astype(kind.newbyteorder("="))))


def read_json(body: bytes) -> tuple[dict[str, Any], NDArray[np.float32] | None]:
    """Return a JSON object without its `image`, and that; null is a dead taxel.

    Rows are read one by one: a call that reads megabytes at once would hold up every
    other thread. A few words without rows are an object without an image.
    """
    begun = _BEGIN.search(body, 0, _LONGEST_REST)
    if begun is None:
        with suppress(ValueError, RecursionError):
            rest = json.loads(body[:_LONGEST_REST])
            if isinstance(rest, dict) and "image" not in rest:
                return rest, None
        raise ValueError(NO_IMAGE)
    more: re.Match[bytes] | None = begun
    rows: list[NDArray[np.float32]] = []
    try:
        while more is not None:
            start = more.end()
            stop = body.find(b"]", start, start + _LONGEST_ROW) + 1
            row = _row(json.loads(body[start:stop]))
            if rows and len(row) != len(rows[0]):
                raise ValueError
            rows.append(row)
            if len(body) > _LONG_BODY:
                time.sleep(_PAUSE_S)
            more = _NEXT.match(body, stop)
        ended = _END.match(body, stop)
        if ended is None or len(body) - ended.end() > _LONGEST_REST:
            raise ValueError
        rest = json.loads(body[: begun.end(1)] + b"null" + body[ended.end() :])
        if not isinstance(rest, dict) or rest.pop("image", rows) is not None:
            raise ValueError
    except (ValueError, OverflowError, RecursionError):
        wrong = f"{_BODY} of one length, got something else at row {len(rows) + 1}."
        raise ValueError(wrong) from None
    return rest, _finite(np.stack(rows))


def _row(values: list[object]) -> NDArray[np.float32]:
    if not values or not {type(value) for value in values} <= {int, float, NoneType}:
        raise ValueError
    with np.errstate(over="ignore"):
        return np.array(values, dtype=np.float32)


def _finite(image: Array) -> Array:
    if np.isinf(image).any():
        raise ValueError("The image must be finite (null or NaN for a dead taxel).")
    return image


Names = Sequence[str] | None  # of channels


class ImageKind(NamedTuple):
    """What images are like: (n_rows, n_cols[, n_channels]), type, channels."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any] | None
    channels: Names


def check_image(image: Array, kind: ImageKind) -> Array:
    """Return an image of the right size as the right type, or explain."""
    shape, dtype, channels = kind
    if image.shape != tuple(shape):
        want, got = size_text(shape[:2]), " x ".join(map(str, image.shape[:2]))
        if channels is not None or image.ndim == 3:
            want += f" with channels {', '.join(channels)}" if channels else " in grey"
            got += f" with {image.shape[2]} channels" if image.ndim == 3 else " in grey"
        raise ValueError(f"The image must have {want}, got {got}.")
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
