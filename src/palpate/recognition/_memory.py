"""What is kept of the training touches, and which of them belong together.

A `Memory` never changes: learning more, forgetting and replacing make a new one, from
which everything after the encoding is learnt again. Its rows are in the order of
learning.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import repeat
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist, pdist

from .._checks import check_label_kinds, one_each, one_spelling
from .._types import Array, Bools, Floats, Indices
from ..classifiers import KernelRidgeClassifier
from ..touches import Touches, TouchSource
from ._evidence import as_touches
from ._sentences import IN_SESSIONS
from ._sessions import N_LOOKS

N_BLOCKS = 5
# Training touches that distances are taken to, and touches compared at once.
MOST_MARKS, AT_ONCE = 2000, 1024
# How many training touches tell what a middling distance is.
N_PAIRED = 300
# Touches of an object are copies below this share of its median squared distance.
COPY = 0.01
# One touch encoded twice differs by less than this share of the median distance from
# the mean: by rounding, of model files in single precision too.
_SAME = 1e-4
# What a decision says of something that was never learnt.
UNKNOWN = "unknown"


@dataclass(frozen=True)
class Memory:
    """What is kept of the training touches, one row a touch.

    Attributes
    ----------
    features : ndarray of shape (n_touches, n_features)
        What the encoder made of them.
    labels, objects : ndarray of shape (n_touches,)
        What is recognised, and whose touches they are.
    blocks : ndarray of int, shape (n_touches,)
        Touches of one number are left out together.
    sessions, subjects : ndarray of str, shape (n_touches,)
        The mounting or day of each, and the person or unit, "" where it is not told.
    nothing : ndarray of bool, shape (n_touches,)
        Which show no contact.
    touch_ids : ndarray of str, shape (n_touches,)
        Where each lies in a library, "" for those of none.
    categories : ndarray of str, shape (n_touches,)
        What kind of thing each is of, "" where it is not told.
    looks : ndarray of shape (n_touches, 7)
        Spectrum and load of each, NaN where an older model did not keep them.
    weights : ndarray of shape (n_touches,)
        What each counts when they are learnt; 1 unless another session confirmed it.
    sensor : mapping or None
        What the sensor was like, and its picture of no contact where one was given; the
        first one that was told stays.
    """

    features: Floats
    labels: Array
    objects: Array
    blocks: Indices
    sessions: NDArray[np.str_]
    subjects: NDArray[np.str_]
    nothing: Bools
    touch_ids: NDArray[np.str_]
    categories: NDArray[np.str_]
    looks: Floats = field(default_factory=lambda: np.empty((0, N_LOOKS)))
    weights: Floats = field(default_factory=lambda: np.empty(0))
    sensor: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        looks = self.looks
        if not len(looks):
            looks = np.full((len(self.labels), N_LOOKS), np.nan)
        for name, values in {"features": self.features, "looks": looks}.items():
            object.__setattr__(self, name, np.asarray(values, dtype=np.float64))
        if not len(self.weights):
            object.__setattr__(self, "weights", np.ones(len(self.labels)))

    def __len__(self) -> int:
        return len(self.labels)

    def stored(self) -> dict[str, Any]:
        """Return what a model file holds, by name: of very many, single precision.

        Neither distances nor posteriors change by more than a thousandth of a nat.
        """
        values = {column.name: getattr(self, column.name) for column in fields(self)}
        if KernelRidgeClassifier.learns_by_landmarks(len(self), len(self.classes)):
            values |= {n: values[n].astype(np.float32) for n in ("features", "looks")}
        return values

    @cached_property
    def classes(self) -> Array:
        """The labels, sorted, shape (n_labels,)."""
        return np.unique(self.labels)

    @cached_property
    def category_of(self) -> NDArray[np.str_]:
        """The category of each of `classes`, "" where not all its touches tell one.

        "unknown" tells none: it is what decisions say of what was never learnt.
        """
        codes = np.searchsorted(self.classes, self.labels)
        names = self.categories[np.unique(codes, return_index=True)[1]]
        differs = (self.categories != names[codes]) | (self.categories == UNKNOWN)
        return np.where(np.bincount(codes[differs], minlength=len(names)), "", names)

    @cached_property
    def nearest(self) -> Nearest:
        """What tells distances to these touches."""
        return Nearest(self)

    def most_like(self, features: Floats, count: int) -> list[list[dict[str, Any]]]:
        """Return the touches nearest to each; none where features hold NaN.

        Distances are told in units of the median among up to `N_PAIRED` of these
        touches; where most pairs of them are alike, among pairs that differ.
        """
        squared = pdist(self.features[:: -(-len(self) // N_PAIRED)], "sqeuclidean")
        if squared.any() and not np.median(squared):
            squared = squared[squared > 0]
        unit = float(np.sqrt(np.median(squared))) if squared.any() else 1.0
        nearest: list[list[dict[str, Any]]] = []
        for vector in features:
            distances = np.linalg.norm(self.features - vector, axis=1)
            finite = np.isfinite(vector).all()
            rows = np.argsort(distances, kind="stable")[:count] if finite else ()
            near = [(str(self.objects[k]), int(k), float(distances[k])) for k in rows]
            nearest.append(
                [{"object": n, "row": k, "distance": d / unit} for n, k, d in near]
            )
        return nearest

    @cached_property
    def block_distances(self) -> tuple[Indices, Floats]:
        """How far each touch is from other blocks of its recording, (n_touches,) each.

        The blocks, of each object in each session, and the logarithm of the distance
        to the nearest touch of another one: what sessions differ by is not in it.
        """
        visits = np.stack([self.objects.astype(str), self.sessions], axis=1)
        visit = np.unique(visits, axis=0, return_inverse=True)[1].ravel()
        blocks = blocks_in_order(visit)
        far = replace(self, blocks=blocks).nearest.log_distances(self.features, blocks)
        return blocks, np.where(np.isnan(far), np.inf, far).min(axis=1)

    @property
    def units(self) -> tuple[int, str]:
        """How many things are left out independently, and what they stand for.

        Objects, whose blocks go wrong together; where whole sessions or persons are
        left out, each object in each of them. What no other object was met in is a
        block of a recording, however many such an object has.
        """
        pairs = np.stack([self.objects.astype(str), self.blocks.astype(str)])
        objects, blocks = np.unique(pairs, axis=1)
        _, block, n_met = np.unique(blocks, return_inverse=True, return_counts=True)
        is_visit = n_met[block] > 1
        n_units = int(is_visit.sum()) + len(np.unique(objects[~is_visit]))
        if is_visit.any():
            return n_units, IN_SESSIONS
        return n_units, "these objects, recorded as when they were learnt"

    def plus(self, other: Self) -> Self:
        """Return both, the other one last, its blocks numbered after these.

        Touches of the other that are copies of these join their blocks; those that tell
        no category are of their object's.
        """
        if not len(self):
            return replace(other, sensor=self.sensor or other.sensor)
        category_of = dict(zip(self.classes.tolist(), self.category_of, strict=True))
        usual = np.array([category_of.get(x, "") for x in other.labels.tolist()])
        later = replace(
            other,
            blocks=other.blocks + self.blocks.max() + 1,
            categories=np.where(other.categories == "", usual, other.categories),
        )
        rows = {
            name: np.concatenate([getattr(self, name), getattr(later, name)])
            for name in _COLUMNS
        }
        both = replace(self, **rows, sensor=self.sensor or other.sensor)
        met_again = np.intersect1d(self.objects, other.objects)
        return both.with_copies_together(np.isin(both.objects, met_again))

    def with_copies_together(self, which: Bools | None = None) -> Self:
        """Return this with nearly the same touches of an object in one block.

        Copies, and frames of one press, would be met in training while they are left
        out. Touches nearer to each other than `COPY` of their object's median squared
        distance all go to the first one's block: of all touches, or of `which`. Where
        that is one block for all, as of a session that is there twice, it is cut anew.
        """
        blocks, last = self.blocks.copy(), self.blocks.max(initial=0)
        among = np.arange(len(self)) if which is None else np.flatnonzero(which)
        for rows in (among[part] for part in rows_of_each(self.objects[among])):
            if len(rows) < 2:
                continue
            copies = _copies(self.features[rows])
            n_touches, touch = connected_components(copies, directed=False)
            if n_touches == len(rows):
                continue
            first = np.full(n_touches, last)
            np.minimum.at(first, touch, self.blocks[rows])
            if len(np.unique(first)) > 1:
                blocks[rows] = first[touch]
                continue
            several = len(np.unique(self.blocks[rows])) > 1
            if several and 2 * np.bincount(touch).max() <= len(rows):
                n_blocks = min(N_BLOCKS, n_touches)
                blocks[rows] = blocks.max() + 1 + touch * n_blocks // n_touches
        return replace(self, blocks=blocks)

    @property
    def copied_elsewhere(self) -> Bools:
        """Which touches are in another session as well, but for rounding."""
        copied = np.zeros(len(self), dtype=bool)
        for rows in rows_of_each(self.objects):
            if len(rows) < 2:
                continue
            copies = _copies(self.features[rows], _SAME**2)
            touch = connected_components(copies, directed=False)[1]
            session = np.unique(self.sessions[rows], return_inverse=True)[1]
            pairs = np.unique(np.stack([touch, session]), axis=1)
            copied[rows] = np.bincount(pairs[0])[touch] > 1
        return copied

    def plus_once(self, other: Self) -> Self:
        """Return both as `plus` does, of touches without an id that are in both one.

        They are of one label, and encoded alike but for rounding. Of the other's labels
        that are several objects each object is one block; see `left_out_groups`.
        """
        labels = np.isin(self.labels, other.labels) & (self.touch_ids == "")
        rows = np.flatnonzero(labels)
        spread = np.linalg.norm(other.features - other.features.mean(axis=0), axis=1)
        limit = _SAME * max(float(np.median(spread)), 1e-12)
        near = cdist(self.features[rows], other.features).min(axis=1) <= limit
        gone = np.zeros(len(self), dtype=bool)
        gone[rows[near]] = True
        both = self.of_rows(~gone).plus(other)
        blocks = both.blocks.copy()
        for label in other.classes:
            rows = np.flatnonzero(both.labels == label)
            codes = np.unique(both.objects[rows], return_inverse=True)[1]
            if codes.any():
                blocks[rows] = blocks.max() + 1 + codes
        return replace(both, blocks=blocks)

    def without(self, labels: Iterable[object]) -> Self:
        """Return what is left when some labels are forgotten."""
        names = set(map(str, labels))
        return self.of_rows([str(label) not in names for label in self.labels])

    def of_rows(self, which: ArrayLike) -> Self:
        """Return the touches for which `which` (n_touches,) is true."""
        rows = np.flatnonzero(which)
        return replace(self, **{n: getattr(self, n)[rows] for n in _COLUMNS})

    def renamed(self, old: str, new: str) -> Self:
        """Return this with a label, and the object of that name, called otherwise."""
        named: dict[str, Any] = {
            column: np.array([new if str(x) == old else x for x in values])
            for column in ("labels", "objects")
            if old in (values := getattr(self, column)).astype(str)
        }
        return replace(self, **named)

    def newest(self, label: object, most: int) -> Self:
        """Return this with `most` touches of a label: evenly of its sessions, the last.

        Of sessions with fewer all are kept.
        """
        rows_of_label = np.flatnonzero(self.labels.astype(str) == str(label))
        age = np.empty(len(rows_of_label), dtype=np.intp)
        for session in np.unique(self.sessions[rows_of_label]):
            rows = self.sessions[rows_of_label] == session
            age[rows] = np.arange(rows.sum())[::-1]
        gone = rows_of_label[np.argsort(age, kind="stable")[most:]]
        return self.of_rows(~np.isin(np.arange(len(self)), gone))


class Nearest:
    """How far touches are from the nearest training touch of each object.

    Of many training touches some of each object stand for all.
    """

    def __init__(self, memory: Memory) -> None:
        step = -(-len(memory) // MOST_MARKS)
        rows = [rows_of_label[::step] for rows_of_label in rows_of_each(memory.labels)]
        self._memory, self._step = memory, step
        self._rows = np.concatenate(rows)
        self._owner = np.repeat(np.arange(len(rows)), [*map(len, rows)])
        self._middle = memory.features.mean(axis=0)
        self._marks = memory.features[self._rows] - self._middle
        self._squares = (self._marks**2).sum(axis=1)
        self._answered: Floats | None = None

    def left_out(self, rows: Indices, before: Nearest | None) -> Floats:
        """Return `log_distances` of training touches, their blocks left out.

        Of all of them or some rows. Those that were asked for `before` more touches
        came are not sought again, if all are asked.
        """
        classes, features = self._memory.classes, self._memory.features
        blocks = self._memory.blocks
        if len(rows) < len(features):
            return self.log_distances(features[rows], blocks[rows])
        earlier = None if before is None else before._answered
        if before is None or earlier is None or not self._goes_on(before):
            self._answered = self.log_distances(features, blocks)
            return self._answered
        n = len(earlier)
        nearer = self.log_distances(features[:n], blocks[:n], since=n)
        columns = np.searchsorted(classes, before._memory.classes)
        nearer[:, columns] = np.fmin(nearer[:, columns], earlier)
        later = self.log_distances(features[n:], blocks[n:])
        self._answered = np.concatenate([nearer, later])
        return self._answered

    def _goes_on(self, before: Nearest) -> bool:
        """Whether more touches come after those of another, with the same marks."""
        ours, theirs = self._memory, before._memory
        alike = self._step == before._step and len(ours) > len(theirs)
        return alike and all(
            np.array_equal(getattr(ours, name)[: len(theirs)], getattr(theirs, name))
            for name in ("labels", "blocks", "features")
        )

    def log_distances(
        self, features: Floats, blocks: Indices | None = None, since: int = 0
    ) -> Floats:
        """Return the logarithms of the distances, shape (n_touches, n_objects).

        `blocks` (n_touches,) are those of training touches, which are left out of what
        they are compared with; NaN where an object has nothing else, or nothing `since`
        a row of the memory.
        """
        if len(features) <= AT_ONCE:
            return self._least(features, blocks, since)
        cuts = [slice(k, k + AT_ONCE) for k in range(0, len(features), AT_ONCE)]
        whose = [None if blocks is None else blocks[cut] for cut in cuts]
        rows = (features[cut] for cut in cuts)
        return np.concatenate([*map(self._least, rows, whose, repeat(since))])

    def _least(self, features: Floats, blocks: Indices | None, since: int) -> Floats:
        marks = self._rows >= since if since else slice(None)
        centred = features - self._middle
        lengths = (centred**2).sum(axis=1)
        squared = (-2 * centred) @ self._marks[marks].T
        squared += self._squares[marks]
        if blocks is not None:
            theirs = self._memory.blocks[self._rows[marks]]
            order = np.argsort(theirs, kind="stable")
            ends = np.cumsum(np.bincount(theirs, minlength=blocks.max() + 1))
            for block in np.unique(blocks):
                same = order[ends[block - 1] if block else 0 : ends[block]]
                squared[np.ix_(blocks == block, same)] = np.inf
        owner = self._owner[marks]
        first = np.flatnonzero(np.diff(owner, prepend=-1))
        least = np.full((len(features), self._owner[-1] + 1), np.inf)
        least[:, owner[first]] = np.minimum.reduceat(squared, first, axis=1)
        least += lengths[:, np.newaxis]
        # Below this the difference of squares is rounding.
        least = np.maximum(least, 2e-12 * lengths[:, np.newaxis] + 1e-300)
        return np.where(np.isfinite(least), 0.5 * np.log(least), np.nan)


def rows_of_each(values: Array) -> list[Indices]:
    """Return the rows of each value that occurs, the values sorted."""
    codes, counts = np.unique(values, return_inverse=True, return_counts=True)[1:]
    return np.split(np.argsort(codes, kind="stable"), np.cumsum(counts)[:-1])


_COLUMNS = [field.name for field in fields(Memory) if field.name != "sensor"]


def labelled(X: Any, y: ArrayLike | None, label: str) -> Touches | TouchSource:
    """Return what is to be learnt as touches with labels, or explain."""
    if isinstance(X, Touches | TouchSource) and y is None:
        return X
    if y is None:
        raise TypeError(
            f"touches must be Touches, got {type(X).__name__} without labels. "
            "Write fit(Touches(images, object=labels)) or fit(images, labels)."
        )
    if isinstance(X, TouchSource):
        raise TypeError(
            "y must be left out for touches of a library, which have their own labels. "
            "Rename objects in the library, or give `library.touches(...)`."
        )
    check_label_kinds(y)
    touches = as_touches(X)
    names = one_each("y", y, len(touches))
    return touches.with_columns(**{label: names.astype(str)})


def training_labels(touches: Touches | TouchSource, label: str) -> tuple[Array, Array]:
    """Return the labels to learn and the objects they come from, one per touch.

    Raises
    ------
    ValueError
        If labels are missing, fewer than two, or one has a single touch or is called
        "unknown".
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
    for name in names:
        check_name(str(name))
    objects = labels if touches.object is None else touches.object
    return labels, objects


