"""Hu's seven moments: what a shape keeps when it is moved, turned and scaled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sklearn.utils.validation import check_is_fitted

from .._checks import check_count, check_option
from .._image_estimator import ImageEstimator
from .._types import Array, Floats
from ..images import CentralMoments, above_least, central_moments, inscribed_mask

N_MOMENTS = 7
# Sizes at which the logarithm starts: below lies rounding error.
_SMALLEST = 1e-12


class HuMoments(ImageEstimator):
    """Encode tactile images by Hu's moment invariants.

    Parameters
    ----------
    n_components : int, default=7
        How many of the seven to keep, from the first.
    region : {"disc", "frame"}, default="disc"
        Whether only the inscribed disc is looked at. In a square frame the corners
        turn with the image, and nothing is invariant.
    levels : {"above-least", "raw"}, default="above-least"
        "above-least" counts levels from the least one in the region and divides
        them by their mean, so that brightness and contrast do not matter and
        standardised images have moments at all. "raw" takes levels as they are.
    log : bool, default=False
        Replace h by sign(h) log10(1 + |h| / 1e-12): the seven differ by many orders
        of magnitude.

    Notes
    -----
    From normalised central moments eta[p, q] = mu[p, q] / mu[0, 0]^(1 + (p + q) / 2).
    The seventh changes its sign in a mirror; of the two signs in use, ours is
    OpenCV's. A blank image, or raw levels without a positive sum, gives zeros.

    References
    ----------
    .. [1] M.-K. Hu, "Visual pattern recognition by moment invariants", IRE Trans.
       Inf. Theory 8(2), 1962. doi:10.1109/TIT.1962.1057692

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import HuMoments
    >>> image = np.zeros((1, 20, 20))
    >>> image[0, 13:17, 13:17], image[0, 10:12, 10:12] = 0.5, 1
    >>> HuMoments(2, levels="raw").fit_transform(image).round(6)
    array([[0.74537 , 0.351166]])
    """

    def __init__(
        self,
        n_components: int = N_MOMENTS,
        *,
        region: str = "disc",
        levels: str = "above-least",
        log: bool = False,
    ) -> None:
        self.n_components = n_components
        self.region, self.levels = region, levels
        self.log = log

    @property
    def blind_to(self) -> frozenset[str]:
        """Shifts; turns on the disc; gain where levels are divided by their mean."""
        turns = {"turns"} if self.region == "disc" else set()
        gain = {"gain"} if self.levels == "above-least" else set()
        return frozenset({"shifts"} | turns | gain)

    def _learn(self, images: Array) -> None:
        if check_count("n_components", self.n_components) > N_MOMENTS:
            raise ValueError(
                f"n_components must be at most 7, got {self.n_components}. "
                "There are seven Hu moments."
            )
        check_option("region", self.region, ("disc", "frame"))
        check_option("levels", self.levels, ("above-least", "raw"))

    def transform_checked(self, images: Array) -> Floats:
        """Return the moments, shape (n_touches, n_components)."""
        images = images.astype(np.float64, copy=False)
        mask = np.ones(images.shape[1:], dtype=bool)
        if self.region == "disc":
            mask = inscribed_mask(*images.shape[1:])
        raw = self.levels == "raw"
        seen = images * mask if raw else _relative(images, mask)
        invariants = _hu(central_moments(seen))[:, : self.n_components]
        if not self.log:
            return invariants
        return np.sign(invariants) * np.log10(1 + np.abs(invariants) / _SMALLEST)

    def get_feature_names_out(self, input_features: object = None) -> Array:
        """Return "hu1" to "hu7"."""
        check_is_fitted(self)
        return np.array([f"hu{i + 1}" for i in range(self.n_components)], dtype=object)


def _relative(images: Floats, mask: NDArray[np.bool_]) -> Floats:
    levels = above_least(images, mask)
    mean = levels.sum(axis=(1, 2), keepdims=True) / mask.sum()
    size = np.abs(images).max(axis=(1, 2), keepdims=True)
    blank = mean <= 1e-12 * size
    return np.where(blank, 0.0, levels / np.where(blank, 1.0, mean))


def _hu(moments: CentralMoments) -> Floats:
    """Return the seven invariants, zeros where there is no mass."""
    lit = moments.mass > 0
    mass = np.where(lit, moments.mass, 1.0)[:, None, None]
    order = np.add.outer(np.arange(4), np.arange(4))
    eta = np.where(lit[:, None, None], moments.mu / mass ** (1 + order / 2), 0.0)
    e20, e02, e11 = eta[:, 0, 2], eta[:, 2, 0], eta[:, 1, 1]
    e30, e21, e12, e03 = eta[:, 0, 3], eta[:, 1, 2], eta[:, 2, 1], eta[:, 3, 0]
    # Complex moments c[p, q], of which turning changes the phase alone.
    c20 = (e20 - e02) + 2j * e11
    c21 = (e30 + e12) + 1j * (e21 + e03)
    c30 = (e30 - 3 * e12) + 1j * (3 * e21 - e03)
    fourth, sixth = c30 * c21.conj() ** 3, c20 * c21.conj() ** 2
    invariants = [
        e20 + e02,
        np.abs(c20) ** 2,
        np.abs(c30) ** 2,
        np.abs(c21) ** 2,
        fourth.real,
        sixth.real,
        fourth.imag,
    ]
    return np.stack(invariants, axis=1)
