"""JPEG and PNG pictures: their headers, whether they are whole, and their levels.

Headers are read first, so that the size is known before anything is decoded. A PNG's
checksums are tested; OpenCV decodes it. A JPEG has no checksum, but libjpeg
complains of much damage and of a missing end: simplejpeg tells, where OpenCV and Pillow
fill in grey. Most single flipped bits among its coefficients still give a wrong picture
that nothing can tell; docs/contributing/testing.md has figures.

Pictures are turned upright as their Exif orientation says, like every viewer does: a
camera that was turned meanwhile writes it. Colour becomes its luma (ITU-R BT.601)
unless colours are asked for; 1-, 2- and 4-bit greys are spread over 0-255; 16 bits
stay 16 bits.
"""

import os
import re
import stat
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from itertools import takewhile
from math import inf, prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._parallel import Progress
from .._types import RGB, Array
from ._columns import TouchesError, refuse_large

_MOST_SCANS = 100  # progressive files of cameras have about ten
# A scan has ten bytes at least and takes at most some 0.4 ns a pixel: where bytes times
# pixels are fewer, as of a camera's 640 x 480, no picture takes longer than a second.
_FEW = 5 * 2**32
_HEAD, _SCAN_MARKER = 2, np.frombuffer(b"\xff\xda", np.uint16)[0]
# A run of 0xFF, and the code of a marker if it is one that begins a segment.
_MARKER = re.compile(rb"\xff+(?:([^\x00\xd0-\xd7\xff])|[^\xff]|\Z)")
_JPEG = b"\xff\xd8\xff"
_PNG = b"\x89PNG\r\n\x1a\n"
# Codes of a JPEG's markers.
_SCAN, _END, _APP1 = 0xDA, 0xD9, 0xE1
_HUFFMAN_FRAMES = (0xC0, 0xC1, 0xC2)
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_ALPHA = (4, 6)
_GREY = (0, 4)
_SAVE_AGAIN = "save it again as 8-bit JPEG or 8- or 16-bit PNG, or take it out"
_CUT_SHORT = "a file that is cut short"
_EXIF = b"Exif\0\0"
_ORIENTATION = 0x0112
_UPRIGHT = 1
# What makes a stored picture upright, by its Exif orientation (5 to 8 swap the sides).
_TURNS: dict[int, Callable[[Array], Array]] = {
    2: np.fliplr,
    3: lambda levels: levels[::-1, ::-1],
    4: np.flipud,
    5: lambda levels: levels.swapaxes(0, 1),
    6: lambda levels: np.rot90(levels, -1),
    7: lambda levels: levels[::-1, ::-1].swapaxes(0, 1),
    8: np.rot90,
}
_MOST_HEADERS = 2**20  # bytes before the pixels, but for few pictures
# Room for comments, colour profiles and previews beside the pixels themselves.
_MORE_BYTES = 32 * 2**20
_BYTES_PER_PIXEL = 8
_AT_ONCE = 8


class PictureError(Exception):
    """A file is no picture that is read; the text is for the middle of a message."""

    def __init__(self, problem: str, fix: str = _SAVE_AGAIN) -> None:
        super().__init__(problem)
        self.fix = fix


class Header(NamedTuple):
    """Format, size and depth, upright; the same for all pictures of a set.

    But for the format: JPEG and PNG may stand together. `colour` counts only where
    colours are asked for; it is False elsewhere.
    """

    format: str
    n_rows: int
    n_cols: int
    n_bits: int
    colour: bool = False

    def __str__(self) -> str:
        kind = f"{'colour ' * self.colour}{self.format}"
        return f"{self.n_cols} x {self.n_rows} {self.n_bits}-bit {kind}"

    def is_like(self, other: "Header") -> bool:
        """Whether a picture has the other's size and depth, in whatever format."""
        return self._replace(format=other.format) == other

    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype(np.uint16 if self.n_bits == 16 else np.uint8)

    @property
    def shape(self) -> tuple[int, ...]:
        """(n_rows, n_cols), and three channels of a colour picture."""
        return (self.n_rows, self.n_cols, *([len(RGB)] if self.colour else []))

    def checked(self, colour: bool, max_pixels: float = inf) -> "Header":
        """Return it as it counts; refuse what is grey where colours are asked for."""
        if colour and not self.colour:
            fix = "take it out, or learn and recognise without `colour`"
            problem = f"{self} in grey where colour is asked for"
            raise PictureError(problem, fix)
        if not 0 < self.n_rows * self.n_cols <= max_pixels:
            fix = "make it smaller, or raise `max_pixels` if you trust it"
            problem = f"{self}, not of 1 to at most {max_pixels} pixels"
            raise PictureError(problem, fix)
        return self if colour else self._replace(colour=False)