def check_name(name: object) -> str:
    """Return the name of an object or category, or say what it should be."""
    if not isinstance(name, str) or not name:
        raise ValueError(f"name must be a text that is not empty, got {name!r}.")
    if one_spelling(name) is None or not name.strip():
        raise ValueError(
            f"name must be of letters that can be printed, got {name!r}. Leave out "
            "line breaks and control characters."
        )
    if name == UNKNOWN:
        raise ValueError(
            f"name must not be {UNKNOWN!r}, which is what `decide` says of things that "
            "were never learnt. Give those touches another label, or leave them out."
        )
    return name


def named_labels(touches: Touches | TouchSource, label: str) -> Array:
    """Return the column `label`, "object" or "category", or say how to have one."""
    labels: Array | None = getattr(touches, label, None)
    if labels is None:
        raise ValueError(
            f"touches must have a column {label!r} to learn from. Name "
            "folders after objects, pass `name_pattern`, or add the column to the "
            "archive."
        )
    return labels


def by_label(
    touches: Touches | TouchSource | None, label: str
) -> Iterator[tuple[str, Touches | TouchSource]]:
    """Yield each name in the column `label`, and its touches; nothing of None."""
    if touches is not None:
        labels = named_labels(touches, label)
        for name in np.unique(labels).tolist():
            yield name, touches[np.flatnonzero(labels == name)]


