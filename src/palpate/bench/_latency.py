"""From a camera's picture to the new belief over 50 objects, stage by stage.

A 640 x 480 JPEG in memory, 90 training touches of each of 50 objects, one core. The
pictures are drawn: discs with a rim at a wandering place and random dents; what is
measured is time, not recognition.
"""

import time
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..recognition import ObjectRecogniser
from ..touches import Touches, decode_bytes
from ._timing import one_thread, row

N_OBJECTS, N_EACH, N_ASKED = 50, 90, 200
STAGES = ("decode", "clean up", "encode", "likelihood", "belief")


def bench_latency(
    n_objects: int = N_OBJECTS,
    n_each: int = N_EACH,
    n_asked: int = N_ASKED,
    presets: tuple[str, ...] = ("default", "corradi2015"),
) -> list[dict[str, Any]]:
    """Measure one touch at a time, median and 99th percentile of wall time (ms).

    Returns
    -------
    list of dict
        A row per preset and stage, and one for the whole: `ours_ms` is the median,
        `p99_ms` the 99th percentile. There is no peer.
    """
    train = _draw(n_objects, n_each, seed=0, shape=(480, 640))
    asked = _draw(n_objects, -(-n_asked // n_objects), seed=1, shape=(480, 640))
    pictures = [_jpeg(image) for image in asked.images[:n_asked]]
    rows = []
    with one_thread():
        for preset in presets:
            recogniser = ObjectRecogniser(preset).fit(train)
            rows += _rows(recogniser, pictures, preset)
    return rows


def _rows(
    recogniser: ObjectRecogniser, pictures: list[bytes], preset: str
) -> list[dict[str, Any]]:
    for picture in pictures[:3]:
        _one(recogniser, picture)
    seconds = np.array([_one(recogniser, picture) for picture in pictures])
    stages = np.column_stack([seconds, seconds.sum(axis=1)]) * 1e3
    reason = "no peer does this"
    return [
        row(
            f"{len(recogniser.classes_)} objects {preset} {name}",
            float(np.median(ms)),
            "none",
            None,
            p99_ms=float(np.quantile(ms, 0.99)),
            reason=reason,
        )
        for name, ms in zip((*STAGES, "in all"), stages.T, strict=True)
    ]


def _one(recogniser: ObjectRecogniser, picture: bytes) -> list[float]:
    """Seconds of each stage for one touch, the second of its episode."""
    encoder = recogniser.encoder_
    belief = recogniser.start()
    clock = time.perf_counter
    times = [clock()]
    touch = Touches(decode_bytes(picture)[np.newaxis])
    times.append(clock())
    cleaned = encoder.clean(touch)
    recogniser.contact_.flags(touch, cleaned)
    times.append(clock())
    features = encoder.encode(cleaned)
    times.append(clock())
    log_likelihood = recogniser.classifier_.log_likelihood(features)
    times.append(clock())
    belief.update_from_log_likelihood(log_likelihood, features=features)
    belief.decide()
    times.append(clock())
    return np.diff(times).tolist()


def _draw(n_objects: int, n_each: int, seed: int, shape: tuple[int, int]) -> Touches:
    """Draw dark discs on white with a dent of the object's own shape."""
    rng = np.random.default_rng(seed)
    names, images = [], []
    for number in range(n_objects):
        for _ in range(n_each):
            images.append(_picture(number, rng, shape))
            names.append(f"object {number:02d}")
    return Touches(np.stack(images), object=names, geometry="dome")


def _picture(
    number: int, rng: np.random.Generator, shape: tuple[int, int]
) -> NDArray[np.uint8]:
    n_rows, n_cols = shape
    image = np.full(shape, 250, np.uint8)
    row, col = n_rows / 2 + rng.normal(0, 4), n_cols / 2 + rng.normal(0, 4)
    middle = (round(col), round(row))
    cv2.circle(image, middle, int(0.45 * n_rows), 90, -1)
    # A kind of dent for each object: how many corners, how long, how wide.
    size = (
        (0.05 + 0.02 * (number % 10)) * n_rows,
        (0.05 + 0.03 * (number // 10)) * n_rows,
    )
    angle = rng.uniform(0, 180)
    cv2.ellipse(image, (middle, size, angle), 170, -1)
    blurred = cv2.GaussianBlur(image, (0, 0), 3).astype(np.float32)
    noisy = blurred + rng.normal(0, 3, shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


def _jpeg(image: NDArray[np.uint8]) -> bytes:
    return bytes(cv2.imencode(".jpg", image)[1])
