"""Cleaning images of a pressure array, as layer 1 of Liu et al. 2014.

Dead taxels are filled, the image is enlarged, gamma raises the low grey levels, a
filter removes what is far below the mean, and Otsu's threshold, partition by
partition, makes the image binary. Each step is a function; `ArrayCleanUp` is the
chain. Arrays of any shape are accepted, 10 x 10 taxels to 33 x 33 pixels being the
paper's (doi:10.1155/2014/497275). `ChannelMean` brings several channels to grey, or to
how large they are.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve
from sklearn.base import clone
from sklearn.utils import Tags

from .. import _checks
from .._checks import check_count, check_images, check_option, check_positive
from .._image_estimator import ImageEstimator
from .._numbers import otsu_thresholds
from .._types import Array, Bools, Floats

_OUTPUTS = ("resized", "gamma", "filtered", "binary")


class NoLivingTaxelError(ValueError):
    """An image holds nothing but NaN, so that no taxel can be filled."""


class ArrayCleanUp(ImageEstimator):
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

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.images import ArrayCleanUp
    >>> press = np.zeros((1, 10, 10))
    >>> press[0, 3:7, 3:7] = 200
    >>> ArrayCleanUp().fit_transform(press).sum(axis=(1, 2))
    array([221])
    """

    _takes = "nan"

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
        self.gamma, self.n_sd = gamma, n_sd
        self.n_partitions, self.min_contrast = n_partitions, min_contrast
        self.dead, self.output = dead, output

    def fit(
        self, X: ArrayLike, y: object = None, *, no_contact: ArrayLike | None = None
    ) -> Self:
        """Check the parameters and note the size of the images; the rest is ignored."""
        return super().fit(X, y)

    def moved(self, X: ArrayLike, no_contact: ArrayLike | None = None) -> Self:
        """Return this clean-up for another array of the same kind."""
        other: Self = clone(self).fit(X, no_contact=no_contact)
        return other

    def _learn(self, images: Array) -> None:
        self.transform_checked(images[:1])

    def transform_checked(self, images: Array) -> Array:
        """Return cleaned images of shape (n_touches, *shape), bool when binary."""
        wanted = check_option("output", self.output, _OUTPUTS)
        return next(stage for step, stage in self._steps(images) if step == wanted)

    def _steps(self, images: Array) -> Iterator[tuple[str, Array]]:
        resized = resize(fill_dead_taxels(images, dead=self.dead), self.shape)
        yield "resized", resized
        corrected = correct_gamma(resized, self.gamma)
        yield "gamma", corrected
        filtered = filter_noise(corrected, self.n_sd)
        yield "filtered", filtered
        binary = binarise(filtered, self.n_partitions, min_contrast=self.min_contrast)
        yield "binary", binary

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.allow_nan = self.dead == "fill"
        return tags


def resize(images: Floats, shape: tuple[int, int]) -> Floats:
    """Resize images linearly between taxel centres, (n_touches, *shape).

    A side that shrinks is averaged over a triangle two new pixels wide.
    """
    sides = list(shape) if isinstance(shape, Iterable) else []
    if len(sides) != 2:
        raise ValueError(f"shape must be two integers (n_rows, n_cols), got {shape!r}.")
    down = _resize_matrix(images.shape[1], check_count("shape[0]", sides[0]))
    across = _resize_matrix(images.shape[2], check_count("shape[1]", sides[1]))
    return down @ images @ across.T


def correct_gamma(images: Floats, gamma: float) -> Floats:
    """Return white x (image / white) ** gamma, `white` the largest level of each image.

    Negative levels become 0.
    """
    exponent = check_positive("gamma", gamma)
    levels = np.maximum(images, 0)
    top = levels.max(axis=(1, 2), keepdims=True)
    top = np.where(top > 0, top, 1.0)
    return np.asarray(top * (levels / top) ** exponent)


def filter_noise(images: Floats, n_sd: float) -> Floats:
    """Return images with levels below mean - n_sd x standard deviation set to 0.

    Often there are none, as most of a tactile image is empty; the paper has this step.
    """
    width = check_positive("n_sd", n_sd)
    mean = images.mean(axis=(1, 2), keepdims=True)
    spread = images.std(axis=(1, 2), keepdims=True)
    return np.where(images < mean - width * spread, 0.0, images)


def binarise(images: Floats, n_partitions: int, *, min_contrast: float = 0.0) -> Bools:
    """Threshold each of n x n partitions of each image by its own Otsu threshold.

    Partitions that span at most the share `min_contrast` of the image's span are
    constant: background, or where their level is above the whole image's threshold,
    foreground.
    """
    shorter = min(images.shape[1:])
    n_parts = check_count("n_partitions", n_partitions, at_most=shorter)
    contrast = _checks.check_number("min_contrast", min_contrast, low=0, high=1)
    whole = otsu_thresholds(images.reshape(len(images), -1))
    span = np.ptp(images, axis=(1, 2))
    binary = np.empty(images.shape, dtype=bool)
    for rows in np.array_split(np.arange(images.shape[1]), n_parts):
        for cols in np.array_split(np.arange(images.shape[2]), n_parts):
            block = np.s_[:, rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
            binary[block] = _binarise_block(images[block], whole, contrast * span)
    return binary


def _resize_matrix(n_in: int, n_out: int) -> Floats:
    """Weights (n_out, n_in) of the old pixels in each new one, along one side."""
    scale = n_in / n_out
    centre = (np.arange(n_out) + 0.5) * scale - 0.5
    if scale < 1:
        centre = centre.clip(0, n_in - 1)
    distance = np.abs(centre[:, None] - np.arange(n_in)) / max(scale, 1.0)
    weight = np.maximum(1 - distance, 0)
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))


