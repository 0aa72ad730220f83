"""The presses of the Liu 2014 study: simulated, or real ones re-posed; their features.

Pieces of the cleaned image, and how far it agrees with where the part lay, tell how
load and cover break images up or blur them.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..._types import Floats
from ...encodings import FourierDescriptors, ShapeGeometry
from ...images import ArrayCleanUp, repose
from ...simulation import PressureArray, find_parts, simulate_presses
from ...touches import Touches
from .._touches import Archive, Codes
from ._plan import PAPER_COVER_MM, PAPER_LOAD_KGF, Liu2014Plan

REAL = Archive(
    Path("taxel10x10") / "taxel10x10.npz", "real presses", "github.com/aslepyan/SPTS"
)
_SUBPIXELS = 16  # for the share of a pixel that a part covers
SHIFT_PX = 2.0
GAIN_RANGE = (0.8, 1.2)


@dataclass(frozen=True)
class Encoded:
    """Cleaned images, their two geometric features and Fourier descriptors."""

    binary: NDArray[np.bool_]
    geometry: Floats
    fourier: Floats

    def features(self, name: str, n: int) -> Floats:
        """Return "FD", "GE" or "FD+GE" with the first n descriptors."""
        if name == "GE":
            return self.geometry
        descriptors = self.fourier[:, :n]
        if name == "FD":
            return descriptors
        return np.hstack([self.geometry, descriptors])


def encode(images: NDArray[Any], n_partitions: int, n: int) -> Encoded:
    """Clean the images and encode them by the paper's layers 1 and 2."""
    binary = ArrayCleanUp(n_partitions=n_partitions).fit_transform(images)
    return Encoded(
        binary,
        ShapeGeometry().fit_transform(binary),
        FourierDescriptors(n).fit_transform(binary),
    )


def simulated_presses(
    plan: Liu2014Plan,
    load_kgf: float = PAPER_LOAD_KGF,
    cover_mm: float = PAPER_COVER_MM,
) -> Touches:
    """Press the plan's parts; the same places and angles for every load and cover."""
    options: dict[str, Any] = {
        "array": PressureArray(cover_mm=cover_mm),
        "load_kgf": load_kgf,
        "random_state": plan.seed,
    }
    return simulate_presses(plan.parts, plan.n_presses, **{**options, **plan.presses})


def reposed_presses(touches: Touches, seed: int) -> Touches:
    """Turn presses by any angle, shift them, and take their strength away.

    Shifts are even up to 2 pixels along rows and columns. Turned corners continue
    the nearest taxel, as an array without contact there would. The total of each
    re-posed press becomes 1, times a gain drawn evenly from 0.8 to 1.2.
    """
    rng = np.random.default_rng([seed, 1])
    n_touches = len(touches)
    images = repose(
        touches.images,
        rng.uniform(0, 360, n_touches),
        rng.uniform(-SHIFT_PX, SHIFT_PX, (n_touches, 2)),
        edges="nearest",
    )
    total = np.abs(images).sum(axis=(1, 2))
    gain = rng.uniform(*GAIN_RANGE, n_touches)
    strength = np.where(total > 0, total, 1.0) / gain
    return Touches(images / strength[:, None, None], object=touches.object)


def count_pieces(binary: NDArray[np.bool_]) -> Codes:
    """Return the number of 8-connected pieces of each image, shape (n_touches,)."""
    images = binary.astype(np.uint8)
    found = [cv2.connectedComponents(image, connectivity=8)[0] - 1 for image in images]
    return np.array(found, dtype=np.intp)


def overlap(binary: NDArray[np.bool_], footprint: NDArray[np.bool_]) -> Floats:
    """Return the pixels in both as a share of those in either, shape (n_touches,)."""
    both = (binary & footprint).sum(axis=(1, 2))
    either = (binary | footprint).sum(axis=(1, 2))
    share: Floats = both / np.maximum(either, 1)
    return share


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
