"""How much a model file may ask for: looked at before anything is built from it.

A checksum tells damage, not intent: who forges a model computes it anew. So every
number that sizes something has a limit, texts and arrays may not take more memory than
the file gives reason for, and what would take seconds to try is not tried.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import prod
from typing import Any

from .._types import Array

MB = 2**20
# Of images with more levels no blank touch is tried; a model may ask for as many.
MOST_TRIED = 800_000
MOST_LEVELS = 50_000_000
# An order up to this needs small tables, a higher one some for each pixel.
_SMALL_ORDER = 20
_MOST_WORK = 2e7
_MOST_OBJECTS = 500
_MOST_LETTERS = 1000
_MOST_KERNELS_BY_TOUCHES = 5_000_000
# How often format 3, brought to today's shape, names one array.
_MOST_USES = 4

_MOST: dict[str, float] = {
    **dict.fromkeys(("degree", "order"), 60),
    **dict.fromkeys(("n_points", "n_rings", "radii", "n_harmonics", "cell"), 32),
    **dict.fromkeys(("n_orientations", "n_partitions"), 64),
    **dict.fromkeys(("shape", "side", "cells", "n", "resample"), 1024),
    **dict.fromkeys(("size", "size_"), 2048),
}
# They count what is in the file, or say how to learn, and size nothing when read.
_SIZELESS = (
    *("n_features_in_", "n_samples_", "n_samples_seen_", "n_components_"),
    *("n_components", "random_state", "max_iter", "max_touches", "n_landmarks"),
    *("max_choice_touches", "max_presses", "image_shape_", "frame_shape_"),
)
_MOST |= dict.fromkeys(_SIZELESS, 2**53)
_USUAL = 10_000
_N_AXES = {
    **dict.fromkeys(("mean_", "classes_", "squared_norms_", "log_counts_"), 1),
    **dict.fromkeys(("centre_", "spread_", "offset_", "support_", "eigenvalues_"), 1),
    **dict.fromkeys(("touches_", "components_", "coefficients_", "points_"), 2),
    **dict.fromkeys(("dual_coef_", "left_out_", "left_out_scores_", "features"), 2),
}


@dataclass
class Budget:
    """What reading one file has used so far of `n_bytes`, its size.

    Attributes
    ----------
    text : float
        Bytes that texts may still take in memory.
    """

    n_bytes: int
    objects: int = 0
    work: float = 0.0
    used: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self.text = 32 * MB + self.n_bytes / 2

    def check_document(self, document: str) -> None:
        """Refuse a document that would become too many values."""
        n_values = sum(map(document.count, ",[{"))
        if not document.isascii() or n_values > 1_000_000 + self.n_bytes / 50:
            raise ValueError(f"{n_values} values are too many for its size")

    def check_texts(self, items: Sequence[object]) -> None:
        """Refuse texts that would take too much memory, or are none."""
        if not all(isinstance(item, str) for item in items):
            raise TypeError("a text is none")
        longest = max(map(len, items), default=0)  # type: ignore[arg-type]
        self.text -= 4 * longest * len(items)
        if longest > _MOST_LETTERS or self.text < 0:
            raise ValueError(f"{len(items)} texts of up to {longest} letters")

    def check_array(self, name: str, array: Array, shape: object) -> None:
        """Refuse another shape than the array's own, and one used again and again."""
        self.used[name] += 1
        if self.used[name] > _MOST_USES or list(array.shape) != (shape or [1]):
            raise ValueError(f"the array {name} has shape {array.shape}, not {shape}")

    def check_object(self, values: dict[str, Any]) -> None:
        """Refuse attributes of one object that would size or repeat too much."""
        self.objects += 1
        for name, value in values.items():
            _check_size(name, value)
        if "counts_" in values and (
            values["counts_"].min() < 0
            or values["counts_"].sum(dtype=float) > len(values.get("points_", ()))
        ):
            raise ValueError("counts_ are more touches than there are")
        n_pixels = prod(values.get("image_shape_", ()))
        if not n_pixels <= MOST_LEVELS:
            raise ValueError(f"images of {n_pixels} levels are too large")
        if self.objects > _MOST_OBJECTS:
            raise ValueError(f"more than {_MOST_OBJECTS} parts")
        order = values.get("order", 0)
        if "indices_" in values:
            n_pixels *= max(order, 5) ** 2 if order > _SMALL_ORDER else 25
            self.work += n_pixels
        elif n_pixels <= MOST_TRIED:
            self.work += n_pixels
        kernels, touches = values.get("kernels_", ()), values.get("touches_", ())
        if self.work > _MOST_WORK or (
            len(kernels) * len(touches) > _MOST_KERNELS_BY_TOUCHES
        ):
            raise ValueError("to try one touch would take too long")


def _check_size(name: str, value: Any) -> None:
    """Refuse a number that is too large for its name, or an array of other axes."""
    axes = getattr(value, "ndim", None)
    if axes is not None and axes != _N_AXES.get(name, axes):
        raise ValueError(f"{name} has {axes} axes")
    most = _MOST.get(name, _USUAL)
    for one in value if isinstance(value, list | tuple) else (value,):
        if isinstance(one, int) and abs(one) > most:
            raise ValueError(f"{name} must be at most {most} in a model, got {one}")
