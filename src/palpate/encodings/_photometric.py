"""Slopes of a gel's surface from the colours of lights whose directions are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._checks import check_number
from .._image_estimator import ImageEstimator
from .._types import Array, Floats
from ._pixels import GridLevels


class PhotometricGradients(ImageEstimator, by_channel=False):
    """Encode a gel lit from several sides by the slopes of its surface.

    Parameters
    ----------
    lights : array-like of shape (n_channels, 2)
        Where the light of each channel comes from, seen from above: towards rows and
        towards columns, as long as the light is strong. Two directions at least.
    baseline : {"median"} or image, default="median"
        What the gel looks like untouched; see `GridLevels`.
    cells : int, default=32
        Most cells along the longer side.

    Attributes
    ----------
    slopes_ : ndarray of shape (2, n_channels)
        Slopes along rows and columns for each channel's change of level.
    grid_ : GridLevels
        What lays the slopes on a grid, as signed roots.
    image_shape_ : tuple of int
        (n_rows, n_cols, n_channels) of the images seen by `fit`.

    Notes
    -----
    A surface that falls towards a light gets brighter in its channel by the slope times
    the light's strength (Lambert, slopes below about a third). The slopes are the least
    squares solution of that, pixel by pixel: photometric stereo [1]_, in units of a
    level over a light's strength. It is blind to nothing.

    References
    ----------
    .. [1] R. J. Woodham, "Photometric method for determining surface orientation from
       multiple images", Optical Engineering 19(1), 1980. doi:10.1117/12.7972479

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import PhotometricGradients
    >>> lights = [[-1, 0], [0.5, 0.87], [0.5, -0.87]]
    >>> touches = np.random.default_rng(0).random((3, 40, 40, 3))
    >>> PhotometricGradients(lights, cells=8).fit_transform(touches).shape
    (3, 128)
    """

    def __init__(
        self,
        lights: ArrayLike,
        baseline: str | ArrayLike = "median",
        cells: int = 32,
    ) -> None:
        self.lights, self.baseline, self.cells = lights, baseline, cells

    def _learn(self, images: Array) -> None:
        lights = np.asarray(self.lights, dtype=np.float64)
        n_channels = images.shape[3] if images.ndim == 4 else 1
        if lights.shape != (n_channels, 2) or np.linalg.matrix_rank(lights) < 2:
            raise ValueError(
                f"lights must hold a direction (row, column) for each of {n_channels} "
                f"channels, two different ones at least, got {lights.tolist()}. Give "
                "where each channel's light comes from."
            )
        check_number("lights", float(np.abs(lights).max()), high=1e6)
        self.slopes_ = np.linalg.pinv(lights)
        self.grid_ = GridLevels(self.cells, baseline=self._slopes_of_baseline())
        self.grid_.fit(self._slopes(images))

    def transform_checked(self, images: Array) -> Floats:
        """Return roots of the slopes, (n_touches, 2 * n_cells)."""
        return self.grid_.transform_checked(self._slopes(images))

    def _slopes(self, images: Array) -> Floats:
        """Slopes along rows and columns, (n_touches, n_rows, n_cols, 2)."""
        slopes: Floats = images.astype(np.float64, copy=False) @ self.slopes_.T
        return slopes

    def _slopes_of_baseline(self) -> str | ArrayLike:
        if isinstance(self.baseline, str):
            return self.baseline
        return self._slopes(np.asarray(self.baseline))
