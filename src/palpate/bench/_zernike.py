"""Zernike moments beside mahotas, centrosome and a dense basis, one thread.

Every peer gets what it can prepare beforehand for free: centrosome its polynomials,
the dense basis its matrix of the taxels inside the disc. mahotas prepares nothing
between images. Neither package takes several images at once, so beside a batch stands
their time for one image. mahotas drops taxels that are not positive: all are here.
"""

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from ..encodings import ZernikeMoments, zernike_degrees, zernike_values
from ._timing import cpu_ms, one_thread, row

_TYPES = ("float64", "float32", "uint8")
Encode = Callable[[NDArray], NDArray]


def bench_zernike(
    *,
    size: int = 300,
    order: int = 15,
    n_touches: int = 64,
    seconds: float = 0.5,
    random_state: int = 0,
) -> list[dict[str, object]]:
    """Time the encoding of square images, alone and in a batch.

    Parameters
    ----------
    size : int, default=300
        Side of the images, in taxels; the disc is inscribed.
    order : int, default=15
    n_touches : int, default=64
        Images in a batch.
    seconds : float, default=0.5
        CPU time to spend on each figure.
    random_state : int, default=0

    Returns
    -------
    list of dict
        Rows with `name`, `ours_ms`, `peer`, `peer_ms`, `ratio`; milliseconds of CPU
        time for one image. Where a peer is not installed, `ratio` is None and
        `reason` says so. All work in float64 whatever the type of the images.
    """
    rng = np.random.default_rng(random_state)
    grey = rng.integers(1, 256, size=(n_touches, size, size), dtype=np.uint8)
    rows = []
    with one_thread():
        peers = _peers(size, order)
        for dtype in _TYPES:
            images = grey.astype(dtype)
            for some, batch in ((images[:1], "single"), (images, f"batch {n_touches}")):
                theirs = {
                    peer: _time(encode, some[:limit], seconds) if encode else None
                    for peer, (encode, limit) in peers.items()
                }
                for method in ("sample", "exact"):
                    encoder = ZernikeMoments(order, method=method).fit(some[:1])
                    ours = _time(encoder.transform, some, seconds)
                    name = f"{size} x {size} {dtype} {method} {batch}"
                    rows += [_row(name, ours, *peer) for peer in theirs.items()]
    return rows


def _time(encode: Encode, images: NDArray, seconds: float) -> float:
    """Milliseconds for one image."""
    return cpu_ms(lambda: encode(images), seconds) / len(images)


def _row(
    name: str, ours_ms: float, peer: str, peer_ms: float | None
) -> dict[str, object]:
    if peer_ms is None:
        reason = f"{peer} is not installed: pip install palpate[bench]"
        return row(name, ours_ms, peer, None, reason=reason)
    return row(name, ours_ms, peer, peer_ms)


def _peers(size: int, order: int) -> dict[str, tuple[Encode | None, int | None]]:
    """How each peer encodes, None where absent, and how many images it takes."""
    makers = {"mahotas": _mahotas, "centrosome": _centrosome}
    peers: dict[str, tuple[Encode | None, int | None]] = {
        name: (make(size, order) if find_spec(name) else None, 1)
        for name, make in makers.items()
    }
    return peers | {"dense basis": (dense_basis(size, order), None)}


def _mahotas(size: int, order: int) -> Encode:
    from mahotas.features import zernike_moments

    centre = ((size - 1) / 2, (size - 1) / 2)
    return lambda images: zernike_moments(images[0], size / 2, order, cm=centre)


def _centrosome(size: int, order: int) -> Encode:
    from centrosome.zernike import construct_zernike_polynomials

    x, y, inside = _disc(size)
    degrees = np.array(zernike_degrees(order))
    values = construct_zernike_polynomials(x[inside], y[inside], degrees)
    scale = (degrees[:, 0] + 1) / np.pi * (2 / size) ** 2

    def encode(images: NDArray) -> NDArray:
        levels = images[0][inside].astype(np.float64)
        return np.abs((levels[:, None] * values).sum(axis=0)) * scale

    return encode


def dense_basis(size: int, order: int) -> Encode:
    """One matrix product with the polynomials at all taxel centres in the disc."""
    x, y, inside = _disc(size)
    degrees = np.array(zernike_degrees(order))
    taxels = np.flatnonzero(inside)
    waves = degrees[:, 1] > 0
    values = np.stack(list(zernike_values(order, x[inside], y[inside])), axis=1)
    basis = np.concatenate([values.real, values.imag[:, waves]], axis=1)
    scale = (degrees[:, 0] + 1) / np.pi * (2 / size) ** 2

    def encode(images: NDArray) -> NDArray:
        levels = images.reshape(len(images), -1).take(taxels, axis=1)
        parts = levels.astype(np.float64, copy=False) @ basis
        sizes = np.abs(parts[:, : len(degrees)])
        sizes[:, waves] = np.hypot(sizes[:, waves], parts[:, len(degrees) :])
        return sizes * scale

    return encode


def _disc(
    size: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Taxel centres x and y, in radii, and which lie in the inscribed disc."""
    side = (2 * np.arange(size) + 1 - size) / size
    x, y = np.meshgrid(side, side)
    return x, y, np.hypot(x, y) <= 1
