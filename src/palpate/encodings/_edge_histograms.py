"""Directions of edges counted cell by cell: where edges run, and which way."""

from __future__ import annotations

import cv2
import numpy as np

from .._checks import check_count
from .._types import Array, Floats
from ._canvas import CanvasEncoder

_CLIP = 0.2
# Below this share of the strongest cell, a block is not brought to length 1.
_FAINT = 1e-3


class EdgeHistograms(CanvasEncoder):
    """Encode images by histograms of the directions of their gradients, cell by cell.

    Parameters
    ----------
    n_orientations : int, default=9
        Directions from 0 to 180 degrees: dark to bright and bright to dark are one.
    cell : int, default=8
        Pixels along each side of a cell, of an image whose shorter side has 32 to 64
        pixels: smaller ones are enlarged, larger ones reduced.

    Notes
    -----
    Each pixel votes by the length of its gradient for the two nearest directions.
    Blocks of 2 x 2 cells, which overlap, are divided by their length, cut at 0.2 and
    divided by their length again [1]_. It is blind to gain, not to turns and shifts.

    References
    ----------
    .. [1] N. Dalal, B. Triggs, "Histograms of oriented gradients for human detection",
       CVPR 2005. doi:10.1109/CVPR.2005.177

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import EdgeHistograms
    >>> EdgeHistograms().fit_transform(np.ones((2, 64, 32))).shape
    (2, 756)
    """

    blind_to = frozenset({"gain"})

    def __init__(self, n_orientations: int = 9, cell: int = 8) -> None:
        self.n_orientations, self.cell = n_orientations, cell

    @property
    def _multiple(self) -> int:  # type: ignore[override]
        return self.cell

    def _learn(self, images: Array) -> None:
        check_count("n_orientations", self.n_orientations)
        cell = check_count("cell", self.cell)
        if cell > 16:
            raise ValueError(f"cell must be at most 16, got {cell}.")

    def _vector(self, image: Array) -> Array:
        across, down = np.zeros_like(image), np.zeros_like(image)
        across[:, 1:-1] = image[:, 2:] - image[:, :-2]
        down[1:-1] = image[2:] - image[:-2]
        length, angle = np.hypot(across, down), cv2.phase(across, down)
        return _blocks(self._histograms(length, angle)).ravel()

    def _histograms(self, length: Array, angle: Array) -> Floats:
        """Votes, (n_cell_rows, n_cell_cols, n_orientations)."""
        n, cell = self.n_orientations, self.cell
        rows, cols = length.shape[0] // cell, length.shape[1] // cell
        place = angle * (n / np.pi) - 0.5
        lower = np.floor(place)
        share = (place - lower) * length
        row, col = np.arange(rows * cell) // cell, np.arange(cols * cell) // cell
        start = n * (row[:, np.newaxis] * cols + col)
        lower = lower.astype(np.intp)
        votes = np.bincount(
            np.concatenate([start + lower % n, start + (lower + 1) % n], axis=None),
            np.concatenate([length - share, share], axis=None),
            minlength=n * rows * cols,
        )
        return votes.reshape(rows, cols, n).astype(np.float64, copy=False)


def _blocks(histograms: Floats) -> Floats:
    """Histograms of 2 x 2 cells side by side, of limited length."""
    h = histograms
    blocks = np.concatenate([h[:-1, :-1], h[:-1, 1:], h[1:, :-1], h[1:, 1:]], axis=2)
    faint = _FAINT * (np.abs(blocks).max() or 1.0)
    for most in (_CLIP, 1.0):
        blocks = blocks / np.sqrt((blocks**2).sum(axis=2, keepdims=True) + faint**2)
        blocks, faint = np.minimum(blocks, most), 1e-5
    return blocks
