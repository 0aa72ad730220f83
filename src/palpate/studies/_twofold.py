"""Runs of twofold cross-validation with settings chosen inside the training half.

Every setting answers for the test half, so that what the paper did (the setting
that is best on the reported runs) can be shown beside the honest figure (the
setting that inner folds of the training half preferred).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from sklearn.model_selection import StratifiedKFold

Floats = NDArray[np.float64]
Codes = NDArray[np.intp]
Setting = dict[str, Any]


class Method(Protocol):
    """A classifier over its whole grid of settings; labels are whole numbers."""

    @property
    def settings(self) -> Sequence[Setting]:
        """The grid, simplest first: among equally good settings the first is taken."""

    def answers(self, train: Floats, codes: Codes, test: Floats) -> Codes:
        """Return the label of each test touch, shape (n_settings, n_test)."""


@dataclass(frozen=True)
class Half:
    """One half tested.

    `chosen` is the number of the setting that the training half preferred, and
    `right` the share of test touches that each setting names.
    """

    chosen: int
    right: Floats
    n_test: int


@dataclass(frozen=True)
class Figure:
    """Mean and standard deviation over runs, in per cent, and the setting behind.

    `sd` is None after a single run. `share` is the share of halves that chose
    `setting`, the most frequent one.
    """

    mean: float
    sd: float | None
    setting: Setting
    share: float


def judge_half(
    method: Method,
    features: Floats,
    codes: Codes,
    train: Codes,
    test: Codes,
    *,
    scaled: bool,
    inner_folds: int,
    seed: int,
) -> Half:
    """Choose a setting on the training touches, and test every setting.

    Labels of test touches are only compared with the answers.
    """
    known, labels = features[train], codes[train]
    chosen = _choose(method, known, labels, scaled, inner_folds, seed)
    answers = _answers(method, known, labels, features[test], scaled)
    right = (answers == codes[test]).mean(axis=1)
    return Half(chosen, right, len(test))


def judge_run(
    method: Method,
    features: Floats,
    codes: Codes,
    *,
    scaled: bool,
    inner_folds: int,
    seed: Sequence[int],
) -> list[Half]:
    """Cut the touches into two halves, class by class, and test each on the other."""
    split_seed, inner_seed = np.random.SeedSequence(seed).generate_state(2).tolist()
    halves = StratifiedKFold(2, shuffle=True, random_state=split_seed)
    return [
        judge_half(
            method,
            features,
            codes,
            train,
            test,
            scaled=scaled,
            inner_folds=inner_folds,
            seed=inner_seed,
        )
        for train, test in halves.split(features, codes)
    ]


def nested_figure(settings: Sequence[Setting], runs: Sequence[list[Half]]) -> Figure:
    """Return what the settings chosen inside the training halves achieve."""
    shares = np.array([_pooled(run, [half.chosen for half in run]) for run in runs])
    chosen = np.array([half.chosen for run in runs for half in run])
    counts = np.bincount(chosen, minlength=len(settings))
    most = int(counts.argmax())
    return Figure(*_summary(shares), settings[most], float(counts[most] / len(chosen)))


def paper_figure(settings: Sequence[Setting], runs: Sequence[list[Half]]) -> Figure:
    """Return the setting that is best on these very runs, as the paper does."""
    shares = np.array(
        [[_pooled(run, [s] * len(run)) for s in range(len(settings))] for run in runs]
    )
    best = int(shares.mean(axis=0).argmax())
    return Figure(*_summary(shares[:, best]), settings[best], 1.0)


def _choose(
    method: Method,
    known: Floats,
    labels: Codes,
    scaled: bool,
    inner_folds: int,
    seed: int,
) -> int:
    if len(method.settings) == 1:
        return 0
    right = np.zeros(len(method.settings))
    folds = StratifiedKFold(inner_folds, shuffle=True, random_state=seed)
    for train, held in folds.split(known, labels):
        answers = _answers(method, known[train], labels[train], known[held], scaled)
        right += (answers == labels[held]).sum(axis=1)
    return int(right.argmax())


def _answers(
    method: Method, known: Floats, labels: Codes, asked: Floats, scaled: bool
) -> Codes:
    if scaled:
        centre, spread = known.mean(axis=0), known.std(axis=0)
        # A constant feature keeps rounding of its own size as its spread.
        constant = spread <= 1e-12 * np.abs(known).max(axis=0)
        spread = np.where(constant, 1.0, spread)
        known, asked = (known - centre) / spread, (asked - centre) / spread
    return method.answers(known, labels, asked)


def _pooled(run: Sequence[Half], settings: Sequence[int]) -> float:
    """Share right over both halves, each with its own setting."""
    right = sum(
        half.right[s] * half.n_test for half, s in zip(run, settings, strict=True)
    )
    return float(right / sum(half.n_test for half in run))


def _summary(shares: NDArray[Any]) -> tuple[float, float | None]:
    per_cent = 100 * shares
    spread = float(per_cent.std(ddof=1)) if len(shares) > 1 else None
    return float(per_cent.mean()), spread
