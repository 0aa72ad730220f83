"""How steeply an image changes: the magnitude of its discrete derivative."""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from .._checks import check_images, check_option
from .._image_estimator import ImageEstimator
from .._types import Floats
from ._central_moments import inscribed_mask

REGIONS = ("frame", "disc")


class DerivativeMagnitude(ImageEstimator):
    """Replace images by the magnitude of their discrete derivative.

    Where a dome's membrane is bent sharply its shading changes fast, whatever the
    light's brightness; Corradi et al. [1]_ encode this beside the image itself.

    Parameters
    ----------
    region : {"disc", "frame"}, default="disc"
        "disc" for images cut to a disc: what lies outside the inscribed disc of the
        smaller result is zero, and no difference reaches across the rim. "frame"
        keeps all of the interior.

    Attributes
    ----------
    image_shape_ : tuple of int
        (n_rows, n_cols) of the images seen by `fit`.

    References
    ----------
    .. [1] T. Corradi, P. Hall, P. Iravani, "Tactile features: recognising touch
       sensations with a novel and inexpensive tactile sensor", TAROS 2014,
       LNCS 8717. doi:10.1007/978-3-319-10401-0

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.images import DerivativeMagnitude
    >>> slope = np.tile(np.arange(4.0), (1, 4, 1))
    >>> DerivativeMagnitude().fit_transform(slope)
    array([[[2., 2.],
            [2., 2.]]])
    """

    def __init__(self, region: str = "disc") -> None:
        self.region = region

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Learn the image size; `y` is ignored."""
        images = check_images(X)
        check_option("region", self.region, REGIONS)
        _check_side(images)
        self.image_shape_ = (images.shape[1], images.shape[2])
        return self

    def transform(self, X: ArrayLike) -> Floats:
        """Return the magnitudes, shape (n_touches, n_rows - 2, n_cols - 2)."""
        images = self._images(X)
        magnitude = derivative_magnitude(images)
        if self.region == "disc":
            magnitude *= inscribed_mask(*magnitude.shape[1:])
        return magnitude


def derivative_magnitude(images: ArrayLike) -> Floats:
    """Return the magnitude of central differences at interior pixels.

    Parameters
    ----------
    images : array-like of shape (n_touches, n_rows, n_cols)
        At least 3 pixels along each side.

    Returns
    -------
    magnitude : ndarray of shape (n_touches, n_rows - 2, n_cols - 2)
        Grey levels per two pixels.

    Notes
    -----
    The root of (I[i-1, j] - I[i+1, j])^2 + (I[i, j-1] - I[i, j+1])^2. Eq. 1 of
    Corradi et al. 2014 (see `DerivativeMagnitude`) prints a plus in the second
    bracket, where a derivative has a minus.
    """
    checked = check_images(images)
    _check_side(checked)
    down = checked[:, 2:, 1:-1] - checked[:, :-2, 1:-1]
    across = checked[:, 1:-1, 2:] - checked[:, 1:-1, :-2]
    magnitude: Floats = np.hypot(down, across)
    return magnitude


def _check_side(images: Floats) -> None:
    if min(images.shape[1:]) < 3:
        raise ValueError(
            "Images must have at least 3 x 3 pixels to be differentiated, got "
            f"{images.shape[1]} x {images.shape[2]}. Encode the images themselves."
        )