def _binarise_block(block: Floats, whole: Floats, least_span: Floats) -> Bools:
    flat = block.reshape(len(block), -1)
    threshold = otsu_thresholds(flat)
    constant = np.isnan(threshold) | (np.ptp(flat, axis=1) <= least_span)
    # Comparisons with NaN are false: an image without a threshold is background.
    level_is_high = flat.mean(axis=1) > whole
    foreground = np.where(
        constant[:, None], level_is_high[:, None], flat > threshold[:, None]
    )
    return foreground.reshape(block.shape)


def fill_dead_taxels(images: ArrayLike, *, dead: str = "fill") -> Floats:
    """Return the images without NaN.

    A dead taxel takes the mean of its up, down, left and right neighbours; where
    those are dead too, all of them are solved for together (the discrete Laplace
    equation), so that a whole dead row or corner is filled smoothly.

    Parameters
    ----------
    images : array-like of shape (n_touches, n_rows, n_cols[, n_channels])
        NaN marks a dead taxel; each image may have its own. Channels are filled one by
        one.
    dead : {"fill", "refuse"}, default="fill"
        "refuse" raises instead of filling.

    Returns
    -------
    filled : ndarray of the shape of `images`
        A copy where anything was filled. No value lies outside the range of the
        living taxels of its image.

    Raises
    ------
    ValueError
        Where an image has no living taxel, or has a dead one and `dead` is
        "refuse".

    Examples
    --------
    >>> from palpate.images import fill_dead_taxels
    >>> fill_dead_taxels([[[1.0, float("nan"), 3.0]]])
    array([[[1., 2., 3.]]])
    """
    if np.ndim(images) == 4:
        channels = np.moveaxis(np.asarray(images), -1, 0)
        return np.stack([fill_dead_taxels(plane, dead=dead) for plane in channels], -1)
    checked = check_images(images, allow_nan=True)
    check_option("dead", dead, ("fill", "refuse"))
    is_dead = np.isnan(checked)
    if not is_dead.any():
        return checked
    count = is_dead.sum(axis=(1, 2))
    if dead == "refuse":
        touch = int(np.flatnonzero(count)[0])
        raise ValueError(
            f"Images must have no dead taxels, got {count[touch]} NaN in touch "
            f'{touch}. Pass dead="fill" to fill them from their neighbours.'
        )
    whole = np.flatnonzero(count == checked[0].size)
    if len(whole):
        raise NoLivingTaxelError(
            f"Images must have at least one living taxel, got only NaN in touch "
            f"{whole[0]}. Leave that touch out."
        )
    filled = checked.copy()
    patterns, which = np.unique(
        is_dead.reshape(len(checked), -1), axis=0, return_inverse=True
    )
    for index, pattern in enumerate(patterns):
        if pattern.any():
            same = np.flatnonzero(which.ravel() == index)
            filled[same] = _solve(filled[same], pattern.reshape(checked.shape[1:]))
    return filled


def _solve(images: Floats, is_dead: Bools) -> Floats:
    """Solve for the taxels of `is_dead`, the same in each of `images`."""
    number = np.where(is_dead, np.cumsum(is_dead).reshape(is_dead.shape) - 1, -1)
    n_dead = int(is_dead.sum())
    diagonal, sums = np.zeros(n_dead), np.zeros((n_dead, len(images)))
    pairs: list[Array] = []
    # Slices that pair each taxel with its right and lower neighbour, and the reverse.
    whole, head, tail = slice(None), slice(None, -1), slice(1, None)
    across = [((whole, head), (whole, tail)), ((head, whole), (tail, whole))]
    for here, there in across + [(there, here) for here, there in across]:
        unknown = number[here][is_dead[here]]
        neighbour = number[there][is_dead[here]]
        np.add.at(diagonal, unknown, 1)
        alive = neighbour < 0
        levels = images[:, *there][:, is_dead[here]].T
        np.add.at(sums, unknown[alive], levels[alive])
        pairs.append(np.stack([unknown[~alive], neighbour[~alive]]))
    row, col = np.hstack([*pairs, np.tile(np.arange(n_dead), (2, 1))])
    weight = np.concatenate([-np.ones(len(row) - n_dead), diagonal])
    matrix = coo_array((weight, (row, col)), shape=(n_dead, n_dead)).tocsc()
    solved = images.copy()
    solved[:, is_dead] = spsolve(matrix, sums).reshape(n_dead, -1).T
    return solved


class ChannelMean(ImageEstimator, by_channel=False):
    """Bring images of several channels to grey, their mean; grey ones stay.

    Parameters
    ----------
    squared : bool, default=False
        The root of the mean square of the channels in place of their mean: how large a
        force on three axes is, whichever way it points.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.images import ChannelMean
    >>> forces = np.array([[[[3.0, 4.0], [-4.0, 3.0]]]])
    >>> ChannelMean().fit_transform(forces)
    array([[[ 3.5, -0.5]]])
    >>> ChannelMean(squared=True).fit_transform(forces).round(2)
    array([[[3.54, 3.54]]])
    """

    def __init__(self, squared: bool = False) -> None:
        self.squared = squared

    def _learn(self, images: Array) -> None:
        check_option("squared", self.squared, (False, True))

    def transform_checked(self, images: Array) -> Array:
        """Return images of shape (n_touches, n_rows, n_cols)."""
        if images.ndim == 3:
            return images
        kind = np.result_type(images.dtype, np.float32)
        # Channel by channel: `mean` over so short an axis takes several times as long.
        grey: Floats = np.zeros(images.shape[:3], dtype=kind)
        for channel in np.moveaxis(images, -1, 0):
            grey += np.square(channel, dtype=kind) if self.squared else channel
        grey /= images.shape[3]
        return np.sqrt(grey) if self.squared else grey
