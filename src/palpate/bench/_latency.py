"""From a camera's picture to the new belief over 50 objects, stage by stage.

A 640 x 480 JPEG in memory, 90 training touches of each of 50 objects, one core. The
pictures are drawn: domes with dents at random places; what is measured is time, not
recognition.
"""

import time

import numpy as np

from ..recognition import ObjectRecogniser
from ..touches import Touches, decode_bytes
from ._timing import Row, coded, drawn_dome, one_thread, row

STAGES = ("decode", "clean up", "encode", "likelihood", "belief")


def bench_latency(
    n_objects: int = 50,
    n_each: int = 90,
    n_asked: int = 200,
    presets: tuple[str, ...] = ("default", "corradi2015"),
) -> list[Row]:
    """Measure stages of single touches: median and 99th percentile of wall time, ms."""
    train = _draw(n_objects, n_each, seed=0)
    asked = _draw(n_objects, -(-n_asked // n_objects), seed=1)
    pictures = [coded(image) for image in asked.images[:n_asked]]
    rows = []
    with one_thread():
        for preset in presets:
            recogniser = ObjectRecogniser(preset).fit(train)
            for picture in pictures[:3]:
                _one(recogniser, picture)
            seconds = np.array([_one(recogniser, picture) for picture in pictures])
            stages = np.column_stack([seconds, seconds.sum(axis=1)]) * 1e3
            for name, ms in zip((*STAGES, "in all"), stages.T, strict=True):
                shown = f"{n_objects} objects {preset} {name}"
                late = float(np.quantile(ms, 0.99))
                known = {"p99_ms": late, "reason": "no peer does this"}
                rows.append(row(shown, float(np.median(ms)), "none", None, **known))
    return rows


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


def _draw(n_objects: int, n_each: int, seed: int) -> Touches:
    """Draw touches of objects whose dents differ in length and width."""
    rng = np.random.default_rng(seed)
    numbers = np.repeat(np.arange(n_objects), n_each)
    images = [
        drawn_dome(rng, (20.0 + 7 * (n % 10), 20.0 + 12 * (n // 10))) for n in numbers
    ]
    names = [f"object {n:02d}" for n in numbers]
    return Touches(np.stack(images), object=names, geometry="dome")
