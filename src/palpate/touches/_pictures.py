"""One JPEG or PNG: its header, whether it is whole, and its grey levels.

Headers are read here, from the file's own bytes, so that the size is known before
anything is decoded, and so that a cut or altered file is refused: OpenCV fills what
is missing with grey and says so on standard error alone. A PNG carries checksums,
which are all tested. A JPEG carries none: one that is cut short is always refused,
but flipped bits within its coefficients give a wrong picture that nothing can tell.

Pictures are taken as stored: Exif orientation is never applied, for it would turn
some touches of a set and not others. Colour becomes its luma (ITU-R BT.601); 1-, 2-
and 4-bit greys are spread over 0-255; 16 bits stay 16 bits.
"""

import re
import zlib
from io import BytesIO
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_JPEG = b"\xff\xd8\xff"
_PNG = b"\x89PNG\r\n\x1a\n"
# The marker after coefficients: 0xFF but for stuffed zeros, fill and restarts.
_NEXT_MARKER = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")
_SOS, _EOI = 0xDA, 0xD9
_HUFFMAN_FRAMES = (0xC0, 0xC1, 0xC2)
_OTHER_FRAMES = (0xC3, *range(0xC5, 0xC8), *range(0xC9, 0xCC), *range(0xCD, 0xD0))
_ALPHA = (4, 6)
_IHDR = b"\x00\x00\x00\x0dIHDR"
_CUT_SHORT = "a file that is cut short"


class PictureError(Exception):
    """What was found instead of a picture, for the middle of a message."""


