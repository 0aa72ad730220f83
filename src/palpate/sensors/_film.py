"""Streams that were recorded: films, and frames that were read as touches."""

import math
from collections.abc import Iterator
from os import PathLike
from pathlib import Path

from ..touches import Touches
from ._contract import Frame, SensorError

_MAX_PIXELS = 50_000_000


def film(path: str | PathLike[str], colour: bool) -> Iterator[Frame]:
    """Yield the frames of a film, decoded one by one, in grey or red, green and blue.

    Raises
    ------
    SensorError
        It is no film that OpenCV decodes, or ends before the frames that it counts.
    """
    import cv2

    place = Path(path)
    capture = cv2.VideoCapture(str(place)) if place.is_file() else None
    try:
        counted = 0 if capture is None else int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        size = 0.0
        if capture is not None:
            sides = cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT
            size = math.prod(map(capture.get, sides))
        if capture is None or not 0 < size <= _MAX_PIXELS or not capture.grab():
            raise SensorError(
                f"{place} must be a film that OpenCV decodes, got "
                f"{'another file' if place.is_file() else 'no file there'}. Convert it "
                "(AV1 is not decoded), for example to FFV1 in .mkv, which keeps levels."
            )
        rate_hz = capture.get(cv2.CAP_PROP_FPS) or 25.0
        to = cv2.COLOR_BGR2RGB if colour else cv2.COLOR_BGR2GRAY
        number = 0
        while True:
            arrived, picture = capture.retrieve()
            if arrived:
                yield Frame(cv2.cvtColor(picture, to), number / rate_hz, number)
                number += 1
            if not arrived or not capture.grab():
                break
        # A count is an estimate in some kinds of file: a frame or two are no damage.
        if number < counted - 2:
            raise SensorError(
                f"{place} must hold {counted} frames, got {number}: it ends early. "
                "Copy or record it again."
            )
    finally:
        if capture is not None:
            capture.release()


def frames_of(touches: Touches) -> Iterator[Frame]:
    """Yield images as frames, in the order of their times, or as they are."""
    times = touches.columns.get("time_s", range(len(touches)))
    for number, (image, time_s) in enumerate(zip(touches.images, times, strict=True)):
        yield Frame(image, float(time_s), number)