def decode_bytes(
    data: bytes, *, max_pixels: int = 50_000_000, colour: bool = False
) -> Array:
    """Return the levels of a JPEG or PNG in memory, (n_rows, n_cols[, 3]).

    Parameters
    ----------
    data : bytes
        The whole file.
    max_pixels : int
        Larger pictures are refused before they are decoded.
    colour : bool, default=False
        Return red, green and blue; a picture in grey is refused.

    Returns
    -------
    ndarray of uint8, of uint16 for a PNG of 16 bits
        Luma where the picture has colours, unless these are asked for; upright, as the
        Exif orientation says.

    Raises
    ------
    TouchesError
        It is no such picture, too large, cut short or altered.
    """
    try:
        header, orientation = _read_header(data)
        return _levels(data, header.checked(colour, max_pixels), orientation)
    except PictureError as error:
        raise refusal("A picture", error) from error


def png_bytes(levels: Array) -> bytes:
    """Return levels, (n_rows, n_cols[, 3]) of 8 or 16 bits, as a PNG."""
    import cv2

    ordered = levels[..., ::-1] if levels.ndim == 3 else levels
    return bytes(cv2.imencode(".png", ordered)[1])


def common_header(paths: Sequence[Path], *, max_pixels: int, colour: bool) -> Header:
    """Return the header that all pictures share; the error names who differs."""
    limits: dict[str, Any] = {"max_pixels": max_pixels, "colour": colour}
    headers = [picture_header(path, **limits) for path in paths]
    most = most_common_header(headers)
    odd = [i for i, header in enumerate(headers) if not header.is_like(most)]
    if odd:
        n_most = len(paths) - len(odd)
        fix = fix_of_another(headers[odd[0]], most)
        raise TouchesError(
            f"Pictures must all have one size and depth, got {headers[odd[0]]} in "
            f"{paths[odd[0]]} ({n_most} of {len(paths)} are {most}). "
            f"{fix[0].upper()}{fix[1:]}."
        )
    return most


def fix_of_another(header: Header, usual: Header) -> str:
    """Return what to do with a picture of another size or depth than most."""
    if header.n_bits != usual.n_bits:
        return f"save it again with {usual.n_bits} bits, or take it out"
    return (
        "crop or pad it to that size (another proportion makes a disc an ellipse), or "
        "keep the two kinds in two sets of touches, not in sub-folders of one"
    )


def most_common_header(headers: Sequence[Header]) -> Header:
    """Return the most frequent header of the most frequent size and depth."""
    kinds = Counter(header._replace(format="") for header in headers)
    ((kind, _),) = kinds.most_common(1)
    ((most, _),) = Counter(h for h in headers if h.is_like(kind)).most_common(1)
    return most


def picture_header(path: Path, *, max_pixels: int, colour: bool) -> Header:
    """Return the header of one picture without decoding it."""
    try:
        start = _content(path, max_pixels, _MOST_HEADERS)
        try:
            header, _ = _read_header(start)
        except PictureError:
            header, _ = _read_header(_content(path, max_pixels))
        return header.checked(colour, max_pixels)
    except (OSError, PictureError) as error:
        raise refusal(path, error) from error


def checked_picture(
    path: Path, *, max_pixels: int, colour: bool
) -> tuple[Header, int, Array, bytes]:
    """Return header, orientation, levels and the bytes of one picture.

    The header is the file's, also of a picture in colour that is read in grey.
    Raises PictureError or OSError.
    """
    data = _content(path, max_pixels)
    header, orientation = _read_header(data)
    levels = _levels(data, header.checked(colour, max_pixels), orientation)
    return header, orientation, levels, data


def decode_picture(path: Path, header: Header) -> tuple[Array, bytes]:
    """Return the levels of a picture that has this header, and its bytes."""
    try:
        data = _content(path, header.n_rows * header.n_cols)
        now, orientation = _read_header(data)
        if not (now := now.checked(header.colour)).is_like(header):
            raise PictureError(f"{now} after {header}: the file changed meanwhile")
        return _levels(data, now, orientation), data
    except (OSError, PictureError) as error:
        raise refusal(path, error) from error


def decode_pictures(
    paths: Sequence[Path], header: Header, *, max_bytes: int, progress: bool | None
) -> tuple[Array, list[bytes]]:
    """Return the levels of pictures, (n_pictures, n_rows, n_cols[, 3]), and files."""
    shape = (len(paths), *header.shape)
    n_bytes = prod(shape) * header.dtype.itemsize
    refuse_large(f"{len(paths)} pictures of {header}", n_bytes, max_bytes)
    images = np.empty(shape, dtype=header.dtype)
    files = [b""] * len(paths)

    def fill(start: int) -> int:
        stop = min(start + _AT_ONCE, len(paths))
        for touch in range(start, stop):
            images[touch], files[touch] = decode_picture(paths[touch], header)
        return stop - start

    pool = ThreadPoolExecutor(n_cores())
    try:
        with Progress(len(paths), "Decoding pictures", progress) as bar:
            for n_done in pool.map(fill, range(0, len(paths), _AT_ONCE)):
                bar.advance(n_done)
    finally:
        pool.shutdown(cancel_futures=True)
    return images, files


