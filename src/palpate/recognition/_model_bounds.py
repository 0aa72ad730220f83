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
# A blank touch of larger images is not tried.
MOST_TRIED = 800_000
_MOST = {
    **dict.fromkeys(("degree", "order", "n_orientations", "n_partitions"), 60),
    **dict.fromkeys(("n_points", "n_rings", "radii", "n_harmonics", "cell"), 32),
    **dict.fromkeys(("shape", "side", "cells", "n", "resample", "n_quantiles"), 1024),
    **dict.fromkeys(("size", "size_"), 2048),
}


@dataclass
class Budget:
    """What one file of `n_bytes` holds, and what reading it has used so far."""

    n_bytes: int
    tensors: Mapping[str, Array]
    known: Mapping[str, type]
    objects: int = 0
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
        if longest > 1000 or self.text > 32 * MB + self.n_bytes / 2:
            raise ValueError(f"{len(items)} texts of up to {longest} letters")

    def array(self, name: str, shape: list[int]) -> Array:
        """Return an array of its own shape, unless it was used again and again."""
        array = self.tensors[name]
        self.used[name] += 1
        if self.used[name] > 4 or list(array.shape) != (shape or [1]):
            raise ValueError(f"the array {name} has shape {array.shape}, not {shape}")
        return array.reshape(shape)

    def check_object(self, values: Mapping[str, Any]) -> None:
        """Refuse attributes of one object that would size or repeat too much."""
        self.objects += 1
        for name, value in values.items():
            most = _MOST.get(name, 2**53)
            for one in value if isinstance(value, list | tuple) else (value,):
                if isinstance(one, int) and abs(one) > most:
                    raise ValueError(f"{name} must be at most {most}, got {one}")
        levels, order = prod(values.get("image_shape_", ())), values.get("order", 0)
        n_kernels = len(values.get("kernels_", ())) * len(values.get("touches_", ()))
        # Zernike moments of high order keep tables for each level.
        costly = order > 20 and levels * order**2 > 2e7
        if costly or n_kernels > 5_000_000 or self.objects > 500:
            raise ValueError(f"{self.objects} parts, too much for one touch")
        counts, n_points = values.get("counts_"), len(values.get("points_", ()))
        if counts is not None and not 0 <= counts.min() <= counts.max() <= n_points:
            raise ValueError("counts_ are more touches than there are")
