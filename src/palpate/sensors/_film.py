"""Streams that were recorded: films, and frames that were read as touches."""

from collections.abc import Iterator
from pathlib import Path

from ..touches import Touches
from ._contract import Frame, SensorError

_MAX_PIXELS = 50_000_000


def film(path: str, colour: bool) -> Iterator[Frame]:
    """Yield the frames of a film one by one, in grey or in red, green and blue."""
    import cv2

    place = Path(path)
    capture = cv2.VideoCapture(str(place) if place.is_file() else "")
    try:
        n_cols, n_rows, rate_hz, counted = map(capture.get, (3, 4, 5, 7))
        if not 0 < n_cols * n_rows <= _MAX_PIXELS or not capture.grab():
            raise SensorError(
                f"{place} must be a film that OpenCV decodes, got "
                f"{'another file' if place.is_file() else 'no file there'}. Convert it "
                "(AV1 is not decoded), for example to FFV1 in .mkv, which keeps levels."
            )
        to = cv2.COLOR_BGR2RGB if colour else cv2.COLOR_BGR2GRAY
        number, more = 0, True
        while more and (arrived := capture.retrieve())[0]:
            picture = cv2.cvtColor(arrived[1], to)
            yield Frame(picture, number / (rate_hz or 25.0), number)
            number, more = number + 1, capture.grab()
        if number < counted - 2:  # some kinds of file only estimate their count
            raise SensorError(
                f"{place} must hold {counted:.0f} frames, got {number}: it ends early. "
                "Copy or record it again."
            )
    finally:
        capture.release()


def frames_of(touches: Touches) -> Iterator[Frame]:
    """Yield images as frames, at their times where these are known."""
    times = touches.columns.get("time_s", range(len(touches)))
    for number, (image, time_s) in enumerate(zip(touches.images, times, strict=True)):
        yield Frame(image, float(time_s), number)
