"""Which touches train and which test: splits of one set, and protocols of a benchmark.

Protocols make folds of row numbers. A recording is what was touched of one object in
one session (and of one `part`, where there is such a column), in order. Near copies
stay on one side: touches of one press (columns `press`, `episode`, `squeeze` or
`idle_of`) are taught together or asked together. Splits know of neither: "between" and
"last" count the touches of an object, in all of its sessions.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, get_args

import numpy as np

from .._checks import check_count, check_option, listed
from .._types import Array, Bools, Indices, Split
from ..touches import Touches

VISITS = ("session", "subject")
SPLITS = get_args(Split)
# Splits by the order of an object's touches: which of so many are asked.
IN_ORDER: dict[str, Callable[[int], slice]] = {
    "between": lambda n_touches: slice(3, None, 4),
    "last": lambda n_touches: slice(n_touches - n_touches // 4, None),
}
N_RUNS = 5
# More people or sessions than this are asked several at a time.
MOST_FOLDS = 20
RECORDING = ("object", "session", "part")
PRESS = ("press", "episode", "squeeze", "idle_of")

TestMasks = Iterator[tuple[str, Bools]]


@dataclass(frozen=True)
class Fold:
    """One way to train and test: what is tested, in a few words, and disjoint sets.

    `left_out` are the objects that no fold can ask.
    """

    name: str
    train: Touches
    test: Touches
    left_out: tuple[str, ...] = ()

    @property
    def elsewhere(self) -> bool:
        """Whether nothing was learnt from any session of the test touches."""
        taught, tested = self.train.session, self.test.session
        if taught is None or tested is None:
            return False
        return not np.isin(tested, taught).any()

    @property
    def n_taught(self) -> int:
        """How many test touches have the levels of a training touch, of any type.

        Those of one level alone, as without contact, are no copies.
        """
        learnt_digests, test_digests = (
            [
                hash((image.astype(float) + 0.0).tobytes())  # no -0.0
                for image in touches.images
                if np.nanmax(image) > np.nanmin(image)
            ]
            for touches in (self.train, self.test)
        )
        return int(np.isin(test_digests, learnt_digests).sum())


class RowFold(NamedTuple):
    """A fold by row numbers: what is asked, in words, and who teaches and is asked."""

    name: str
    train: Indices
    test: Indices


def split_touches(touches: Touches, split: str, label: str = "object") -> list[Fold]:
    """Split labelled touches into training and test touches.

    Parameters
    ----------
    touches : Touches
        With `object`, and `category` for "unseen-objects"; `order` is the order of
        the recording where it is given, else the order in the set counts.
    split : {"between", "last", "unseen-objects", "session", "subject"}
        "between" tests every fourth touch of each object, "last" the last quarter
        of each object's touches (places and times not trained on; of several sessions
        with one running order, those of the last session), "unseen-objects" one
        object of every category, in as many folds as the largest category has
        objects. "session" and "subject" test each session or person in turn, of many
        several at a time, and the others train; objects that no other met are left
        out.
    label : {"object", "category"}, default="object"
        What the others must have met, for "session" and "subject".

    Raises
    ------
    ValueError
        If labels are missing, or an object has fewer than 4 touches, or no
        category has two objects, or all is of one session or person.
    """
    check_option("split", split, SPLITS)
    check_touches("touches", touches)
    objects = column_of(touches, "object")
    if split == "unseen-objects":
        masks = [*_categories(touches, repeats=1, seed=0)]
        met = objects[np.any([test for _, test in masks], axis=0)]
        left_out = tuple(map(str, np.setdiff1d(objects, met)))
        return [
            Fold(name, touches[~test], touches[test], left_out) for name, test in masks
        ]
    if split in VISITS:
        parts, gone = protocol_folds(touches, f"{split}s", label, repeats=1, seed=0)
        left_out = tuple(gone)
        return [
            Fold(f"{split} {name}", touches[train], touches[test], left_out)
            for name, train, test in parts
        ]
    test, order = np.zeros(len(touches), dtype=bool), recorded_order(touches)
    for name in np.unique(objects):
        rows = np.flatnonzero(objects == name)
        if len(rows) < 4:
            raise ValueError(
                f"Every object must have at least 4 touches to be split, "
                f"got {len(rows)} of {str(name)!r}."
            )
        if order is not None:
            rows = rows[np.argsort(order[rows], kind="stable")]
        test[rows[IN_ORDER[split](len(rows))]] = True
    return [Fold(split, touches[~test], touches[test])]


def recorded_order(touches: Touches) -> Array | None:
    """Return what tells the order of touches: `order`, or when they were made."""
    if touches.order is not None:
        return touches.order
    time_s = touches.columns.get("time_s")
    has_times = time_s is not None and bool(np.isfinite(time_s).all())
    return time_s if has_times else None


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
    for name, is_test in PROTOCOLS[protocol](touches, repeats, seed):
        taught, counts = np.unique(labels[~is_test], return_counts=True)
        teachable = np.isin(labels, taught[counts > 1])
        train = np.flatnonzero(teachable & ~is_test)
        test = np.flatnonzero(teachable & is_test)
        if len(test) and len(np.unique(labels[train])) > 1:
            folds.append(RowFold(name, train, test))
    if not folds:
        raise ValueError(
            f"protocol {protocol!r} must find two {label} labels with touches both to "
            "learn and to test, got fewer. Record them again, in another session or by "
            "another person, or choose another split or protocol."
        )
    met = np.concatenate([fold.test for fold in folds])
    left_out = np.setdiff1d(objects, objects[met])
    return folds, [str(name) for name in left_out]


def check_touches(name: str, touches: object) -> None:
    """Refuse what is not `Touches`."""
    if not isinstance(touches, Touches):
        raise TypeError(
            f"{name} must be Touches, got {type(touches).__name__}. Write "
            "Touches(images, object=labels)."
        )


def column_of(touches: Touches, name: str) -> Array:
    """Return a column, or say that it is missing; objects are of one category each."""
    if name not in touches.columns:
        held = ", ".join(touches.columns) or "none"
        raise ValueError(
            f"The touches must have a column {name!r}, got {held}. Add it, or name "
            "folders after objects or pass `name_pattern`."
        )
    if name == "category" and touches.object is not None:
        pairs = np.unique(np.stack([touches.object, touches.columns[name]]), axis=1)
        objects, counts = np.unique(pairs[0], return_counts=True)
        if counts.max() > 1:
            several = str(objects[counts.argmax()])
            listing = listed(pairs[1, pairs[0] == several].tolist(), 3)
            raise ValueError(
                f"Objects must be of one category each, got {several!r} of {listing}. "
                "Name different objects differently, such as after their category too."
            )
    return touches.columns[name]


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


def _drawn_rows(touches: Touches, n_touches: int, seed: int) -> Indices:
    check_count("train_touches", n_touches, at_least=2)
    objects = column_of(touches, "object")
    rng = np.random.default_rng(seed)
    of_each = [np.flatnonzero(objects == name) for name in np.unique(objects)]
    drawn = [rng.permutation(rows)[:n_touches] for rows in of_each]
    return np.sort(np.concatenate(drawn))


def _column(touches: Touches, name: str) -> TestMasks:
    values, codes = np.unique(column_of(touches, name), return_inverse=True)
    if len(values) < 2:
        raise ValueError(
            f"touches must have at least two values of {name!r}, got {len(values)}. "
            "Record another one, or choose another split or protocol."
        )
    for k in range(min(len(values), MOST_FOLDS)):
        yield ", ".join(map(str, values[k::MOST_FOLDS])), codes % MOST_FOLDS == k


def _blocks(touches: Touches, repeats: int, seed: int) -> TestMasks:
    place, count, _ = _places(touches)
    for k in range(N_RUNS):
        yield f"run {k + 1} of {N_RUNS}", place * N_RUNS // count == k


def _halves(touches: Touches, repeats: int, seed: int) -> TestMasks:
    place, count, _ = _places(touches)
    yield "second half", 2 * place >= count


def _random(touches: Touches, repeats: int, seed: int) -> TestMasks:
    place, count, recording = _places(touches)
    rng = np.random.default_rng(seed)
    for k in range(repeats):
        is_test = np.zeros(len(touches), dtype=bool)
        for number in range(recording.max() + 1):
            rows = np.flatnonzero(recording == number)
            n = int(count[rows[0]])
            drawn = rng.permutation(n)[place[rows]]
            is_test[rows] = drawn < (max(1, round(n / N_RUNS)) if n > 1 else 0)
        yield f"draw {k + 1} of {repeats}", is_test


def _categories(touches: Touches, repeats: int, seed: int) -> TestMasks:
    """Leave one object of every category out, in as many folds as the most have."""
    objects, categories = (column_of(touches, n) for n in ("object", "category"))
    members = [np.unique(objects[categories == k]) for k in np.unique(categories)]
    n_folds = max(map(len, members))
    if n_folds < 2:
        raise ValueError(
            "split 'unseen-objects' needs a category with at least two objects, "
            "got one object in each."
        )
    for k in range(n_folds):
        left_out = [m[k] for m in members if len(m) > max(k, 1)]
        yield f"fold {k + 1} of {n_folds}", np.isin(objects, left_out)


PROTOCOLS: dict[str, Callable[[Touches, int, int], TestMasks]] = {
    "subjects": lambda touches, repeats, seed: _column(touches, "subject"),
    "sessions": lambda touches, repeats, seed: _column(touches, "session"),
    "blocks": _blocks,
    "halves": _halves,
    "random": _random,
    "categories": _categories,
}


def _places(touches: Touches) -> tuple[Indices, Indices, Indices]:
    """Return each touch's press, counted within its recording, and how many it has.

    Also the number of the recording; all of shape (n_touches,).
    """
    recording = _codes(touches, *RECORDING)
    press = _codes(touches, *RECORDING, *PRESS)
    if not any(name in touches.columns for name in PRESS):
        press = np.arange(len(touches))
    order = recorded_order(touches)
    order = np.arange(len(touches)) if order is None else order
    place, count = np.empty_like(press), np.empty_like(press)
    in_order = np.lexsort((order, _codes(touches, "subject"), recording))
    for rows in np.split(in_order, np.flatnonzero(np.diff(recording[in_order])) + 1):
        _, first, which = np.unique(press[rows], return_index=True, return_inverse=True)
        place[rows] = first.argsort().argsort()[which]
        count[rows] = len(first)
    return place, count, recording


def _codes(touches: Touches, *names: str) -> Indices:
    """Number the touches by what these columns hold together, where there are any."""
    codes = np.zeros(len(touches), dtype=np.intp)
    for name in filter(touches.columns.__contains__, names):
        # What is no part of a press (NaN) is one by itself.
        values, of_column = np.unique(
            touches.columns[name], return_inverse=True, equal_nan=name not in PRESS
        )
        codes = codes * len(values) + of_column.ravel()
        codes = np.unique(codes, return_inverse=True)[1]
    return codes
