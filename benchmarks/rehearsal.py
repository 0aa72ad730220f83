"""What rehearsed sessions are worth: taught in some, asked in another, or in the same.

    python benchmarks/rehearsal.py ../data [SET ...]

Prints, for each set, the accuracy after one touch (per cent, mean over objects, spread
over splits) with and without rehearsal: as it is, recentred with all of the session's
touches without labels, with one confirmed touch of one object (mean of three), and with
one and three of each. Those `within` a session tell what rehearsal costs; those
`across` what it is worth. Below it what `learn` expects of another day, split by split.
"""

import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from palpate import Touches
from palpate.recognition import ObjectRecogniser, adapt
from palpate.simulation import simulate_presses, simulate_touches
from palpate.studies.corradi2015.beside import MOVED, before_the_move, labels

WAYS = "as it is", "recentred", "one object", "one of each", "three of each"
SEED = 0


class Split(NamedTuple):
    """Touches that teach, and touches of another session, or of the same, that ask."""

    train: Touches
    test: Touches


def halves(touches: Touches, by: str | None = None) -> Split:
    """Split each object (and value of a column) into the first and the second half."""
    assert touches.object is not None
    order = np.arange(len(touches)) if touches.order is None else touches.order
    of = touches.object.astype(str)
    if by is not None:
        of = np.char.add(of, touches.columns[by].astype(str))
    first = np.zeros(len(touches), dtype=bool)
    for name in np.unique(of):
        rows = np.flatnonzero(of == name)
        rows = rows[np.argsort(order[rows], kind="stable")]
        first[rows[: (len(rows) + 1) // 2]] = True
    return Split(touches[first], touches[~first])


def folds(touches: Touches, column: str) -> list[Split]:
    """Let each value of a column ask in turn, and the others teach."""
    values = touches.columns[column]
    return [
        Split(touches[values != v], touches[values == v]) for v in np.unique(values)
    ]


def another_part(touches: Touches) -> list[Split]:
    """Ask about one part of every object, in turn; its other parts teach."""
    of, part = labels(touches), touches.columns["part"]
    number = np.zeros(len(touches), dtype=np.intp)
    for name in np.unique(of):
        number[of == name] = np.unique(part[of == name], return_inverse=True)[1]
    return [
        Split(touches[number != n], touches[number == n]) for n in np.unique(number)
    ]


def random_fifth(touches: Touches) -> list[Split]:
    """Ask about touches drawn at random, a fifth of each object or so."""
    assert touches.object is not None
    rng, is_test = np.random.default_rng(SEED), np.zeros(len(touches), dtype=bool)
    for name in np.unique(touches.object):
        rows = rng.permutation(np.flatnonzero(touches.object == name))
        is_test[rows[: max(1, len(rows) // 5)]] = True
    return [Split(touches[~is_test], touches[is_test])]


def mats(folder: Path) -> Touches:
    return Touches.load(folder / "sessions" / "mattress.npz")


def pairs_known(touches: Touches) -> list[Split]:
    """Ask half of the people on one mattress; of the others both are known."""
    people = np.unique(touches.subject, return_inverse=True)[1]
    test_masks = [
        (touches.session == name) & (people % 2 == half)
        for name in np.unique(touches.session)
        for half in range(2)
    ]
    return [Split(touches[~t], touches[t]) for t in test_masks]


def balls(folder: Path) -> list[Split]:
    """Ask about the four balls that were squeezed on two days, on one of them."""
    touches = Touches.load(folder / "sessions" / "gelsight_wedge.npz")
    met = np.unique(np.stack([touches.object, touches.session]), axis=1)[0]
    names, counts = np.unique(met, return_counts=True)
    return folds(touches[np.isin(touches.object, names[counts > 1])], "session")


def jumped(folder: Path) -> list[Split]:
    """Ask about five objects of a dome after its camera jumped, and before."""
    touches = Touches.load(folder / "bathtip" / "bathtip50.npz")
    early, moved = before_the_move(touches), np.isin(labels(touches), MOVED)
    few = np.arange(len(touches)) % 3 == 0  # a third of the other objects
    return [
        Split(touches[(~moved & few) | (moved & side)], touches[moved & ~side])
        for side in (early, ~early)
    ]


def dome_halves(folder: Path) -> list[Split]:
    touches = Touches.load(folder / "bathtip" / "bathtip50.npz")
    return [halves(touches[np.arange(len(touches)) % 3 == 0])]


def another_camera(split: Split) -> Split:
    """Turn, enlarge, move, light and expose the test touches as another unit might.

    The changes are not those of rehearsal: 2 degrees, 3 % of the side, 2 % larger, and
    in each colour another power law and light that falls off to one side (5 %).
    """
    import cv2

    rng, (train, test) = np.random.default_rng(SEED), split
    n_rows, n_cols = test.images.shape[1:3]
    turn = cv2.getRotationMatrix2D((n_cols / 2, n_rows / 2), rng.normal(0, 2), 1.02)
    turn[:, 2] += rng.normal(0, 0.03 * n_rows, 2)
    towards = np.stack(
        np.meshgrid(*(np.linspace(-1, 1, n) for n in (n_rows, n_cols)), indexing="ij")
    )
    images = np.empty_like(test.images)
    for k in range(images.shape[3]):
        light = 1 + np.tensordot(rng.normal(0, 0.05, 2), towards, 1)
        power = np.exp(rng.normal(0, 0.05))
        for i, image in enumerate(test.images):
            warped = cv2.warpAffine(image[..., k], turn, (n_cols, n_rows), borderMode=1)
            levels = 255 * (warped / 255.0) ** power * light
            images[i, ..., k] = np.clip(levels, 0, 255)
    return Split(train, replaced(test, images))


def another_readout(split: Split) -> Split:
    """Read the tested array by other electronics, as a guess, not as rehearsed.

    Rows and columns have gains of their own (20 %), taxels a power law each (15 %), and
    a tenth of the mean of its row and column leaks into each.
    """
    rng, (train, test) = np.random.default_rng(SEED), split
    images = test.images.astype(float)
    shape = images.shape[1:]
    top = np.nanmax(images)
    power = np.exp(rng.normal(0, 0.15, shape))
    images = np.sign(images) * top * (np.abs(images) / top) ** power
    images = images * np.exp(rng.normal(0, 0.2, shape[0]))[:, np.newaxis]
    images = images * np.exp(rng.normal(0, 0.2, shape[1]))
    finite = np.nan_to_num(images)
    leaks = finite.mean(axis=1, keepdims=True) + finite.mean(axis=2, keepdims=True)
    leaking = 0.9 * images + 0.05 * leaks
    return Split(train, replaced(test, np.where(images > 0.02 * top, leaking, images)))


def placed(touches: Touches) -> Touches:
    """Return presses at other places and angles; as recorded they are too easy."""
    import cv2

    rng, images = np.random.default_rng(SEED), np.empty_like(touches.images)
    n_rows, n_cols = images.shape[1:]
    for i, image in enumerate(touches.images):
        middle = (n_cols - 1) / 2, (n_rows - 1) / 2
        turn = cv2.getRotationMatrix2D(middle, rng.uniform(0, 360), 1)
        turn[:, 2] += rng.uniform(-2, 2, 2)
        images[i] = cv2.warpAffine(image, turn, (n_cols, n_rows))
    return replaced(touches, images)


def replaced(touches: Touches, images: np.ndarray) -> Touches:
    """Return touches with other images."""
    whole = {"channels": touches.channels, "pads": touches.pads}
    return Touches(images, geometry=touches.geometry, **whole, **touches.columns)


def mounted(touches: Touches) -> list[Split]:
    return folds(touches, "session")


SETS = {
    "across: mats, another mattress": lambda f: folds(mats(f), "session"),
    "across: mats, others' pairs known": lambda f: pairs_known(mats(f)),
    "across: postures, another person": lambda f: folds(
        Touches.load(f / "sessions" / "postures.npz"), "subject"
    )[:4],
    "across: balls, another day": balls,
    "across: dome, after a jump": jumped,
    "across: DIGIT, another part": lambda f: another_part(
        Touches.load(f / "sessions" / "digit_survey.npz")
    ),
    "across: simulated dome": lambda f: mounted(
        simulate_touches(None, 80, n_sessions=4, mountings=True, random_state=SEED)
    ),
    "across: simulated array": lambda f: mounted(
        simulate_presses(None, 80, n_sessions=4, random_state=SEED)
    ),
    "across: DIGIT, another camera (simulated)": lambda f: [
        another_camera(
            halves(Touches.load(f / "sessions" / "digit_survey.npz"), "part")
        )
    ],
    "across: array, another readout (simulated)": lambda f: [
        another_readout(
            halves(placed(Touches.load(f / "taxel10x10" / "taxel10x10.npz")))
        )
    ],
    "across: hand, another readout (simulated)": lambda f: [
        another_readout(halves(Touches.load(f / "sessions" / "sdh2_september.npz")))
    ],
    "within: hand, halves": lambda f: [
        halves(Touches.load(f / "sessions" / "sdh2_september.npz"))
    ],
    "within: hand, a random fifth": lambda f: random_fifth(
        Touches.load(f / "sessions" / "sdh2_september.npz")
    ),
    "within: DIGIT, halves": lambda f: [
        halves(Touches.load(f / "sessions" / "digit_survey.npz"), "part")
    ],
    "within: dome, halves": dome_halves,
    "within: taxel": lambda f: random_fifth(
        Touches.load(f / "taxel10x10" / "taxel10x10.npz")
    ),
    "within: tactip": lambda f: [
        halves(Touches.load(f / "tactip4" / "tactip4.npz")[::4])
    ],
}


def accuracy(recogniser: ObjectRecogniser, touches: Touches) -> float:
    """Return per cent right after one touch, mean over objects."""
    best = recogniser.log_likelihood(touches).argmax(axis=1)
    right = recogniser.classes_[best] == touches.object
    return 100 * float(
        np.mean([right[touches.object == o].mean() for o in np.unique(touches.object)])
    )


def measured(recogniser: ObjectRecogniser, test: Touches) -> list[float]:
    """Return the accuracy in each of `WAYS`."""
    accuracies = [accuracy(recogniser, test)]
    names = [name for name in ("object", "category") if name in test.columns]
    adapted = adapt(recogniser, test.without(*names))
    accuracies.append(accuracy(adapted, test))
    rng = np.random.default_rng(SEED)
    order = rng.permutation(len(test))
    accuracies.append(
        np.mean([confirmed(recogniser, test, order[[k]]) for k in range(3)])
    )
    for n_each in (1, 3):
        confirmed_rows = [
            order[test.object[order] == n][:n_each] for n in np.unique(test.object)
        ]
        accuracies.append(np.nan)
        if np.bincount(np.unique(test.object, return_inverse=True)[1]).min() > n_each:
            accuracies[-1] = confirmed(
                recogniser, test, np.sort(np.concatenate(confirmed_rows))
            )
    return accuracies


def confirmed(recogniser: ObjectRecogniser, test: Touches, rows: np.ndarray) -> float:
    """Return the accuracy on the other touches when some touches are confirmed."""
    adapted = adapt(recogniser, test[rows])
    return accuracy(adapted, test[np.setdiff1d(np.arange(len(test)), rows)])


def expectation(recogniser: ObjectRecogniser, right: list[float]) -> str:
    """Return the accuracy expected of another day beside the measured one, as text."""
    rehearsal, words = recogniser.chosen_["rehearsal"], []
    for name, actual in (("expected", right[0]), ("confirmed", right[3])):
        if name in rehearsal and np.isfinite(actual):
            low, high = rehearsal[name]
            words.append(f"{name} {100 * low:.0f}-{100 * high:.0f}, came {actual:.0f}")
    return "; ".join(words)


def main(folder: Path, names: list[str]) -> None:
    print(
        f"{'':46}" + "".join(f"{way:>22}" for way in WAYS) + "   share, learning, trust"
    )
    for name, make in SETS.items():
        if names and not any(word in name for word in names):
            continue
        rows, costs, shares, trusts, words = [], [], [], [], []
        for split in make(folder):
            both, cost = [], []
            for rehearse in (False, True):
                start = time.process_time()
                recogniser = ObjectRecogniser(rehearse=rehearse).fit(split.train)
                cost.append(time.process_time() - start)
                both.append(measured(recogniser, split.test))
            rows.append(both)
            costs.append(cost[1] / cost[0])
            shares.append(recogniser.chosen_["rehearsal"]["share"])
            trusts.append(recogniser.chosen_["rehearsal"].get("trust", np.nan))
            words.append(expectation(recogniser, both[1]))
        mean, spread = np.mean(rows, axis=0), np.std(rows, axis=0)
        cells = [
            f"{mean[0, k]:5.1f} {mean[1, k]:5.1f} ({spread[1, k]:4.1f})"
            for k in range(len(WAYS))
        ]
        print(
            f"{name:46}" + "".join(f"{cell:>22}" for cell in cells),
            f"  {np.mean(shares):.2f}, {np.mean(costs):.1f} times",
            f"{np.mean(trusts):.2f}",
            flush=True,
        )
        print(*(f"  {word}" for word in words if word), sep="\n", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
