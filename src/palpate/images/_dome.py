"""Cut the disc that a dome camera sees, standardise it, and see how steep it is.

A cell of the canvas is the mean of the area it covers in the image, at any fraction
of a pixel: read from an integral image [1]_, whose bilinear interpolation is exact
for pixels of one grey level each. So nothing aliases, and no level is rounded.

References
----------
.. [1] F. C. Crow, "Summed-area tables for texture mapping", SIGGRAPH 1984.
   doi:10.1145/800031.808600
"""

from __future__ import annotations

from typing import Self

import cv2
import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import clone
from sklearn.utils.validation import check_is_fitted

from .._checks import check_count, check_number, check_option
from .._image_estimator import ImageEstimator, inscribed_mask
from .._numbers import evenly_rounded
from .._types import Array, Floats, Singles
from ._rim import Circle, Rims, as_images, rims_near, typical_rim

N_SAFE = 512  # images are spread over all; more change a quantile little
SAFE_SHARE = 0.02  # of the images may reach beyond the disc
FLAT = 1e-6  # of the level: single precision rounds there


class DomeCrop(ImageEstimator):
    """Centre each image on its own rim, cut the largest safe disc, standardise it.

    Parameters
    ----------
    size : int or None, default=128
        Most rows and columns of the canvas. It is smaller where the disc has fewer
        pixels across, as images are never enlarged; None keeps all pixels.
    missing : {"inscribed", "refuse"}, default="inscribed"
        What to do about a touch without a visible rim. "inscribed" takes the disc
        inscribed in the frame where the set as a whole has no rim, and a disc about
        the typical rim's centre where other touches have one. "refuse" raises.
    output : {"standardised", "grey"}, default="standardised"
        Whether each disc is brought to mean 0 and variance 1, or keeps its levels.
    margin : float, default=0.02
        Share of the safe radius that is left out, for what the rim blurs.

    Attributes
    ----------
    has_rim_ : bool
        Whether the training touches have a rim in common (see `typical_rim`).
    rim_row_, rim_col_, rim_radius_ : float
        That rim, in pixels; without one the disc inscribed in the frame.
    disc_radius_ : float
        Radius of the disc that is cut, in pixels of the image.
    size_ : int
        Rows and columns of the canvas.
    frame_shape_ : tuple of int
        (n_rows, n_cols) of the images seen by `fit`.

    Notes
    -----
    The safe disc is the largest about a rim's centre that stays within the rim and
    the frame in 98 % of the training touches, less `margin`, but at least half the
    rim's radius. Where it leaves the frame, the frame's edge is repeated.
    Each touch is treated by itself: alone or among others, the result is the same.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.images import DomeCrop
    >>> row, col = np.mgrid[:100, :120]
    >>> inside = np.hypot(row - 48, col - 61) < 40
    >>> touches = np.where(inside, 90 + 0.2 * row, 255)[np.newaxis]
    >>> crop = DomeCrop().fit(touches)
    >>> round(crop.rim_radius_), crop.transform(touches).shape
    (40, (1, 78, 78))
    """

    def __init__(
        self,
        size: int | None = 128,
        missing: str = "inscribed",
        output: str = "standardised",
        margin: float = 0.02,
    ) -> None:
        self.size, self.missing = size, missing
        self.output, self.margin = output, margin

    def fit(
        self, X: ArrayLike, y: object = None, *, no_contact: ArrayLike | None = None
    ) -> Self:
        """Learn the rim and the disc from the touches `X`; `y` is ignored.

        Parameters
        ----------
        X : array-like of shape (n_touches, n_rows, n_cols)
            Grey levels without NaN.
        y : object, optional
            Ignored.
        no_contact : array-like of shape (n_rows, n_cols), optional
            The no-contact frame; the rim is learnt from it if it shows one.
        """
        images = as_images(X)
        self._learn_rim(images, no_contact)
        self._learn_disc(self._rims(images[evenly_rounded(len(images), N_SAFE)]))
        return self

    def fit_transform(
        self, X: ArrayLike, y: object = None, **fixed: ArrayLike | None
    ) -> Singles:
        """Do what `fit` and then `transform` do; each rim is looked for once."""
        images = as_images(X)
        self._learn_rim(images, **fixed)
        rims = self._rims(images)
        self._learn_disc(rims[evenly_rounded(len(images), N_SAFE)])
        return self._cut(images, rims)

    def _learn_rim(self, images: Array, no_contact: ArrayLike | None = None) -> None:
        check_option("missing", self.missing, ("inscribed", "refuse"))
        check_option("output", self.output, ("standardised", "grey"))
        check_number("margin", self.margin, low=0, high=0.5)
        rim = typical_rim(images, no_contact=no_contact)
        if rim is None and self.missing == "refuse":
            raise ValueError(
                "X must show a common rim, got touches without one. Use "
                "missing='inscribed' for a sensor without a visible circle."
            )
        self.frame_shape_ = tuple(images.shape[1:])
        self.has_rim_ = rim is not None
        circle = rim or Circle.inscribed(images.shape[1:])
        self.rim_row_, self.rim_col_ = circle.row, circle.col
        self.rim_radius_ = circle.radius

    def _learn_disc(self, rims: Rims) -> None:
        limit = None if self.size is None else check_count("size", self.size)
        self.disc_radius_ = self.rim_radius_
        if self.has_rim_:
            rims = rims[rims.visible] if rims.visible.any() else rims
            rows, cols = self.frame_shape_
            sides = [rims.row, rows - 1 - rims.row, rims.col, cols - 1 - rims.col]
            reach = np.minimum(np.min(sides, axis=0) + 0.5, rims.radius)
            safe = float(np.quantile(reach, SAFE_SHARE))
            self.disc_radius_ = max(safe, 0.5 * self.rim_radius_) * (1 - self.margin)
        native = max(int(2 * self.disc_radius_), 1)
        self.size_ = native if limit is None else min(native, limit)

    def transform_checked(self, images: Array) -> Singles:
        """Return the discs, shape (n_touches, size_, size_), zero outside.

        Raises
        ------
        ValueError
            If `missing` is "refuse" and a touch shows no rim; the error names it.
        """
        if images.dtype != np.uint8:
            images = images.astype(np.float64, copy=False)
        return self._cut(images, self._rims(images))

    def cut(self, X: ArrayLike, rims: Rims) -> Singles:
        """Do what `transform` does, about rims that were found in these very images."""
        images = self._images(X)
        if len(rims) != len(images):
            raise ValueError(
                f"rims must be as many as images, got {len(rims)} for {len(images)}. "
                "Use the rims found in these very images."
            )
        return self._cut(images, rims)

    @staticmethod
    def standardise(discs: ArrayLike) -> Singles:
        """Bring square discs to mean 0 and variance 1; flat ones and outsides to 0."""
        images = as_images(discs)
        rows, cols = images.shape[1:]
        if rows != cols:
            raise ValueError(
                f"discs must be square, got {rows} x {cols}. Crop them first."
            )
        return _standardise(images, np.zeros(images.shape, np.float32))

    def _cut(self, images: Array, rims: Rims) -> Singles:
        unseen = np.flatnonzero(~rims.visible)
        if self.missing == "refuse" and len(unseen):
            raise ValueError(
                f"Every touch must show a rim, got none in touch {unseen[0]} "
                f"({len(unseen)} of {len(rims)} touches). Leave them out, or use "
                "missing='inscribed'."
            )
        discs = _crop(images, rims, self.disc_radius_, self.size_)
        return _standardise(discs, discs) if self.output == "standardised" else discs

    def by_channel(self, images: Array) -> Singles:
        """Return the disc of each channel, (n_touches, size_, size_, n_channels).

        Of checked images (n_touches, n_rows, n_cols, n_channels), about the rim of
        their mean over channels; standardised as that mean is, so that how channels
        differ is kept.
        """
        rims = self._rims(images.mean(axis=3, dtype=np.float32).astype(np.float64))
        planes = np.moveaxis(images, 3, 0).astype(np.float64)
        cut = self.disc_radius_, self.size_
        discs = np.stack([_crop(plane, rims, *cut) for plane in planes], axis=3)
        if self.output == "standardised":
            mask = inscribed_mask(self.size_, self.size_)
            middle = discs.mean(axis=3)[:, mask]
            mean, spread = middle.mean(axis=1), middle.std(axis=1)
            flat = spread <= FLAT * np.maximum(np.abs(middle).max(axis=1), FLAT)
            spread[flat] = np.inf
            discs -= mean[:, np.newaxis, np.newaxis, np.newaxis]
            discs /= spread[:, np.newaxis, np.newaxis, np.newaxis]
            discs *= mask[:, :, np.newaxis]
        return discs

    def moved(self, X: ArrayLike, no_contact: ArrayLike | None = None) -> Self:
        """Return this clean-up for another camera before the same sensor.

        The rim is found in its images `X`; the disc keeps its share of the rim and its
        size in pixels. Where no rim is found in images of the same shape, it stays
        where it was.
        """
        other: Self = clone(self).fit(X, no_contact=no_contact)
        lost = self.has_rim_ and not other.has_rim_
        if lost and other.frame_shape_ == tuple(self.frame_shape_):
            return self
        if other.has_rim_ and self.has_rim_:
            share = self.disc_radius_ / self.rim_radius_
            other.disc_radius_ = share * other.rim_radius_
        other.size_ = self.size_
        return other

    def rims(self, X: ArrayLike) -> Rims:
        """Return the circle about which each touch is cut, and which were seen."""
        return self._rims(self._images(X))

    def _images(self, X: ArrayLike) -> Array:
        if not hasattr(self, "frame_shape_"):
            check_is_fitted(self)
        return as_images(X, shape=tuple(self.frame_shape_))

    def _rims(self, images: Array) -> Rims:
        if self.has_rim_:
            near = Circle(self.rim_row_, self.rim_col_, self.rim_radius_)
            return rims_near(images, near)
        return Rims.of([Circle.inscribed(self.frame_shape_)] * len(images))