class Header(NamedTuple):
    """What must be the same for all pictures of a set."""

    format: str
    n_rows: int
    n_cols: int
    n_bits: int

    def __str__(self) -> str:
        return f"{self.n_cols} x {self.n_rows} {self.n_bits}-bit {self.format}"

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the grey levels."""
        return np.dtype(np.uint16 if self.n_bits == 16 else np.uint8)


def read_header(stream: IO[bytes]) -> Header:
    """Return the header of a picture, reading only as far as needed.

    Raises
    ------
    PictureError
        It is no JPEG or PNG, or one of a kind that is not read.
    """
    start = stream.read(8)
    if not start:
        raise PictureError("an empty file")
    if start == _PNG:
        return _png_header(stream)
    if start.startswith(_JPEG):
        stream.seek(2)
        return _jpeg_header(stream)
    raise PictureError("a file that is neither JPEG nor PNG")


def grey_levels(data: bytes, header: Header) -> NDArray[Any]:
    """Decode a whole picture to (n_rows, n_cols), of the type that `header` gives.

    Raises
    ------
    PictureError
        It is not the picture of that header, is cut short, or cannot be decoded.
    """
    found = read_header(BytesIO(data))
    if found != header:
        raise PictureError(f"{found} after {header}: the file changed meanwhile")
    if header.format == "PNG":
        _refuse_broken_png(data)
    else:
        _refuse_cut_jpeg(data)
    levels = _decoded(data, see_through=header.format == "PNG" and data[25] in _ALPHA)
    shape = (header.n_rows, header.n_cols)
    if levels is None or levels.shape != shape or levels.dtype != header.dtype:
        raise PictureError("a picture that cannot be decoded")
    return levels


def _decoded(data: bytes, *, see_through: bool) -> NDArray[Any] | None:
    import cv2

    as_stored = cv2.IMREAD_IGNORE_ORIENTATION
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | as_stored
    coded = np.frombuffer(data, np.uint8)
    try:
        if not see_through:
            return cv2.imdecode(coded, flags)
        levels = cv2.imdecode(coded, cv2.IMREAD_UNCHANGED | as_stored)
        if levels is None or levels.ndim != 3 or levels.shape[2] != 4:
            return None
        if levels[..., 3].min() < 2 ** (8 * levels.itemsize) - 1:
            raise PictureError("a picture with transparent parts")
        return cv2.cvtColor(levels, cv2.COLOR_BGRA2GRAY)
    except cv2.error:
        return None


def _jpeg_header(stream: IO[bytes]) -> Header:
    """Walk the segments up to the frame header."""
    while True:
        marker = _jpeg_marker(stream)
        if marker in _HUFFMAN_FRAMES:
            return _jpeg_frame(_segment(stream))
        if marker in _OTHER_FRAMES:
            raise PictureError("a lossless or arithmetic-coded JPEG")
        if marker in (_SOS, _EOI):
            raise PictureError("a JPEG without a frame")
        _segment(stream)


def _jpeg_frame(frame: bytes) -> Header:
    if len(frame) < 6:
        raise PictureError(_CUT_SHORT)
    n_bits, n_channels = frame[0], frame[5]
    n_rows, n_cols = (int.from_bytes(frame[i : i + 2], "big") for i in (1, 3))
    if n_bits != 8:
        raise PictureError(f"a {n_bits}-bit JPEG")
    if n_channels not in (1, 3):
        raise PictureError(f"a JPEG of {n_channels} channels (CMYK)")
    if not n_rows or not n_cols:
        raise PictureError(f"a JPEG of {n_cols} x {n_rows} pixels")
    return Header("JPEG", n_rows, n_cols, n_bits)


def _jpeg_marker(stream: IO[bytes]) -> int:
    byte = stream.read(1)
    if byte and byte != b"\xff":
        raise PictureError("a damaged JPEG")
    while byte == b"\xff":
        byte = stream.read(1)
    if not byte:
        raise PictureError(_CUT_SHORT)
    return byte[0]


def _segment(stream: IO[bytes]) -> bytes:
    length = int.from_bytes(stream.read(2), "big")
    segment = stream.read(max(0, length - 2))
    if length < 2 or len(segment) < length - 2:
        raise PictureError(_CUT_SHORT)
    return segment


def _refuse_cut_jpeg(data: bytes) -> None:
    """Walk all segments and scans to the end-of-image marker."""
    stream = BytesIO(data)
    stream.seek(2)
    n_frames = n_scans = 0
    while (marker := _jpeg_marker(stream)) != _EOI:
        _segment(stream)
        n_frames += marker in _HUFFMAN_FRAMES
        if marker == _SOS:
            n_scans += 1
            found = _NEXT_MARKER.search(data, stream.tell())
            if found is None:
                raise PictureError(_CUT_SHORT)
            stream.seek(found.start())
    if n_frames != 1 or not n_scans:
        raise PictureError("a damaged JPEG")


def _png_header(stream: IO[bytes]) -> Header:
    """Read the first chunk, then look for what makes a PNG more than one picture."""
    if stream.read(8) != _IHDR:
        raise PictureError("a damaged PNG")
    stream.seek(-8, 1)
    kind, first = _chunk(stream)
    n_cols, n_rows = (int.from_bytes(first[i : i + 4], "big") for i in (0, 4))
    if not n_rows or not n_cols:
        raise PictureError(f"a PNG of {n_cols} x {n_rows} pixels")
    while kind != b"IDAT":
        kind = _skipped_chunk(stream)
        if kind == b"acTL":
            raise PictureError("an animated PNG")
        if kind == b"tRNS":
            raise PictureError("a PNG with a transparent colour")
    return Header("PNG", n_rows, n_cols, 16 if first[8] == 16 else 8)


def _chunk(stream: IO[bytes]) -> tuple[bytes, bytes]:
    """Read a chunk of a PNG whose checksum is right."""
    start = stream.read(8)
    length = int.from_bytes(start[:4], "big")
    content = stream.read(length)
    check = stream.read(4)
    if len(start) < 8 or len(content) < length or len(check) < 4:
        raise PictureError(_CUT_SHORT)
    if zlib.crc32(content, zlib.crc32(start[4:])) != int.from_bytes(check, "big"):
        raise PictureError("a PNG whose checksum is wrong")
    return start[4:], content


def _skipped_chunk(stream: IO[bytes]) -> bytes:
    start = stream.read(8)
    if len(start) < 8:
        raise PictureError(_CUT_SHORT)
    if start[4:] != b"IDAT":
        stream.seek(int.from_bytes(start[:4], "big") + 4, 1)
    return start[4:]


def _refuse_broken_png(data: bytes) -> None:
    stream = BytesIO(data)
    stream.seek(len(_PNG))
    while _chunk(stream)[0] != b"IEND":
        pass
