"""How pieces of the tactile image depend on load and cover (Liu 2014, Figs 5 and 6).

The paper looks at images of a bar: light loads leave them incomplete, heavy ones
distort them, thin covers break them up, thick ones blur them. Here the same is
counted over all presses.
"""

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..simulation import find_parts
from ..touches import Touches
from ._liu2014_jobs import Job, curve_jobs
from ._liu2014_plan import (
    PAPER_COVER_MM,
    PAPER_LOAD_KGF,
    PAPER_PARTITIONS,
    Liu2014Plan,
)
from ._liu2014_touches import encode, simulated_presses

_SUBPIXELS = 16  # for the share of a pixel that a part covers


def condition_jobs(plan: Liu2014Plan) -> Iterator[Job]:
    """Press all parts at every load, then under every cover."""
    for load in plan.loads_kgf:
        yield from _at(plan, "Fig. 5", load, PAPER_COVER_MM)
    for cover in plan.covers_mm:
        yield from _at(plan, "Fig. 6", PAPER_LOAD_KGF, cover)


def count_pieces(binary: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the number of 8-connected pieces of each image, shape (n_touches,)."""
    images = binary.astype(np.uint8)
    found = [cv2.connectedComponents(image, connectivity=8)[0] - 1 for image in images]
    return np.array(found, dtype=np.intp)


def overlap(binary: NDArray[np.bool_], footprint: NDArray[np.bool_]) -> NDArray:
    """Return the pixels in both as a share of those in either, shape (n_touches,)."""
    both = (binary & footprint).sum(axis=(1, 2))
    either = (binary | footprint).sum(axis=(1, 2))
    return both / np.maximum(either, 1)


def footprints(touches: Touches, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return where the parts really lay: pixels that are covered at least by half."""
    pitch = float(touches.whole["set_pitch_mm"])
    n_rows, n_cols = touches.images.shape[1:]
    fine = (shape[0] * _SUBPIXELS, shape[1] * _SUBPIXELS)
    scale = np.array([fine[1] / (n_cols * pitch), fine[0] / (n_rows * pitch)])
    middle = np.array([n_cols, n_rows]) * pitch / 2
    covered = np.zeros((len(touches), *shape), dtype=bool)
    position, angle = touches.columns["position_mm"], touches.columns["angle_deg"]
    for touch, number in enumerate(touches.columns["part"]):
        (part,) = find_parts(int(number))
        x, y = position[touch].tolist()
        loops = part.placed(x, y, float(angle[touch]))
        corners = [np.rint((loop + middle) * scale).astype(np.int32) for loop in loops]
        drawn = np.zeros(fine, dtype=np.uint8)
        # Even-odd filling leaves the holes empty.
        cv2.fillPoly(drawn, corners, 1)
        blocks = drawn.reshape(shape[0], _SUBPIXELS, shape[1], _SUBPIXELS)
        covered[touch] = blocks.mean(axis=(1, 3)) >= 0.5
    return covered


def _at(plan: Liu2014Plan, table: str, load: float, cover: float) -> Iterator[Job]:
    touches = simulated_presses(plan, load, cover)
    encoded = encode(touches.images, PAPER_PARTITIONS, plan.n)
    whole = encode(touches.images, 1, 1).binary
    pieces = count_pieces(whole)
    truth = footprints(touches, whole.shape[1:])
    condition = f"{load:g} kgf" if table == "Fig. 5" else f"cover {cover:g} mm"
    row: dict[str, Any] = {
        "table": table,
        "condition": condition,
        "classes": "all",
        "load_kgf": load,
        "cover_mm": cover,
        "pieces": float(pieces.mean()),
        "in_pieces": 100 * float((pieces > 1).mean()),
        "pieces_2x2": float(count_pieces(encoded.binary).mean()),
        "overlap": 100 * float(overlap(whole, truth).mean()),
        "overlap_2x2": 100 * float(overlap(encoded.binary, truth).mean()),
    }
    yield from curve_jobs(plan, touches, encoded, row)
