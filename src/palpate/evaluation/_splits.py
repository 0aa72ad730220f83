"""Which touches train and which test: three splits of one set of touches."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._checks import check_count, check_option
from ..touches import Touches

SPLITS = ("between", "last", "unseen-objects")


@dataclass(frozen=True)
class Fold:
    """One way to train and test: what is tested, in a few words, and disjoint sets."""

    name: str
    train: Touches
    test: Touches


def split_touches(touches: Touches, split: str) -> list[Fold]:
    """Split labelled touches into training and test touches.

    Parameters
    ----------
    touches : Touches
        With `object`, and `category` for "unseen-objects"; `order` is the order of
        the recording where it is given, else the order in the set counts.
    split : {"between", "last", "unseen-objects"}
        "between" tests every fourth touch of each object, "last" the last quarter
        of each recording (places and times not trained on), "unseen-objects" one
        object of every category, in as many folds as the largest category has
        objects.

    Raises
    ------
    ValueError
        If labels are missing, or an object has fewer than 4 touches, or no
        category has two objects.
    """
    check_option("split", split, SPLITS)
    objects = touches.object
    if objects is None:
        raise ValueError(
            "touches must have a column 'object' to be split; name folders after "
            "objects or pass a name pattern."
        )
    if split == "unseen-objects":
        return _unseen_objects(touches, objects)
    test = np.zeros(len(touches), dtype=bool)
    for name in np.unique(objects):
        rows = np.flatnonzero(objects == name)
        if len(rows) < 4:
            raise ValueError(
                f"Every object must have at least 4 touches to be split, "
                f"got {len(rows)} of {str(name)!r}."
            )
        if touches.order is not None:
            rows = rows[np.argsort(touches.order[rows], kind="stable")]
        test[rows[3::4] if split == "between" else rows[-(len(rows) // 4) :]] = True
    return [Fold(split, touches[~test], touches[test])]


def split_by_count(
    touches: Touches, n_train: int, seed: int
) -> tuple[Touches, Touches]:
    """Draw `n_train` touches of each object at random to train; the rest tests."""
    train = _drawn_rows(touches, n_train, seed)
    test = np.setdiff1d(np.arange(len(touches)), train)
    if not len(test):
        raise ValueError(
            f"n_train must leave touches to test, got {n_train}, which takes all."
        )
    return touches[train], touches[test]


def draw_touches(touches: Touches, n_touches: int, seed: int) -> Touches:
    """Draw `n_touches` of each object at random; fewer where it has fewer.

    The drawn touches keep their order.
    """
    return touches[_drawn_rows(touches, n_touches, seed)]


def _drawn_rows(touches: Touches, n_touches: int, seed: int) -> NDArray[np.intp]:
    check_count("train_touches", n_touches, at_least=2)
    if touches.object is None:
        raise ValueError("touches must have a column 'object' to draw from each.")
    rng = np.random.default_rng(seed)
    of_each = [np.flatnonzero(touches.object == n) for n in np.unique(touches.object)]
    drawn = [rng.permutation(rows)[:n_touches] for rows in of_each]
    return np.sort(np.concatenate(drawn))


def _unseen_objects(touches: Touches, objects: NDArray[np.str_]) -> list[Fold]:
    if touches.category is None:
        raise ValueError(
            "split 'unseen-objects' needs a column 'category' beside 'object'."
        )
    kinds = np.unique(touches.category)
    members = [np.unique(objects[touches.category == kind]) for kind in kinds]
    n_folds = max(map(len, members))
    if n_folds < 2:
        raise ValueError(
            "split 'unseen-objects' needs a category with at least two objects, "
            "got one object in each."
        )
    folds = []
    for k in range(n_folds):
        left_out = [m[k] for m in members if len(m) > max(k, 1)]
        test = np.isin(objects, left_out)
        name = f"fold {k + 1} of {n_folds}"
        folds.append(Fold(name, touches[~test], touches[test]))
    return folds
