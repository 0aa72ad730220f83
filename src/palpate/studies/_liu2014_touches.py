"""The touches of the Liu 2014 study: simulated presses and re-posed real ones."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..encodings import FourierDescriptors, ShapeGeometry
from ..images import ArrayCleanUp, repose
from ..simulation import PressureArray, simulate_presses
from ..touches import Touches
from ._liu2014_plan import PAPER_COVER_MM, PAPER_LOAD_KGF, Liu2014Plan
from ._recorded import recorded_touches

Floats = NDArray[np.float64]

ARCHIVE = Path("taxel10x10") / "taxel10x10.npz"
SOURCE = "github.com/aslepyan/SPTS"
SHIFT_PX = 2.0
GAIN_RANGE = (0.8, 1.2)


@dataclass(frozen=True)
class Encoded:
    """A set of touches with the paper's features.

    `binary` are the cleaned images; `geometry` the two geometric features;
    `fourier` the Fourier descriptors.
    """

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


def real_presses(data: str | Path | None) -> Touches | str:
    """Return the recorded presses, or the sentence that says why there are none."""
    return recorded_touches(data, ARCHIVE, "real presses", SOURCE)
