"""What decisions are worth on recorded touches, for docs/explanation/decisions.md.

Run as `python benchmarks/decisions.py FOLDER OUT.json [SECTION ...] [--draws 20]
[--first 0]`, with the folder of recorded touches (`bathtip/bathtip50.npz`,
`taxel10x10/taxel10x10.npz`). Each draw
takes other objects and other training touches; "last" asks the last quarter of each
recording, "random" the touches that were not drawn. One minute for ten draws of six
objects, ten for one of fifty.
"""

import argparse
import json
from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from palpate import Touches
from palpate._durable import write_text
from palpate._types import Floats
from palpate.evaluation import (
    Plan,
    calibration_error,
    evaluate,
    roc_area,
    split_by_count,
    split_touches,
)
from palpate.evaluation._episodes import Episodes
from palpate.evaluation._splits import draw_touches as drawn
from palpate.evaluation._trial import Trial
from palpate.recognition._strangers import stranger_log_shares

ERRORS = (0.01, 0.05)
STRANGERS = (0.0, 0.05, 0.2)
ORDERS = 20
BINS = (0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99)
LENGTHS = (1, 5, 10)
N_UNKNOWN = 10
SPARSE = 8


def main() -> None:
    """Measure the sections asked for, or all; the others stay in the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("sections", nargs="*")
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    dome = Touches.load(options.folder / "bathtip" / "bathtip50.npz")
    array = Touches.load(options.folder / "taxel10x10" / "taxel10x10.npz")
    result = json.loads(options.out.read_text()) if options.out.exists() else {}
    for name in options.sections or SECTIONS:
        draws = []
        for seed in range(options.first, options.first + options.draws):
            touches = array if name == "re-posed presses" else dome
            draws.append(SECTIONS[name](touches, seed))
            print(name, seed, draws[-1], flush=True)
        result[name] = {"first": options.first, "draws": draws}
        write_text(options.out, json.dumps(result, indent=1) + "\n")


def few(n_objects: int, n_each: int, split: str) -> Callable[[Touches, int], object]:
    """Return a section: some random objects, others unknown, random touches taught."""

    def section(touches: Touches, seed: int) -> object:
        rng = np.random.default_rng([seed, n_objects, n_each])
        names = rng.permutation(np.unique(touches.object))
        learnt = np.isin(touches.object, names[:n_objects])
        others = np.isin(touches.object, names[n_objects : n_objects + N_UNKNOWN])
        if split == "random":
            train, test = split_by_count(touches[learnt], n_each, seed)
            return figures(train, test, touches[others])
        (fold,) = split_touches(touches, "last")
        train_rows, test_rows, unknown_rows = (
            np.isin(part.object, wanted)
            for part, wanted in (
                (fold.train, names[:n_objects]),
                (fold.test, names[:n_objects]),
                (fold.test, names[n_objects : n_objects + N_UNKNOWN]),
            )
        )
        train = drawn(fold.train[train_rows], n_each, seed)
        return figures(train, fold.test[test_rows], fold.test[unknown_rows])

    return section


def in_a_row(touches: Touches, seed: int) -> object:
    """Two to five objects, each taught with twelve touches in a row."""
    rng = np.random.default_rng([seed, 12])
    names = rng.permutation(np.unique(touches.object))
    n_objects = 2 + seed % 4
    taught = np.zeros(len(touches), dtype=bool)
    for name in names[:n_objects]:
        rows = in_order(touches, str(name))
        first = rng.integers(0, len(rows) - 12)
        taught[rows[first : first + 12]] = True
    learnt = np.isin(touches.object, names[:n_objects])
    others = np.isin(touches.object, names[n_objects : n_objects + N_UNKNOWN])
    return figures(touches[taught], touches[learnt & ~taught], touches[others])


def all_but_one_each(touches: Touches, seed: int) -> object:
    """Forty objects known, one of each category unknown."""
    (fold,) = split_touches(touches, "last")
    out = []
    for category in np.unique(touches.category):
        names = np.unique(touches.object[touches.category == category])
        out.append(names[seed % len(names)])
    new = np.isin(fold.test.object, out)
    train = fold.train[~np.isin(fold.train.object, out)]
    return figures(train, fold.test[~new], fold.test[new])


def all_fifty(split: str) -> Callable[[Touches, int], object]:
    """Return a section: all fifty objects."""

    def section(touches: Touches, seed: int) -> object:
        if split == "random":
            return figures(*split_by_count(touches, 60, seed), None)
        (fold,) = split_touches(touches, "last")
        return figures(drawn(fold.train, 55, seed), fold.test, None)

    return section


def sparse(touches: Touches, seed: int) -> object:
    """Ten objects with 60 touches, of which five are cut to eight."""
    rng = np.random.default_rng([seed, SPARSE])
    names = rng.permutation(np.unique(touches.object))[:10]
    (fold,) = split_touches(touches[np.isin(touches.object, names)], "last")
    cut = np.isin(fold.train.object, names[:5])
    few_left, others = drawn(fold.train[cut], SPARSE, seed), fold.train[~cut]
    _, (trial,) = evaluate(
        Touches.concatenate([few_left, others]), fold.test, plan=Plan(touches=LENGTHS)
    )
    rows = {}
    for k in LENGTHS:
        truth, beliefs = trial.episodes.after(k)
        right = [(b.argmax(1) == t).mean() for t, b in zip(truth, beliefs, strict=True)]
        is_cut = np.isin(trial.recogniser.classes_[truth], names[:5])
        pair = np.array(right)[is_cut].mean(), np.array(right)[~is_cut].mean()
        rows[str(k)] = [float(share) for share in pair]
    return rows


def unseen(touches: Touches, seed: int) -> object:
    """Categories of ten objects, one of each, that were never touched."""
    folds = split_touches(touches, "unseen-objects")
    fold = folds[seed % len(folds)]
    return figures(fold.train, fold.test, None, label="category")


def presses(touches: Touches, seed: int) -> object:
    """Twelve of 17 objects on a 10 x 10 array, every press turned and shifted."""
    rng = np.random.default_rng([seed, 17])
    names = rng.permutation(np.unique(touches.object))
    posed = Touches(
        np.stack([reposed(image, rng) for image in touches.images]),
        object=touches.object,
        geometry="array",
    )
    first = np.zeros(len(posed), dtype=bool)
    for name in names:
        rows = np.flatnonzero(posed.object == name)
        first[rng.permutation(rows)[: len(rows) // 2]] = True
    learnt = np.isin(posed.object, names[:12])
    return figures(posed[learnt & first], posed[learnt & ~first], posed[~learnt])


def reposed(image: NDArray[np.float64], rng: np.random.Generator) -> Floats:
    """Return a press turned by any angle and shifted by up to two taxels."""
    turned = ndimage.rotate(image, rng.uniform(0, 360), reshape=False, order=1)
    return np.asarray(ndimage.shift(turned, rng.uniform(-2, 2, 2), order=1))


def in_order(touches: Touches, name: str) -> NDArray[np.intp]:
    """Return the touches of an object in the order of its recording."""
    rows = np.flatnonzero(touches.object == name)
    assert touches.order is not None
    return rows[np.argsort(touches.order[rows], kind="stable")]


def figures(
    train: Touches, test: Touches, unknown: Touches | None, label: str = "object"
) -> object:
    """Return how episodes end at each error, and how well unknown objects are found."""
    plan = Plan(touches=LENGTHS, label=label, orders=ORDERS)
    result, (trial,) = evaluate(train, test, unknown=unknown, plan=plan)
    keys = ("accuracy", "ece", "category_accuracy", "unknown_auroc", "unknown_refused")
    row = {key: result[key] for key in keys if key in result}
    row["perfect_ece"] = {str(k): perfect_ece(trial, k) for k in LENGTHS}
    for error, share in product(ERRORS, STRANGERS):
        row[f"{error} {share}"] = ended(trial, error, share)
    row["calibration"] = calibration(trial, 0.05)
    areas = trial.unknown_episodes and {
        str(k): float(
            roc_area(
                trial.episodes.unknown_after(k), trial.unknown_episodes.unknown_after(k)
            )
        )
        for k in LENGTHS
    }
    return row | ({"area": areas} if areas else {})


def ended(trial: Trial, error: float, strangers: float) -> dict[str, float]:
    """Return how the episodes of known and of unknown objects end."""
    ends = trial.episodes.decide(error, strangers=strangers)
    row = {
        "wrong": float((ends.decided & ~ends.refused & ~ends.right).mean()),
        "refused": float(ends.refused.mean()),
        "undecided": float((~ends.decided).mean()),
        "touches": float(ends.touches.mean()),
    } | withdrawn(trial, error, strangers)
    if trial.unknown_episodes is not None:
        new = trial.unknown_episodes.decide(error, strangers=strangers)
        row["unknown named"] = float((new.decided & ~new.refused).mean())
        row["unknown refused"] = float(new.refused.mean())
    return row


def shares_of(episodes: Episodes, strangers: float) -> list[tuple[Floats, Floats]]:
    """Return the probabilities of learnt objects and of none, for each test object."""
    result = []
    for logs, evidence in zip(episodes.beliefs, episodes.unknown, strict=True):
        learnt, unknown = stranger_log_shares(evidence, strangers)
        result.append((np.exp(logs + learnt[..., np.newaxis]), np.exp(unknown)))
    return result


def withdrawn(trial: Trial, error: float, strangers: float) -> dict[str, float]:
    """Return the share of decisions that later touches would take back.

    Both shares, of right and of wrong decisions, are of all decisions.
    """
    n_named, n_back = 0, {True: 0, False: 0}
    parts = shares_of(trial.episodes, strangers)
    for (learnt, unknown), truth in zip(parts, trial.episodes.truth, strict=True):
        shares = np.concatenate([learnt, unknown[..., np.newaxis]], axis=-1)
        sure = shares.max(axis=-1) >= 1 - error
        for order in np.flatnonzero(sure.any(axis=1)):
            first = int(sure[order].argmax())
            named = int(shares[order, first].argmax())
            n_named += 1
            n_back[named == truth] += bool(
                (shares[order, first:, named] <= error).any()
            )
    return {
        "withdrawn right": n_back[True] / max(n_named, 1),
        "withdrawn wrong": n_back[False] / max(n_named, 1),
    }


def calibration(trial: Trial, strangers: float) -> list[list[float]]:
    """Return mean probability, share right and weight of bins of the best answer.

    After 1, 2, 3, 5, 8 and 12 touches, episodes of unknown objects, where there are
    any, weighing the share of strangers; the best answer may be "unknown".
    """
    rows = []
    sets = [(trial.episodes, 1 - strangers), (trial.unknown_episodes, strangers)]
    for episodes, weight in sets:
        if episodes is None:
            continue
        parts = shares_of(episodes, strangers)
        for (learnt, unknown), truth in zip(parts, episodes.truth, strict=True):
            shares = np.concatenate([learnt, unknown[..., np.newaxis]], axis=-1)
            places = [k for k in (0, 1, 2, 4, 7, 11) if k < shares.shape[1]]
            shares = shares[:, places].reshape(-1, shares.shape[-1])
            right = shares.argmax(axis=1) == (truth if truth >= 0 else learnt.shape[-1])
            share = np.full(len(shares), weight / len(shares) / len(episodes.truth))
            rows.append(np.stack([shares.max(axis=1), right, share]))
    best, right, share = np.concatenate(rows, axis=1)
    bins = np.digitize(best, BINS)
    return [
        [
            float(np.average(v[bins == b], weights=share[bins == b]))
            for v in (best, right)
        ]
        + [float(share[bins == b].sum())]
        for b in np.unique(bins)
    ]


def perfect_ece(trial: Trial, k: int) -> float:
    """Return the calibration error that these beliefs would have, were they true."""
    scores = trial.episodes.scores(k)
    if scores is None:
        return float("nan")
    rng = np.random.default_rng(0)
    drawn_hits = (rng.random(len(scores.confidence)) < scores.confidence for _ in "123")
    return float(
        np.mean([calibration_error(scores.confidence, hit) for hit in drawn_hits])
    )


SECTIONS: dict[str, Callable[[Touches, int], object]] = {
    "6 x 22 last": few(6, 22, "last"),
    "6 x 22 random": few(6, 22, "random"),
    "10 x 10 last": few(10, 10, "last"),
    "10 x 60 last": few(10, 60, "last"),
    "10 x 60 random": few(10, 60, "random"),
    "in a row": in_a_row,
    "sparse": sparse,
    "40 and one more of each": all_but_one_each,
    "categories of unseen objects": unseen,
    "re-posed presses": presses,
    "50 last": all_fifty("last"),
    "50 random": all_fifty("random"),
}

if __name__ == "__main__":
    main()