class DerivativeMagnitude(ImageEstimator):
    """Replace images by the magnitude of their discrete derivative.

    Where a dome's membrane is bent sharply its shading changes fast, whatever the
    light's brightness; Corradi et al. 2014 (doi:10.1007/978-3-319-10401-0) encode
    this beside the image itself.

    Parameters
    ----------
    region : {"disc", "frame"}, default="disc"
        "disc" for images cut to a disc: what lies outside the inscribed disc of the
        smaller result is zero, and no difference reaches across the rim. "frame"
        keeps all of the interior.

    Notes
    -----
    The root of (I[i-1, j] - I[i+1, j])^2 + (I[i, j-1] - I[i, j+1])^2. Eq. 1 of
    Corradi et al. prints a plus in the second bracket, where a derivative has a minus.

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

    def _learn(self, images: Array) -> None:
        check_option("region", self.region, ("frame", "disc"))
        if min(images.shape[1:]) < 3:
            raise ValueError(
                "Images must have at least 3 x 3 pixels to be differentiated, got "
                f"{images.shape[1]} x {images.shape[2]}. Encode the images themselves."
            )

    def transform_checked(self, images: Array) -> Floats:
        """Return the magnitudes, shape (n_touches, n_rows - 2, n_cols - 2).

        They are of central differences: grey levels per two pixels.
        """
        images = images.astype(np.float64, copy=False)
        down = images[:, 2:, 1:-1] - images[:, :-2, 1:-1]
        across = images[:, 1:-1, 2:] - images[:, 1:-1, :-2]
        magnitude: Floats = np.hypot(down, across)
        if self.region == "disc":
            magnitude *= inscribed_mask(*magnitude.shape[1:])
        return magnitude


def _crop(images: Array, rims: Rims, radius: float, size: int) -> Singles:
    discs = np.empty((len(images), size, size), np.float32)
    for disc, image, row, col in zip(discs, images, rims.row, rims.col, strict=True):
        disc[:] = _mean_over_cells(image, (row, col), radius, size)
    discs *= inscribed_mask(size, size)
    return discs


def _standardise(images: Array, out: Singles) -> Singles:
    """Write into `out`, zero outside the discs; `images` themselves may be that."""
    mask = inscribed_mask(*images.shape[1:])
    for result, image in zip(out, images, strict=True):
        levels = image[mask].astype(np.float64)
        largest = np.abs(levels).max()
        levels = levels / (largest or 1.0)
        levels -= levels.mean()
        deviation = np.sqrt((levels**2).mean())
        result[mask] = levels / deviation if deviation > FLAT else 0
    return out


def _mean_over_cells(
    image: Array, centre: tuple[float, float], radius: float, size: int
) -> Floats:
    """Average `image` over a grid of `size` x `size` square cells about `centre`."""
    border = radius * (2 * np.arange(size + 1) / size - 1) + 0.5
    row, col = border + centre[0], border + centre[1]
    top, left = int(np.floor(row[0])), int(np.floor(col[0]))
    row, col = row - top, col - left
    part = _part(image, top, int(np.ceil(row[-1])), left, int(np.ceil(col[-1])))
    level, depth = 0.0, cv2.CV_32S
    if part.dtype != np.uint8:
        level = float(part.mean())
        part = part - level
    if part.dtype != np.uint8 or part.size >= 2**31 // 255:
        depth = cv2.CV_64F
    total = np.asarray(cv2.integral(part, sdepth=depth))
    i = np.minimum(row.astype(int), part.shape[0] - 1)
    j = np.minimum(col.astype(int), part.shape[1] - 1)
    upper = total.take(i, axis=0)
    share = (row - i)[:, np.newaxis]
    rows = np.diff(upper + (total.take(i + 1, axis=0) - upper) * share, axis=0)
    before = rows.take(j, axis=1)
    before += (rows.take(j + 1, axis=1) - before) * (col - j)
    sums: Floats = np.diff(before, axis=1)
    return sums / (2 * radius / size) ** 2 + level


def _part(image: Array, top: int, height: int, left: int, width: int) -> Array:
    """Cut a rectangle; outside the frame its edge is repeated."""
    rows, cols = image.shape
    if min(top, left) >= 0 and top + height <= rows and left + width <= cols:
        return image[top : top + height, left : left + width]
    row = np.clip(np.arange(top, top + height), 0, rows - 1)
    col = np.clip(np.arange(left, left + width), 0, cols - 1)
    return image[row[:, np.newaxis], col]
