"""Decoding many pictures of one size, on all cores, into one array."""

import os
import stat
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from .._progress import Progress
from ._errors import TouchesError
from ._pictures import Header, PictureError, grey_levels, read_header

# Room for comments, colour profiles and previews beside the pixels themselves.
_MORE_BYTES = 32 * 2**20
_BYTES_PER_PIXEL = 8
_AT_ONCE = 8


def decode_bytes(data: bytes, *, max_pixels: int = 50_000_000) -> NDArray[Any]:
    """Return the grey levels of a JPEG or PNG in memory, (n_rows, n_cols).

    Parameters
    ----------
    data : bytes
        The whole file.
    max_pixels : int
        Larger pictures are refused before they are decoded.

    Raises
    ------
    TouchesError
        It is no such picture, too large, cut short or altered.
    """
    try:
        header = read_header(BytesIO(data))
        if header.n_rows * header.n_cols > max_pixels:
            raise TouchesError(
                f"A picture must have at most {max_pixels} pixels, got {header}. "
                "Make it smaller, or raise max_pixels if you trust it."
            )
        return grey_levels(data, header)
    except PictureError as error:
        raise TouchesError(f"A picture must be a JPEG or PNG, got {error}.") from error


def common_header(paths: Sequence[Path], *, max_pixels: int) -> Header:
    """Return the header that all pictures share; the error names who differs."""
    headers = [picture_header(path, max_pixels=max_pixels) for path in paths]
    (most, n_most), *others = Counter(headers).most_common()
    if others:
        odd = next(i for i, header in enumerate(headers) if header != most)
        raise TouchesError(
            f"Pictures must all have one size and format, got {headers[odd]} in "
            f"{paths[odd]} ({n_most} of {len(paths)} are {most}). "
            "Convert it, or keep the two kinds in folders of their own."
        )
    return most


def picture_header(path: Path, *, max_pixels: int) -> Header:
    """Return the header of one picture without decoding it."""
    try:
        with _opened(path, max_pixels) as file:
            header = read_header(file)
    except (OSError, PictureError) as error:
        raise refusal(path, error) from error
    if header.n_rows * header.n_cols > max_pixels:
        raise TouchesError(
            f"{path} must have at most {max_pixels} pixels, got {header}. "
            "Make it smaller, or raise max_pixels if you trust the file."
        )
    return header


def decode_picture(path: Path, header: Header) -> NDArray[Any]:
    """Return the grey levels of one picture that must have this header."""
    try:
        with _opened(path, header.n_rows * header.n_cols) as file:
            return grey_levels(file.read(), header)
    except (OSError, PictureError) as error:
        raise refusal(path, error) from error


def decode_pictures(
    paths: Sequence[Path], header: Header, *, max_bytes: int, progress: bool | None
) -> NDArray[Any]:
    """Return the grey levels of all pictures, (n_pictures, n_rows, n_cols)."""
    shape = (len(paths), header.n_rows, header.n_cols)
    n_bytes = shape[0] * shape[1] * shape[2] * header.dtype.itemsize
    if n_bytes > max_bytes:
        raise TouchesError(
            f"{len(paths)} pictures of {header} must take at most {max_bytes} bytes, "
            f"got {n_bytes}. Read fewer or smaller ones, or raise max_bytes."
        )
    images = np.empty(shape, dtype=header.dtype)

    def fill(start: int) -> int:
        stop = min(start + _AT_ONCE, len(paths))
        for touch in range(start, stop):
            images[touch] = decode_picture(paths[touch], header)
        return stop - start

    pool = ThreadPoolExecutor(n_cores())
    try:
        with Progress(len(paths), "Decoding pictures", progress) as bar:
            for n_done in pool.map(fill, range(0, len(paths), _AT_ONCE)):
                bar.advance(n_done)
    finally:
        pool.shutdown(cancel_futures=True)
    return images


def n_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def refusal(path: Path, error: OSError | PictureError) -> TouchesError:
    """Word what was wrong with one picture."""
    if isinstance(error, OSError):
        return TouchesError(
            f"{path} must be readable, got: {error.strerror or error}. "
            "Check the file and its permissions, or take it out of the folder."
        )
    return TouchesError(
        f"{path} must be a whole JPEG or PNG in grey or colour, got {error}. "
        "Save it again as 8-bit JPEG or 8- or 16-bit PNG, or take it out."
    )


def _opened(path: Path, n_pixels: int) -> IO[bytes]:
    """Open a file that is one (a pipe would block) and not absurdly large."""
    found = path.stat()
    if not stat.S_ISREG(found.st_mode):
        raise PictureError("something that is not a file")
    if found.st_size > _MORE_BYTES + _BYTES_PER_PIXEL * n_pixels:
        raise PictureError(f"a file of {found.st_size} bytes")
    return path.open("rb")