def n_cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def refusal(what: object, error: OSError | PictureError) -> TouchesError:
    if isinstance(error, OSError):
        return TouchesError(
            f"{what} must be readable, got: {error.strerror or error}. "
            "Check the file and its permissions, or take it out of the folder."
        )
    fix = f"{error.fix[0].upper()}{error.fix[1:]}."
    return TouchesError(
        f"{what} must be a whole JPEG or PNG in grey or colour, got {error}. {fix}"
    )


def _content(path: Path, n_pixels: int, most: int = -1) -> bytes:
    """Read a file that is one (a pipe would block) and not absurdly large."""
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise PictureError("something that is not a file")
    if status.st_size > _MORE_BYTES + _BYTES_PER_PIXEL * n_pixels:
        raise PictureError(f"a file of {status.st_size} bytes")
    with path.open("rb") as file:
        return file.read(most)


def _read_header(data: bytes) -> tuple[Header, int]:
    """Return header (upright) and orientation; pixels are not looked at."""
    if not data:
        raise PictureError("an empty file")
    if not data.startswith((_PNG, _JPEG)):
        raise PictureError("a file that is neither JPEG nor PNG")
    is_png = data.startswith(_PNG)
    header, exif = _png_header(data) if is_png else _jpeg_header(data)
    orientation = _orientation(exif)
    return _turned(header, orientation), orientation


def _orientation(exif: bytes) -> int:
    """Return what an Exif block says; as stored where it is none or damaged."""
    if not exif:
        return _UPRIGHT
    from PIL import Image

    block = Image.Exif()
    try:
        block.load(exif)
        orientation = block.get(_ORIENTATION, _UPRIGHT)
    except Exception:  # Pillow raises half a dozen kinds here too
        return _UPRIGHT
    return orientation if orientation in _TURNS else _UPRIGHT


def _turned(header: Header, orientation: int) -> Header:
    """Return the header upright of a stored picture, or stored of an upright one."""
    if orientation < 5:
        return header
    return header._replace(n_rows=header.n_cols, n_cols=header.n_rows)


def _levels(data: bytes, header: Header, orientation: int) -> Array:
    """Return the levels of a whole picture, upright as `header` says."""
    if orientation == _UPRIGHT:
        return _stored_levels(data, header)
    stored = _stored_levels(data, _turned(header, orientation))
    return np.ascontiguousarray(_TURNS[orientation](stored))


def _stored_levels(data: bytes, header: Header) -> Array:
    """Return the levels of a whole picture, as its `header` says."""
    if header.format == "JPEG":
        return _jpeg_levels(data, header)
    for _ in _chunks(data):  # every checksum
        pass
    if data[25] == 3:  # a palette
        _refuse_missing_colours(data)
    levels = _png_levels(data, header)
    if levels is None or levels.shape != header.shape or levels.dtype != header.dtype:
        raise PictureError("a picture that cannot be decoded")
    return levels


def _jpeg_levels(data: bytes, header: Header) -> Array:
    import simplejpeg

    if _has_many_scans(data, header.n_rows * header.n_cols):
        raise PictureError(f"a JPEG of more than {_MOST_SCANS} scans")
    space = "RGB" if header.colour else "GRAY"
    try:
        levels: Array = simplejpeg.decode_jpeg(data, space)
    except ValueError as error:
        raise PictureError(f"a damaged or unusual JPEG ({error})") from error
    if levels.shape[:2] != header.shape[:2]:
        raise PictureError("a picture that cannot be decoded")
    return levels.reshape(header.shape)


def _png_levels(data: bytes, header: Header) -> Array | None:
    import cv2

    colour, see_through = header.colour, data[25] in _ALPHA
    kind = cv2.IMREAD_COLOR if colour else cv2.IMREAD_GRAYSCALE
    kind = cv2.IMREAD_UNCHANGED if see_through else kind | cv2.IMREAD_ANYDEPTH
    coded = np.frombuffer(data, np.uint8)
    try:
        levels = cv2.imdecode(coded, kind | cv2.IMREAD_IGNORE_ORIENTATION)
        if levels is None or not (see_through or colour):
            return levels
        if not see_through:
            return cv2.cvtColor(levels, cv2.COLOR_BGR2RGB)
        if levels.ndim != 3 or levels.shape[2] != 4:
            return None
        if levels[..., 3].min() < 2 ** (8 * levels.itemsize) - 1:
            raise PictureError("a picture with transparent parts")
        meant = cv2.COLOR_BGRA2RGB if colour else cv2.COLOR_BGRA2GRAY
        return cv2.cvtColor(levels, meant)
    except cv2.error:
        return None


