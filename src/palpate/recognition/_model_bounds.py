"""How much a model file may ask for, looked at before anything is built from it.

A checksum tells damage, not intent: who forges a model computes it anew. So whatever
sizes something has a limit, and what would take seconds to try is refused.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import prod
from typing import Any

from .._types import Array

MB = 2**20
MOST_LEVELS = 50_000_000
# A blank touch of larger images is not tried.
MOST_TRIED = 800_000
_MOST_OBJECTS, _MOST_LETTERS, _MOST_KERNELS = 500, 1000, 5_000_000
# Format 3, brought to today's shape, names an array more than once.
_MOST_USES = 4
# Levels to look at; Zernike moments above the small order keep tables for each.
_MOST_WORK, _SMALL_ORDER = 2e7, 20

_MOST: dict[str, float] = {
    **dict.fromkeys(("degree", "order", "n_orientations", "n_partitions"), 60),
    **dict.fromkeys(("n_points", "n_rings", "radii", "n_harmonics", "cell"), 32),
    **dict.fromkeys(("shape", "side", "cells", "n", "resample"), 1024),
    **dict.fromkeys(("size", "size_"), 2048),
}
# What counts what the file holds, or says how to learn: nothing is sized by it.
_SIZELESS = """n_features_in_ n_samples_ n_samples_seen_ n_components_ n_components
    random_state max_iter max_touches n_landmarks max_choice_touches max_presses
    image_shape_ frame_shape_"""
_MOST |= dict.fromkeys(_SIZELESS.split(), 2**53)
_USUAL = 10_000
_VECTORS = """mean_ classes_ squared_norms_ log_counts_ centre_ spread_ offset_ support_
    eigenvalues_ counts_"""
_MATRICES = """touches_ components_ coefficients_ points_ dual_coef_ left_out_
    left_out_scores_ features"""
_N_AXES = dict.fromkeys(_VECTORS.split(), 1) | dict.fromkeys(_MATRICES.split(), 2)


@dataclass
class Budget:
    """What one file of `n_bytes` holds, and what reading it has used so far."""

    n_bytes: int
    tensors: Mapping[str, Array]
    known: Mapping[str, type]
    objects: int = 0
    work: float = 0.0
    text: float = 0.0
    used: Counter[str] = field(default_factory=Counter)

    def check_document(self, document: str) -> None:
        """Refuse a document that would become too many values."""
        n_values = sum(map(document.count, ",[{"))
        if not document.isascii() or n_values > 1_000_000 + self.n_bytes / 50:
            raise ValueError(f"{n_values} values are too many for its size")

    def check_texts(self, items: Sequence[Any]) -> None:
        """Refuse texts that would take too much memory."""
        longest = max(map(len, items), default=0)
        self.text += 4 * longest * len(items)
        if longest > _MOST_LETTERS or self.text > 32 * MB + self.n_bytes / 2:
            raise ValueError(f"{len(items)} texts of up to {longest} letters")

    def array(self, name: str, shape: list[int]) -> Array:
        """Return an array of its own shape, unless it was used again and again."""
        array = self.tensors[name]
        self.used[name] += 1
        if self.used[name] > _MOST_USES or list(array.shape) != (shape or [1]):
            raise ValueError(f"the array {name} has shape {array.shape}, not {shape}")
        return array.reshape(shape)

    def check_object(self, values: Mapping[str, Any]) -> None:
        """Refuse attributes of one object that would size or repeat too much."""
        self.objects += 1
        for name, value in values.items():
            _check_size(name, value)
        n_levels = prod(values.get("image_shape_", ()))
        if not n_levels <= MOST_LEVELS or self.objects > _MOST_OBJECTS:
            raise ValueError(f"{self.objects} parts, images of {n_levels} levels")
        touches = len(values.get("touches_", ()))
        if len(values.get("kernels_", ())) * touches > _MOST_KERNELS:
            raise ValueError("too many kernels")
        counts = values.get("counts_")
        if counts is not None and (
            counts.min() < 0 or counts.sum(dtype=float) > len(values.get("points_", ()))
        ):
            raise ValueError("counts_ are more touches than there are")
        if "indices_" in values:
            order = values["order"]
            self.work += n_levels * (order**2 if order > _SMALL_ORDER else 25)
        elif n_levels <= MOST_TRIED:
            self.work += n_levels
        if self.work > _MOST_WORK:
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
