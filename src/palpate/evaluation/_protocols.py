"""Which touches teach and which are asked: the protocols of a benchmark.

Each makes folds of one set of touches, as row numbers. A recording is what was touched
of one object in one session (and of one `part`, where there is such a column), in
order. Near copies stay on one side: touches of one press (columns `press`, `episode`,
`squeeze` or `idle_of`) are taught together or asked together.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._types import Array
from ..touches import Touches
from ._splits import split_touches

N_RUNS = 5
# More people or sessions than this are asked several at a time.
MOST_FOLDS = 20
RECORDING = ("object", "session", "part")
PRESS = ("press", "episode", "squeeze", "idle_of")

Rows = NDArray[np.intp]
Asked = Iterator[tuple[str, NDArray[np.bool_]]]


class RowFold(NamedTuple):
    """A fold by row numbers: what is asked, in words, and who teaches and is asked."""

    name: str
    train: Rows
    test: Rows


def protocol_folds(
    touches: Touches, protocol: str, label: str, repeats: int, seed: int
) -> tuple[list[RowFold], list[str]]:
    """Return the folds of a protocol, and the objects that none of them can ask.

    In each fold labels that have fewer than two touches to teach are left out.

    Raises
    ------
    ValueError
        The touches do not allow this protocol; the message says why.
    """
    labels = column_of(touches, label)
    objects = column_of(touches, "object")
    folds = []
    for name, asked in PROTOCOLS[protocol](touches, repeats, seed):
        taught, counts = np.unique(labels[~asked], return_counts=True)
        known = np.isin(labels, taught[counts > 1])
        train, test = np.flatnonzero(known & ~asked), np.flatnonzero(known & asked)
        if len(test) and len(np.unique(labels[train])) > 1:
            folds.append(RowFold(name, train, test))
    if not folds:
        raise ValueError(
            f"protocol {protocol!r} must find two {label} labels that it can teach and "
            "ask apart, got fewer. Record them again, in another session or by another "
            "person, or choose another protocol."
        )
    met = np.concatenate([fold.test for fold in folds])
    left_out = np.setdiff1d(objects, objects[met])
    return folds, [str(name) for name in left_out]


def column_of(touches: Touches, name: str) -> Array:
    """Return a column, or say that it is missing."""
    if name not in touches.columns:
        held = ", ".join(touches.columns) or "none"
        raise ValueError(f"touches must have a column {name!r}, got {held}. Add it.")
    return touches.columns[name]


def _column(touches: Touches, name: str) -> Asked:
    values, codes = np.unique(column_of(touches, name), return_inverse=True)
    if len(values) < 2:
        raise ValueError(
            f"touches must have at least two values of {name!r}, got {len(values)}. "
            "Choose another protocol."
        )
    for k in range(min(len(values), MOST_FOLDS)):
        yield ", ".join(map(str, values[k::MOST_FOLDS])), codes % MOST_FOLDS == k


def _blocks(touches: Touches, repeats: int, seed: int) -> Asked:
    place, count, _ = _places(touches)
    for k in range(N_RUNS):
        yield f"run {k + 1} of {N_RUNS}", place * N_RUNS // count == k


def _halves(touches: Touches, repeats: int, seed: int) -> Asked:
    place, count, _ = _places(touches)
    yield "second half", 2 * place >= count


def _random(touches: Touches, repeats: int, seed: int) -> Asked:
    place, count, recording = _places(touches)
    rng = np.random.default_rng(seed)
    for k in range(repeats):
        asked = np.zeros(len(touches), dtype=bool)
        for one in range(recording.max() + 1):
            rows = np.flatnonzero(recording == one)
            n = int(count[rows[0]])
            drawn = rng.permutation(n)[place[rows]]
            asked[rows] = drawn < (max(1, round(n / N_RUNS)) if n > 1 else 0)
        yield f"draw {k + 1} of {repeats}", asked


def _categories(touches: Touches, repeats: int, seed: int) -> Asked:
    names = ("object", "category")
    columns = {name: column_of(touches, name) for name in names}
    bare = Touches(np.zeros((len(touches), 1, 1)), row=range(len(touches)), **columns)
    for fold in split_touches(bare, "unseen-objects"):
        yield fold.name, np.isin(np.arange(len(touches)), fold.test.columns["row"])


PROTOCOLS: dict[str, Callable[[Touches, int, int], Asked]] = {
    "subjects": lambda touches, repeats, seed: _column(touches, "subject"),
    "sessions": lambda touches, repeats, seed: _column(touches, "session"),
    "blocks": _blocks,
    "halves": _halves,
    "random": _random,
    "categories": _categories,
}


def _places(touches: Touches) -> tuple[Rows, Rows, Rows]:
    """Return each touch's press, counted within its recording, and how many it has.

    Also the number of the recording; all of shape (n_touches,).
    """
    recording = _codes(touches, *RECORDING)
    press = _codes(touches, *RECORDING, *PRESS)
    if not any(name in touches.columns for name in PRESS):
        press = np.arange(len(touches))
    order = touches.columns.get("order", np.arange(len(touches)))
    place, count = np.empty_like(press), np.empty_like(press)
    in_order = np.lexsort((order, _codes(touches, "subject"), recording))
    for rows in np.split(in_order, np.flatnonzero(np.diff(recording[in_order])) + 1):
        _, first, which = np.unique(press[rows], return_index=True, return_inverse=True)
        place[rows] = first.argsort().argsort()[which]
        count[rows] = len(first)
    return place, count, recording


def _codes(touches: Touches, *names: str) -> Rows:
    """Number the touches by what these columns hold together, where there are any."""
    codes = np.zeros(len(touches), dtype=np.intp)
    for name in filter(touches.columns.__contains__, names):
        found = np.unique(touches.columns[name], return_inverse=True)[1].ravel()
        codes = np.unique(codes * (found.max() + 1) + found, return_inverse=True)[1]
    return codes