def _segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield code and content of a JPEG's segments; previews lie within one."""
    place = _HEAD
    while marker := _MARKER.search(data, place):
        place = marker.end()
        if marker[1]:
            size = int.from_bytes(data[place : place + 2])
            yield marker[1][0], data[place + 2 : place + size]
            if size < 2:
                raise PictureError("a damaged JPEG (a segment without a length)")
            place += size


def _jpeg_header(data: bytes) -> tuple[Header, bytes]:
    """Return the header of a JPEG and its Exif block, which stand before a scan."""
    header, exif = None, b""
    for code, content in _segments(data):
        if code in (_SCAN, _END):
            break
        if code == _APP1 and content.startswith(_EXIF):
            exif = exif or content
        if code in _FRAMES and header is None:
            if code not in _HUFFMAN_FRAMES:
                raise PictureError("a lossless or arithmetic-coded JPEG")
            if len(content) < 6:
                raise PictureError(_CUT_SHORT)
            n_bits, n_rows, n_cols, n_channels = struct.unpack(">BHHB", content[:6])
            if n_bits != 8:
                raise PictureError(f"a {n_bits}-bit JPEG")
            if n_channels not in (1, 3):
                raise PictureError(f"a JPEG of {n_channels} channels (CMYK)")
            header = Header("JPEG", n_rows, n_cols, n_bits, n_channels > 1)
    else:
        raise PictureError(_CUT_SHORT)
    if header is None:
        raise PictureError("a damaged JPEG (its pixels come before its size)")
    return header, exif


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield kind and content of a PNG's chunks, then compare its checksum."""
    place, kind = len(_PNG), b""
    while kind != b"IEND":
        size, kind = (
            int.from_bytes(data[place : place + 4]),
            data[place + 4 : place + 8],
        )
        content = data[place + 8 : place + 8 + size]
        yield kind, content
        place += size + 12
        checksum = data[place - 4 : place]
        if len(checksum) < 4:
            raise PictureError(_CUT_SHORT)
        if zlib.crc32(content, zlib.crc32(kind)) != int.from_bytes(checksum):
            raise PictureError("a damaged PNG (another checksum)")


def _png_header(data: bytes) -> tuple[Header, bytes]:
    """Return the header of a PNG and its Exif block; only one plain picture is read."""
    chunks = dict(takewhile(lambda chunk: chunk[0] != b"IDAT", _chunks(data)))
    if next(iter(chunks), None) != b"IHDR":
        raise PictureError("a damaged PNG (it must begin with its size)")
    if b"acTL" in chunks:
        raise PictureError("an animated PNG")
    if b"tRNS" in chunks:
        raise PictureError("a PNG with a transparent colour")
    n_cols, n_rows, depth, kind = struct.unpack(">IIBB", data[16:26])
    n_bits = 16 if depth == 16 else 8
    header = Header("PNG", n_rows, n_cols, n_bits, kind not in _GREY)
    return header, chunks.get(b"eXIf", b"")


def _refuse_missing_colours(data: bytes) -> None:
    """Refuse pixels whose colour the palette does not have; OpenCV paints them."""
    from PIL.PngImagePlugin import PngImageFile

    with PngImageFile(BytesIO(data)) as image:
        n_colours = len(image.palette.palette) // 3 if image.palette else 0
        largest = int(np.asarray(image).max())
    if largest >= n_colours:
        raise PictureError(f"a PNG with colour {largest} of a palette of {n_colours}")


def _has_many_scans(data: bytes, n_pixels: int) -> bool:
    """Tell whether a JPEG of so many pixels has more than 100 scans and may take long.

    Each takes time over every pixel, whatever it says: some of nothing, a dozen bytes
    each, can keep a decoder busy for minutes. Cameras write one, programs that write
    progressive JPEGs at most some twenty.
    """
    if len(data) * n_pixels <= _FEW:
        return False
    pairs = (np.frombuffer(data, np.uint16, (len(data) - n) // 2, n) for n in (0, 1))
    if sum(np.count_nonzero(pair == _SCAN_MARKER) for pair in pairs) <= _MOST_SCANS:
        return False
    # Some may lie in a preview, or behind the end: follow the segments.
    n_scans = 0
    for code, _ in _segments(data):
        n_scans += code == _SCAN
        if code == _END or n_scans > _MOST_SCANS:
            break
    return n_scans > _MOST_SCANS
