"""From a 640 x 480 picture to a vector, stage by stage, for every encoding.

A touch is decoded, its rim found, its disc cut and standardised, and the disc
encoded. CPU time on one thread for one touch at a time, as a robot has them.
"""

import os
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..encodings import ENCODINGS, encoder_named
from ..images import DomeCrop, crop_discs, standardise_discs
from ._timing import cpu_ms, one_thread, row

_N_TOUCHES = 32
_FRAME = (480, 640)
_SIZE = 128


def bench_encodings(
    data: Path | None, *, seconds: float = 0.3, names: list[str] | None = None
) -> list[dict[str, Any]]:
    """Time each stage on its own, then each encoding.

    Parameters
    ----------
    data : Path or None
        The folder of real touches, of whose `bathtip/originals` a few are read;
        None draws as many pictures of the same size.
    seconds : float, default=0.3
        CPU time to spend on each figure.
    names : list of str, optional
        Encodings; by default all that `encoder_named` knows.

    Returns
    -------
    list of dict
        Rows of the stages, then of the encodings: `ours_ms` of the encoding alone;
        `touch_ms` from decoded array to vector without finding the rim (crop,
        standardise, encode); `share_decode`, `share_rim`, `share_crop` and
        `share_encode`, of everything in per cent. `peer` is another package that
        encodes the same disc.
    """
    coded = _pictures(data)
    kind = "drawn" if data is None else "real"
    with one_thread():
        stages, discs = _stages(coded, seconds)
        rows = [
            row(f"640 x 480 {kind} {name}", ms, "", None, reason="a stage of ours")
            for name, ms in stages.items()
        ]
        for name in ENCODINGS if names is None else names:
            rows.append(_row(name, kind, discs, stages, seconds))
    return rows


def bench_encodings_here() -> list[dict[str, Any]]:
    """Measure on the pictures in PALPATE_DATA where it is set, else on drawn ones."""
    data = os.environ.get("PALPATE_DATA")
    return bench_encodings(Path(data) if data else None)


def _stages(
    coded: list[NDArray[np.uint8]], seconds: float
) -> tuple[dict[str, float], NDArray[np.float32]]:
    """Milliseconds of each stage before the encoding, and the discs."""
    images = np.stack([_decoded(one) for one in coded])
    crop = DomeCrop(_SIZE).fit(images)
    rims = crop.rims(images)
    radius, size = crop.disc_radius_, crop.size_
    discs = crop_discs(images, rims, radius, size)
    stages: dict[str, Callable[[int], object]] = {
        "decoding": lambda i: _decoded(coded[i]),
        "rim finding": lambda i: crop.rims(images[i : i + 1]),
        "cropping": lambda i: crop_discs(
            images[i : i + 1], rims[i : i + 1], radius, size
        ),
        "standardising": lambda i: standardise_discs(discs[i : i + 1]),
    }
    times = {name: _each(stage, seconds) for name, stage in stages.items()}
    return times, standardise_discs(discs)


def _decoded(coded: NDArray[np.uint8]) -> NDArray[Any]:
    image = cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ValueError("Pictures must be decodable, got one that is not.")
    return image


def _row(
    name: str,
    kind: str,
    discs: NDArray[np.float32],
    stages: dict[str, float],
    seconds: float,
) -> dict[str, object]:
    encoder = encoder_named(name).fit(discs)
    encode = _each(lambda i: encoder.transform(discs[i : i + 1]), seconds)
    crop = stages["cropping"] + stages["standardising"]
    parts = {
        "decode": stages["decoding"],
        "rim": stages["rim finding"],
        "crop": crop,
        "encode": encode,
    }
    whole = sum(parts.values())
    shares = {f"share_{part}": 100 * ms / whole for part, ms in parts.items()}
    extra: dict[str, object] = {"touch_ms": crop + encode, **shares}
    label = f"640 x 480 {kind} encoding {name}"
    peer, peer_ms, reason = _peer(name, discs, seconds)
    if peer_ms is None:
        extra["reason"] = reason
    return row(label, encode, peer, peer_ms, **extra)


def _peer(
    name: str, discs: NDArray[np.float32], seconds: float
) -> tuple[str, float | None, str]:
    """The same encoding by another package, on discs of positive levels."""
    if name == "hu":
        ms = _each(lambda i: cv2.HuMoments(cv2.moments(discs[i])), seconds)
        return "OpenCV", ms, ""
    if name != "zernike":
        return "", None, "no package has it"
    if find_spec("mahotas") is None:
        return "mahotas", None, "mahotas is not installed: pip install palpate[bench]"
    from mahotas.features import zernike_moments

    side = discs.shape[1]
    centre = ((side - 1) / 2, (side - 1) / 2)
    lit = discs - discs.min() + 1
    ms = _each(lambda i: zernike_moments(lit[i], side / 2, 15, cm=centre), seconds)
    return "mahotas", ms, ""


def _each(function: Callable[[int], object], seconds: float) -> float:
    """Milliseconds for one touch, taking turns among all."""
    return (
        cpu_ms(lambda: [function(i) for i in range(_N_TOUCHES)], seconds) / _N_TOUCHES
    )


def _pictures(data: Path | None) -> list[NDArray[np.uint8]]:
    """Coded JPEGs: real ones spread over the objects, or drawn ones."""
    if data is None:
        return [_drawn(seed) for seed in range(_N_TOUCHES)]
    found = sorted((data / "bathtip" / "originals").glob("*/*/*.jpg"))
    if len(found) < _N_TOUCHES:
        raise ValueError(
            f"data must hold {_N_TOUCHES} pictures in bathtip/originals, got "
            f"{len(found)} in {data}. Unset PALPATE_DATA to draw some."
        )
    spread = np.linspace(0, len(found) - 1, _N_TOUCHES).astype(int)
    return [np.frombuffer(found[i].read_bytes(), np.uint8) for i in spread]


def _drawn(seed: int) -> NDArray[np.uint8]:
    """A dark disc with a smooth dent before a bright surround, as JPEG."""
    rng = np.random.default_rng(seed)
    rows, cols = np.mgrid[: _FRAME[0], : _FRAME[1]]
    row_0, col_0 = rng.uniform(150, 330, size=2)
    dent = np.exp(-((rows - row_0) ** 2 + (cols - col_0) ** 2) / 5000)
    inside = np.hypot(rows - 235, cols - 250) < 220
    levels = np.where(inside, 60 + 90 * dent, 245) + rng.normal(scale=3, size=_FRAME)
    grey = levels.clip(0, 255).astype(np.uint8)
    return np.asarray(cv2.imencode(".jpg", grey)[1]).ravel()
