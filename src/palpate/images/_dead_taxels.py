"""Dead taxels: NaN in an image, filled from the neighbours or refused."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve

from .._checks import check_images, check_option
from .._types import Array, Floats


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
        return np.stack([fill_dead_taxels(one, dead=dead) for one in channels], -1)
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
        raise ValueError(
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


def _solve(images: Floats, is_dead: NDArray[np.bool_]) -> Floats:
    """Solve for the taxels of `is_dead`, the same in each of `images`."""
    number = np.where(is_dead, np.cumsum(is_dead).reshape(is_dead.shape) - 1, -1)
    n_dead = int(is_dead.sum())
    diagonal, known = np.zeros(n_dead), np.zeros((n_dead, len(images)))
    pairs: list[Array] = []
    # Slices that pair each taxel with its right and lower neighbour, and the reverse.
    every, head, tail = slice(None), slice(None, -1), slice(1, None)
    across = [((every, head), (every, tail)), ((head, every), (tail, every))]
    for here, there in across + [(there, here) for here, there in across]:
        unknown = number[here][is_dead[here]]
        neighbour = number[there][is_dead[here]]
        np.add.at(diagonal, unknown, 1)
        alive = neighbour < 0
        levels = images[:, *there][:, is_dead[here]].T
        np.add.at(known, unknown[alive], levels[alive])
        pairs.append(np.stack([unknown[~alive], neighbour[~alive]]))
    row, col = np.hstack([*pairs, np.tile(np.arange(n_dead), (2, 1))])
    weight = np.concatenate([-np.ones(len(row) - n_dead), diagonal])
    matrix = coo_array((weight, (row, col)), shape=(n_dead, n_dead)).tocsc()
    solved = images.copy()
    solved[:, is_dead] = spsolve(matrix, known).reshape(n_dead, -1).T
    return solved
