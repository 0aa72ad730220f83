"""The touches of the Corradi 2015 study, known and unseen, and their features.

Each feature is computed once for all partitions. What it learns from touches (principal
components, clusters) is learnt later, from the training touches of each partition. Only
the disc that is cut out of the images belongs to the sensor: its rim is that of the
no-contact frame.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from sklearn.base import clone

from ..._types import Floats
from ...evaluation import brightness, without_contact
from ...images import DomeCrop, Rims, crop_discs, standardise_discs
from ...recognition import PRESETS
from ...simulation import HOUSEHOLD, UNSEEN, simulate_touches
from ...touches import Touches
from .._touches import Codes, labels
from ._plan import Corradi2015Plan

N_RINGS, N_ANGLES, N_FREQUENCIES = 8, 64, 9
PATCH, REACH_SD = 16, 2.5
# Categories in which the paper had a second object too, or the nearest to them.
UNSEEN_CATEGORIES = ("ball", "box", "can", "mug", "stapler")


@dataclass(frozen=True)
class Objects:
    """Touches to learn, others never learnt, and `every` recorded object if any."""

    data: str
    known: Touches
    unseen: Touches
    every: Touches | None = None


def simulated_objects(plan: Corradi2015Plan, workers: int) -> Objects:
    """Touch the ten objects and five unseen ones with a camera that never drifts."""
    touches = simulate_touches(
        HOUSEHOLD + UNSEEN,
        plan.n_simulated,
        drift=False,
        random_state=plan.seed,
        n_jobs=workers,
    )
    known = np.isin(labels(touches), [thing.name for thing in HOUSEHOLD])
    return Objects("simulated", touches[known], touches[~known])


def recorded_objects(touches: Touches) -> Objects:
    """Take the first object of each category, and the second of five, by name."""
    objects, category = labels(touches), labels(touches, "category")
    names = {kind: np.unique(objects[category == kind]) for kind in np.unique(category)}
    known = [members[0] for members in names.values()]
    unseen = [names[kind][1] for kind in UNSEEN_CATEGORIES]
    chosen = [np.isin(objects, some) for some in (known, unseen)]
    return Objects("bathtip", touches[chosen[0]], touches[chosen[1]], touches)


@dataclass(frozen=True, eq=False)
class Encoded:
    """Labels and features (n_touches, n_features), and which touches are idle."""

    names: NDArray[np.str_]
    codes: Codes
    features: dict[str, Floats]
    idle: NDArray[np.bool_] | None


class Encoder:
    """Features on the largest disc that all touches show; `bags` adds those of bags."""

    def __init__(self, touches: Touches, *, bags: bool = True) -> None:
        self.bags = bags
        (encoder,) = PRESETS["corradi2015"].encoders(touches, "auto").values()
        self.crop: DomeCrop = clone(encoder.clean_up)
        self.crop.fit(touches.images, no_contact=touches.no_contact)
        self.moments: Any = clone(encoder.encodings["Zernike-PCA"][0])
        self.idle_disc = self._idle_disc(touches)

    def __call__(self, touches: Touches) -> Encoded:
        """Encode touches of the same sensor."""
        rims = self.crop.rims(touches.images)
        discs = self._discs(touches.images, rims)
        features = {"Zernike": self.moments.fit(discs).transform(discs)}
        if self.bags:
            features["polar Fourier"] = polar_fourier(discs)
            patches = moment_normalised(np.abs(discs - self.idle_disc))
            features["moment-normalised"] = patches
        features["disc centre"] = np.stack([rims.row, rims.col], axis=1)
        features["brightness"] = brightness(touches)
        names, codes = np.unique(labels(touches), return_inverse=True)
        return Encoded(names, codes, features, without_contact(touches))

    def _idle_disc(self, touches: Touches) -> NDArray[np.float32]:
        """Return the disc without contact; without such a frame, the median disc."""
        if touches.no_contact is None:
            some = self.crop.transform(touches.images)
            discs = standardise_discs(np.median(some, axis=0)[np.newaxis])
        else:
            frame = np.asarray(touches.no_contact)[np.newaxis]
            discs = self._discs(frame, self.crop.rims(frame))
        idle: NDArray[np.float32] = discs[0]
        return idle

    def _discs(self, images: NDArray[Any], rims: Rims) -> NDArray[np.float32]:
        discs = crop_discs(images, rims, self.crop.disc_radius_, self.crop.size_)
        return standardise_discs(discs)


def polar_fourier(discs: NDArray[np.float32]) -> Floats:
    """Return Fourier magnitudes along 8 circles, blind to turning, (n_touches, 72)."""
    half = (discs.shape[1] - 1) / 2
    radius = half * (np.arange(N_RINGS) + 0.5) / N_RINGS
    angle = 2 * np.pi * np.arange(N_ANGLES) / N_ANGLES
    col = (half + radius[:, None] * np.cos(angle)).astype(np.float32)
    row = (half + radius[:, None] * np.sin(angle)).astype(np.float32)
    rings = np.stack([cv2.remap(d, col, row, cv2.INTER_LINEAR) for d in discs])
    found = np.abs(np.fft.rfft(rings, axis=2))[:, :, :N_FREQUENCIES] / N_ANGLES
    return np.asarray(found.reshape(len(discs), -1), dtype=np.float64)


def moment_normalised(pressed: NDArray[np.float32]) -> Floats:
    """Move, turn and scale what is pressed (n_touches, size, size); (n_touches, 256).

    The centroid comes to the middle, the main axis to the columns with the longer tail
    to the right, the deviation to one size; sum 1, zeros where nothing is pressed.
    """
    return np.stack([_normalised(image) for image in pressed])


def _normalised(image: NDArray[np.float32]) -> Floats:
    total = float(image.sum())
    row, col = np.indices(image.shape)
    if total <= 0:
        return np.zeros(PATCH * PATCH)
    weight = image / total
    y, x = row - (weight * row).sum(), col - (weight * col).sum()
    xx, yy, xy = (weight * x * x).sum(), (weight * y * y).sum(), (weight * x * y).sum()
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    along = np.cos(angle) * x + np.sin(angle) * y
    if (weight * along**3).sum() < 0:
        angle += np.pi
    reach = REACH_SD * np.sqrt(max((xx + yy) / 2, 1e-12))
    step = reach * (2 * np.arange(PATCH) + 1 - PATCH) / PATCH
    u, v = step[np.newaxis, :], step[:, np.newaxis]
    middle = (weight * col).sum(), (weight * row).sum()
    at_x = middle[0] + np.cos(angle) * u - np.sin(angle) * v
    at_y = middle[1] + np.sin(angle) * u + np.cos(angle) * v
    maps = at_x.astype(np.float32), at_y.astype(np.float32)
    patch = cv2.remap(image, *maps, cv2.INTER_LINEAR).astype(np.float64)
    # Never empty: the centroid of what is pressed lies in it.
    shares: Floats = patch / max(patch.sum(), 1e-12)
    return shares.ravel()
