"""Cleaning images of a pressure array, as layer 1 of Liu et al. (2014).

Dead taxels are filled, the image is enlarged, gamma raises the low grey levels, a
filter removes what is far below the mean, and Otsu's threshold, partition by
partition, makes the image binary. Each step is a function; `ArrayCleanUp` is the
chain. Arrays of any shape are accepted, 10 x 10 taxels to 33 x 33 pixels being the
paper's.
"""

from collections.abc import Iterable
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, TransformerMixin, clone
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from .._checks import check_count, check_images, check_option, check_positive
from ._dead_taxels import fill_dead_taxels
from ._otsu import binarise

_OUTPUTS = ("resized", "gamma", "filtered", "binary")


class ArrayCleanUp(TransformerMixin, BaseEstimator):
    """Turn images of a pressure array into binary images of the pressed shape.

    Nothing is learnt from the pressures; fitting fixes the image size.

    Parameters
    ----------
    shape : tuple of int, default=(33, 33)
        Rows and columns of the enlarged image.
    gamma : float, default=0.5
        Exponent of the gamma correction; below 1 raises low grey levels. The paper
        does not give its value.
    n_sd : float, default=2.0
        Pixels below the mean minus this many standard deviations become zero.
    n_partitions : int, default=2
        Otsu's threshold is taken on `n_partitions` x `n_partitions` partitions.
    min_contrast : float, default=0.0
        Share of the image's span below which a partition counts as constant.
    dead : {"fill", "refuse"}, default="fill"
        What happens to dead taxels (NaN).
    output : {"binary", "filtered", "gamma", "resized"}, default="binary"
        The last step that is done.

    Attributes
    ----------
    image_shape_ : tuple of int
        (n_rows, n_cols) of the images seen by `fit`.

    See Also
    --------
    stage_pictures : every step of the chain as a picture.

    References
    ----------
    .. [1] Y.-H. Liu et al., "Low-resolution tactile image recognition for automated
       robotic assembly using kernel PCA-based feature fusion and multiple kernel
       learning-based support vector machine", Math. Probl. Eng., 2014.
       doi:10.1155/2014/497275

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.images import ArrayCleanUp
    >>> press = np.zeros((1, 10, 10))
    >>> press[0, 3:7, 3:7] = 200
    >>> ArrayCleanUp().fit_transform(press).sum(axis=(1, 2))
    array([221])
    """

    def __init__(
        self,
        shape: tuple[int, int] = (33, 33),
        *,
        gamma: float = 0.5,
        n_sd: float = 2.0,
        n_partitions: int = 2,
        min_contrast: float = 0.0,
        dead: str = "fill",
        output: str = "binary",
    ) -> None:
        self.shape = shape
        self.gamma = gamma
        self.n_sd = n_sd
        self.n_partitions = n_partitions
        self.min_contrast = min_contrast
        self.dead = dead
        self.output = output

    def fit(
        self, X: ArrayLike, y: object = None, *, no_contact: ArrayLike | None = None
    ) -> Self:
        """Check the parameters and note the size of the images; the rest is ignored."""
        images = check_images(X, allow_nan=True)
        check_option("output", self.output, _OUTPUTS)
        self._clean(images[:1])
        self.image_shape_ = (images.shape[1], images.shape[2])
        return self

    def moved(self, X: ArrayLike, no_contact: ArrayLike | None = None) -> Self:
        """Return this clean-up for another array of the same kind."""
        return clone(self).fit(X, no_contact=no_contact)

    def transform(self, X: ArrayLike) -> NDArray:
        """Return cleaned images of shape (n_touches, *shape), bool when binary."""
        check_is_fitted(self)
        return self._clean(check_images(X, shape=self.image_shape_, allow_nan=True))

    def _clean(self, images: NDArray[np.float64]) -> NDArray:
        last = _OUTPUTS.index(self.output)
        cleaned = resize(fill_dead_taxels(images, dead=self.dead), self.shape)
        if last >= 1:
            cleaned = correct_gamma(cleaned, self.gamma)
        if last >= 2:
            cleaned = filter_noise(cleaned, self.n_sd)
        if last < 3:
            return cleaned
        return binarise(cleaned, self.n_partitions, min_contrast=self.min_contrast)

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.input_tags.three_d_array = True
        tags.input_tags.allow_nan = self.dead == "fill"
        return tags


def resize(images: ArrayLike, shape: tuple[int, int] = (33, 33)) -> NDArray[np.float64]:
    """Resize images by linear interpolation between taxel centres.

    Pixels are squares that tile the same field as the taxels; beyond the outermost
    taxel centres the image continues unchanged. A side that shrinks is averaged
    over a triangle as wide as two new pixels, so that no taxel is skipped.

    Parameters
    ----------
    images : array-like of shape (n_touches, n_rows, n_cols)
    shape : tuple of int, default=(33, 33)
        Rows and columns of the result.

    Returns
    -------
    resized : ndarray of shape (n_touches, *shape)
    """
    checked = check_images(images)
    n_rows, n_cols = _check_shape(shape)
    down = _resize_matrix(checked.shape[1], n_rows)
    across = _resize_matrix(checked.shape[2], n_cols)
    return down @ checked @ across.T


