"""What the training touches are: their labels, and which belong together in time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..touches import Touches

if TYPE_CHECKING:
    from ._source import TouchSource

N_BLOCKS = 5


def training_labels(
    touches: Touches | TouchSource, label: str
) -> tuple[NDArray, NDArray]:
    """Return the labels to learn and the objects they come from, one per touch.

    Raises
    ------
    ValueError
        If labels are missing, fewer than two, or one has a single touch.
    """
    labels = named_labels(touches, label)
    names, counts = np.unique(labels, return_counts=True)
    if len(names) < 2:
        raise ValueError(
            f"touches must hold at least two {label} labels, "
            f"got only {str(names[0])!r}."
        )
    if counts.min() < 2:
        raise ValueError(
            f"Every {label} must have at least 2 touches, "
            f"got 1 of {str(names[counts.argmin()])!r}."
        )
    objects = labels if touches.object is None else touches.object
    return labels, objects


def named_labels(touches: Touches | TouchSource, label: str) -> NDArray:
    """Return the column `label`, "object" or "category", or say how to have one."""
    labels = touches.object if label == "object" else touches.category
    if labels is None:
        raise ValueError(
            f"touches must have a column {label!r} to learn from. Name "
            "folders after objects, pass a name pattern, or add the column to the "
            "archive."
        )
    return labels


def left_out_groups(
    touches: Touches | TouchSource, labels: NDArray, objects: NDArray, label: str
) -> NDArray[np.intp]:
    """Return which training touches are left out together.

    Whole sessions where every object has several, else stretches of each
    recording; in categories of several objects whole objects, since there the
    question is about objects never touched.
    """
    if label == "category" and touches.object is not None:
        groups = blocks_in_order(objects, touches.order)
        for category in np.unique(labels):
            rows = np.flatnonzero(labels == category)
            if len(np.unique(objects[rows])) > 1:
                codes = np.unique(objects[rows], return_inverse=True)[1]
                groups[rows] = groups.max() + 1 + codes
        return groups
    if touches.session is not None:
        visits = np.stack([objects.astype(str), touches.session.astype(str)], axis=1)
        pairs, group = np.unique(visits, axis=0, return_inverse=True)
        if np.unique(pairs[:, 0], return_counts=True)[1].min() > 1:
            by_session: NDArray[np.intp] = group.ravel()
            return by_session
    return blocks_in_order(objects, touches.order)


def blocks_in_order(objects: NDArray, order: NDArray | None = None) -> NDArray[np.intp]:
    """Number the stretches of the recordings, shape (n_touches,).

    Each object's touches, in the order in which they were made, are cut into
    `N_BLOCKS` runs of nearly equal length: neighbours in time, which resemble
    each other, fall into the same stretch.
    """
    group = np.empty(len(objects), dtype=np.intp)
    next_group = 0
    for name in np.unique(objects):
        rows = np.flatnonzero(objects == name)
        if order is not None:
            rows = rows[np.argsort(order[rows], kind="stable")]
        for part in np.array_split(rows, min(N_BLOCKS, len(rows))):
            group[part] = next_group
            next_group += 1
    return group
