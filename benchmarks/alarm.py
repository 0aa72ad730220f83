"""What the alarm catches: costly sessions after ten touches, and how often it is false.

    python benchmarks/alarm.py ../data [SET ...]

Of each set of `rehearsal.py` the last quarter of every recording is held back (of
recordings shorter than four touches a quarter at random). False alarms are ten touches
held back from the same mounting: of all objects, of three, of one. Caught are ten
touches of the session that asks, and of touches held back that were changed by another
law than the rehearsed one, at four strengths: those that lost more than 10 points.
"""

import sys
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from palpate import Touches
from palpate.recognition import ObjectRecogniser
from rehearsal import SETS, Split, accuracy, replaced

N_TOUCHES, DRAWS, COSTLY = 10, 30, 10.0
FEW = (None, 3, 1)
STRENGTHS = (0.3, 0.6, 1.0, 1.5)
SEEDS = range(3)


class Figures(NamedTuple):
    """Shares of draws that raise the alarm, and points of accuracy that were lost."""

    false: list[float]
    lost: float
    caught: float
    costly: list[float]
    n_changed: int


def held_back(touches: Touches) -> Split:
    """Hold back the last quarter of each object's recording in each session."""
    visit = touches.object.astype(str)
    for name in ("session", "subject", "part"):
        if name in touches.columns:
            visit = np.char.add(visit, touches.columns[name].astype(str))
    order = np.arange(len(touches)) if touches.order is None else touches.order
    if np.unique(visit, return_counts=True)[1].min() < 4:
        visit = touches.object
        order = np.random.default_rng(0).permutation(len(touches))
    late = np.zeros(len(touches), dtype=bool)
    for name in np.unique(visit):
        rows = np.flatnonzero(visit == name)
        rows = rows[np.argsort(order[rows], kind="stable")]
        late[rows[-max(1, len(rows) // 4) :]] = True
    return Split(touches[~late], touches[late])


def changed(touches: Touches, strength: float, seed: int) -> Touches:
    """Return touches as another camera, or other electronics, might show them."""
    rng = np.random.default_rng([seed, int(100 * strength)])
    if max(touches.images.shape[1:3]) > 100:
        return replaced(touches, _camera(touches.images, strength, rng))
    return replaced(touches, _readout(touches.images, strength, rng))


def _camera(images: np.ndarray, s: float, rng: np.random.Generator) -> np.ndarray:
    """Turn, enlarge and move pictures, with another power law and falling light."""
    n_rows, n_cols = images.shape[1:3]
    top = 255.0 if images.max() > 1 else 1.0
    size = np.exp(rng.normal(0, 0.02 * s))
    turn = cv2.getRotationMatrix2D((n_cols / 2, n_rows / 2), rng.normal(0, 2 * s), size)
    turn[:, 2] += rng.normal(0, 0.03 * n_rows * s, 2)
    across = np.linspace(-1, 1, n_cols) * rng.normal(0, 0.05 * s)
    down = np.linspace(-1, 1, n_rows)[:, np.newaxis] * rng.normal(0, 0.05 * s)
    power = np.exp(rng.normal(0, 0.05 * s))
    moved = [cv2.warpAffine(i, turn, (n_cols, n_rows), borderMode=1) for i in images]
    light = 1 + across + down
    levels = (np.maximum(np.stack(moved), 0) / top) ** power
    levels *= light[..., np.newaxis] if images.ndim == 4 else light
    return np.clip(top * levels, 0, top).astype(images.dtype)


def _readout(images: np.ndarray, s: float, rng: np.random.Generator) -> np.ndarray:
    """Give rows, columns and the whole other gains, taxels power laws, and leaks."""
    values = images.astype(float)
    shape, top = values.shape[1:], np.nanmax(values)
    power = np.exp(rng.normal(0, 0.15 * s, shape))
    values = np.sign(values) * top * (np.abs(values) / top) ** power
    values *= np.exp(rng.normal(0, 0.2 * s, (shape[0], 1)) + rng.normal(0, 0.2 * s))
    values *= np.exp(rng.normal(0, 0.2 * s, shape[1]))
    finite, share = np.nan_to_num(values), min(0.1 * s, 0.5)
    leaks = finite.mean(axis=1, keepdims=True) + finite.mean(axis=2, keepdims=True)
    leaking = (1 - share) * values + share / 2 * leaks
    return np.where(images > 0.02 * top, leaking, values)


def alarms(recogniser: ObjectRecogniser, touches: Touches, few: int | None) -> float:
    """Return the share of draws of touches, of few objects or all, that raise it."""
    rng, evidence, raised = np.random.default_rng(0), recogniser.evidence(touches), []
    for _ in range(DRAWS):
        names = rng.permutation(np.unique(touches.object))[:few]
        rows = np.flatnonzero(np.isin(touches.object, names))
        rows = rng.permutation(rows)[:N_TOUCHES]
        parts = {
            name: [values[k] for k in rows] if name == "flags" else values[rows]
            for name, values in evidence._asdict().items()
        }
        raised.append(recogniser.check_mounting(type(evidence)(**parts)).changed)
    return float(np.mean(raised))


def figures(split: Split) -> Figures:
    """Return the alarms of a recogniser of one split, false and justified ones."""
    taught, late = held_back(split.train)
    recogniser = ObjectRecogniser().fit(taught)
    same = late[np.isin(late.object, np.unique(split.test.object))]
    lost = accuracy(recogniser, same) - accuracy(recogniser, split.test)
    before = accuracy(recogniser, late)
    others = [changed(late, s, seed) for s in STRENGTHS for seed in SEEDS]
    costly = [o for o in others if before - accuracy(recogniser, o) > COSTLY]
    return Figures(
        [alarms(recogniser, late, few) for few in FEW],
        lost,
        alarms(recogniser, split.test, None),
        [alarms(recogniser, touches, None) for touches in costly],
        len(others),
    )


def main(folder: Path, names: list[str]) -> None:
    print(
        f"{'':46}false: all, three, one   asked: lost, caught   changed: costly, caught"
    )
    all_splits = []
    for name, make in SETS.items():
        if names and not any(part in name for part in names):
            continue
        splits = [figures(split) for split in make(folder)]
        all_splits += splits
        false = " ".join(
            f"{x:4.2f}" for x in np.mean([f.false for f in splits], axis=0)
        )
        costly = [share for f in splits for share in f.costly]
        lost = f"{np.mean([f.lost for f in splits]):4.0f} {mean_caught(splits):4.2f}"
        caught = f"{np.mean(costly):4.2f}" if costly else "   -"
        n_changed = sum(f.n_changed for f in splits)
        print(
            f"{name:46}{false}   {lost}   {len(costly)}/{n_changed} {caught}",
            flush=True,
        )
    false = np.mean([f.false for f in all_splits], axis=0)
    costly = [share for f in all_splits for share in f.costly]
    print(f"mean over splits: false {false.round(3)}, caught {np.mean(costly):.2f}")


def mean_caught(splits: list[Figures]) -> float:
    """Return the mean share of alarms in the sessions that ask."""
    return float(np.mean([f.caught for f in splits]))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
