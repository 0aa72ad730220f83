"""How long encoding, learning and recognising take, beside the paper's MATLAB code."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from sklearn.decomposition import PCA
from threadpoolctl import threadpool_limits

from ..classifiers import KernelDensityBayes
from ..touches import Touches
from ._corradi2015_encodings import Encoder, Floats
from ._corradi2015_methods import principal_components
from ._corradi2015_plan import N_KNOWN, PAPER_MS

_REPEATS, _ENCODED = 15, 60
SIZES = (600, 1200)


def timing_rows(touches: Touches, data: str) -> list[dict[str, Any]]:
    """Return CPU milliseconds on one thread, medians, one touch at a time."""
    with threadpool_limits(limits=1):
        some = touches[np.arange(min(len(touches), max(SIZES)))]
        encoder = Encoder(some, bags=False)
        discs = encoder.crop.transform(some.images)
        values = encoder.moments.fit(discs).transform(discs)
        rows = _encoding(encoder, some, discs)
        for size in SIZES:
            if len(values) >= size:
                rows += _learning(values[:size])
    return [{**row, "data": data, "table": "timings", "unit": "ms"} for row in rows]


def _encoding(encoder: Encoder, touches: Touches, discs: Any) -> list[dict[str, Any]]:
    shape = " x ".join(map(str, touches.images.shape[1:]))
    moments, side = encoder.moments, discs.shape[1]

    def whole(i: int) -> None:
        moments.transform(encoder.crop.transform(touches.images[i : i + 1]))

    def alone(i: int) -> None:
        moments.transform(discs[i : i + 1])

    paper = PAPER_MS["encode", 0]
    return [
        _row(f"Zernike moments of a disc, {side} x {side}", paper, alone, _ENCODED),
        _row(f"rim, disc and moments of an image, {shape}", None, whole, _ENCODED),
    ]


def _learning(values: Floats) -> list[dict[str, Any]]:
    size = len(values)
    codes = np.arange(size) % N_KNOWN

    def learn(_: int) -> tuple[PCA, KernelDensityBayes]:
        principal = principal_components(values)
        model = KernelDensityBayes().fit(principal.transform(values), codes)
        return principal, model

    principal, model = learn(0)

    def recognise(i: int) -> None:
        model.log_likelihood(principal.transform(values[i : i + 1]))

    paper = [PAPER_MS[what, size] for what in ("learn", "recognise")]
    return [
        _row(f"learn {size} touches", paper[0], learn, _REPEATS),
        _row(f"recognise a touch among {size}", paper[1], recognise, _ENCODED),
    ]


def _row(
    name: str, paper: float | None, work: Callable[[int], object], times: int
) -> dict[str, Any]:
    spent = []
    work(0)
    for i in range(times):
        start = time.process_time()
        work(i)
        spent.append(1e3 * (time.process_time() - start))
    return {
        "name": f"{name}, ms",
        "paper": paper,
        "ours": float(np.median(spent)),
        "sd": float(np.std(spent, ddof=1)),
    }