def left_out_groups(
    touches: Touches | TouchSource, labels: Array, objects: Array, label: str
) -> Indices:
    """Return which training touches are left out together.

    All touches of a person where every object was met by several, else whole sessions
    where every object has several, else blocks of each recording; in categories of
    several objects whole objects, since there the question is about objects never
    touched.
    """
    if label == "category" and touches.object is not None:
        groups = blocks_in_order(objects, touches.order)
        for rows in rows_of_each(labels):
            if len(np.unique(objects[rows])) > 1:
                codes = np.unique(objects[rows], return_inverse=True)[1]
                groups[rows] = groups.max() + 1 + codes
        return groups
    for visits in (touches.subject, touches.session):
        if visits is None:
            continue
        if n_met(objects, visits).min() > 1:
            return np.asarray(np.unique(visits, return_inverse=True)[1])
    return blocks_in_order(objects, touches.order)


def n_met(objects: Array, visits: Array) -> Indices:
    """Return in how many visits each object was met, the objects sorted as texts."""
    pairs = np.stack([objects.astype(str), visits.astype(str)])
    return np.unique(np.unique(pairs, axis=1)[0], return_counts=True)[1]


def _copies(features: Floats, share: float = COPY) -> csr_array:
    """Return which touches of one object are copies of each other, as a graph.

    They are nearer than a `share` of the median squared distance.
    """
    centred = features - features.mean(axis=0)
    squares = np.einsum("ij,ij->i", centred, centred)
    sampled = centred[:: -(-len(centred) // MOST_MARKS)]
    # What is less is rounding.
    limit = share * np.median(pdist(sampled, "sqeuclidean")) + 1e-13 * squares.max()
    pairs = []
    for start in range(0, len(centred), AT_ONCE):
        here = slice(start, start + AT_ONCE)
        squared = centred[here] @ (-2 * centred[start:].T)
        squared += squares[here, np.newaxis]
        squared += squares[start:]
        near, far = np.nonzero(squared <= limit)
        pairs.append(np.stack([near, far]) + start)
    near, far = np.concatenate(pairs, axis=1)
    are_copies = np.ones(len(near), dtype=bool)
    return csr_array((are_copies, (near, far)), (len(features),) * 2)


def blocks_in_order(objects: Array, order: Array | None = None) -> Indices:
    """Number the blocks of the recordings, shape (n_touches,).

    Each object's touches, in the order in which they were made, are cut into
    `N_BLOCKS` runs of nearly equal length: neighbours in time, which resemble
    each other, fall into the same block.
    """
    group = np.empty(len(objects), dtype=np.intp)
    next_group = 0
    for rows in rows_of_each(objects):
        if order is not None:
            rows = rows[np.argsort(order[rows], kind="stable")]
        for part in np.array_split(rows, min(N_BLOCKS, len(rows))):
            group[part] = next_group
            next_group += 1
    return group