def correct_gamma(
    images: ArrayLike, gamma: float = 0.5, *, white: float | None = None
) -> NDArray[np.float64]:
    """Return white x (image / white) ** gamma; negative levels become 0.

    Parameters
    ----------
    images : array-like of shape (n_touches, n_rows, n_cols)
    gamma : float, default=0.5
        Below 1 raises low grey levels, as the paper wants.
    white : float, optional
        Grey level that stays where it is; by default each image's largest. It
        scales the result alone: Otsu's thresholds split the same pixels.

    Returns
    -------
    corrected : ndarray of shape (n_touches, n_rows, n_cols)
    """
    checked = np.maximum(check_images(images), 0)
    exponent = check_positive("gamma", gamma)
    if white is None:
        top = checked.max(axis=(1, 2), keepdims=True)
    else:
        top = np.full((1, 1, 1), check_positive("white", white))
    top = np.where(top > 0, top, 1.0)
    with np.errstate(over="ignore"):
        corrected: NDArray[np.float64] = top * (checked / top) ** exponent
    if not np.isfinite(corrected).all():
        raise ValueError(
            "white must leave the corrected levels finite, got "
            f"{white} with levels up to {checked.max():.3g} and gamma {gamma}. Take a "
            "white near the largest level, or leave it out."
        )
    return corrected


def filter_noise(images: ArrayLike, n_sd: float = 2.0) -> NDArray[np.float64]:
    """Return the images with levels below mean - n_sd x standard deviation set to 0.

    The threshold is often negative on tactile images, most of which is empty: the
    filter then does nothing. It is kept because the paper has it.

    Parameters
    ----------
    images : array-like of shape (n_touches, n_rows, n_cols)
    n_sd : float, default=2.0

    Returns
    -------
    filtered : ndarray of shape (n_touches, n_rows, n_cols)
    """
    checked = check_images(images)
    width = check_positive("n_sd", n_sd)
    mean = checked.mean(axis=(1, 2), keepdims=True)
    spread = checked.std(axis=(1, 2), keepdims=True)
    return np.where(checked < mean - width * spread, 0.0, checked)


def stage_pictures(
    image: ArrayLike, clean_up: ArrayCleanUp | None = None
) -> dict[str, NDArray]:
    """Return every stage of the clean-up of one image, as the paper's Fig. 10.

    Parameters
    ----------
    image : array-like of shape (n_rows, n_cols)
        NaN marks a dead taxel.
    clean_up : ArrayCleanUp, optional
        The chain to show, fitted or not; by default the paper's.

    Returns
    -------
    pictures : dict of str to ndarray
        In order "raw", "filled", "resized", "gamma", "filtered", "binary 1 x 1",
        "binary 2 x 2", "binary 3 x 3"; and "binary n x n" where the chain uses
        another n.
    """
    chain = ArrayCleanUp() if clean_up is None else clean_up
    raw = check_images(np.asarray(image)[np.newaxis], allow_nan=True)
    stages: dict[str, NDArray] = {
        "raw": raw,
        "filled": fill_dead_taxels(raw, dead=chain.dead),
    }
    stages["resized"] = resize(stages["filled"], chain.shape)
    stages["gamma"] = correct_gamma(stages["resized"], chain.gamma)
    stages["filtered"] = filter_noise(stages["gamma"], chain.n_sd)
    for n in sorted({1, 2, 3, chain.n_partitions}):
        stages[f"binary {n} x {n}"] = binarise(
            stages["filtered"], n, min_contrast=chain.min_contrast
        )
    return {name: pictures[0] for name, pictures in stages.items()}


def _check_shape(shape: object) -> tuple[int, int]:
    sides = list(shape) if isinstance(shape, Iterable) else []
    if len(sides) != 2:
        raise ValueError(f"shape must be two integers (n_rows, n_cols), got {shape!r}.")
    return check_count("shape[0]", sides[0]), check_count("shape[1]", sides[1])


def _resize_matrix(n_in: int, n_out: int) -> NDArray[np.float64]:
    """Weights (n_out, n_in) of the old pixels in each new one, along one side."""
    scale = n_in / n_out
    centre = (np.arange(n_out) + 0.5) * scale - 0.5
    if scale < 1:
        centre = centre.clip(0, n_in - 1)
    distance = np.abs(centre[:, None] - np.arange(n_in)) / max(scale, 1.0)
    weight = np.maximum(1 - distance, 0)
    return weight / weight.sum(axis=1, keepdims=True)
