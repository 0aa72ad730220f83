"""What days on which a sensor rests at other levels cost, each with its own frame.

    python benchmarks/rests.py FIRST LAST [KIND ...]
    PYTHONPATH=OTHER/src python benchmarks/rests.py ...    # another checkout's code

Simulated: of each draw three days and more touches of the first one. Learnt from the
first day, the same day and the second are asked, this also with the first one's frame
in place of its own; from a library of the first two, the third. Beside `default` an SVM
on touches less their day's frame, one on touches as they are read, and one on
brightness alone. Prints rows of Markdown: % right after one touch, log loss (nats), and
their standard deviation over the draws FIRST to LAST - 1.
"""

import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from palpate import Touches, simulate_presses, simulate_touches
from palpate.library import TouchLibrary
from palpate.recognition import ObjectRecogniser
from palpate.simulation import GelCamera, PressureArray, TacTipPins

N_TOUCHES, N_ELECTRODES = 16, 19
Floats = np.ndarray
# Returns touches of a draw, of one of its days, and of a seed of the touches alone.
Day = Callable[[int, int, int], Touches]


def array(level: float) -> Day:
    """Presses of twelve parts at any angle; taxels rest at a share of a strong one."""

    def day(draw: int, number: int, touches_seed: int) -> Touches:
        presses = simulate_presses(
            None,
            N_TOUCHES,
            array=PressureArray(10, 10),
            max_turn_deg=180,
            max_shift_mm=3,
            random_state=100 * draw + touches_seed,
        )
        levels = presses.images.astype(float)
        return _at_rest(levels, presses.object, level, (draw, number), "array")

    return day


def electrodes(level: float) -> Day:
    """Presses of twelve parts as 19 electrodes feel them, which have no places."""
    rows, columns = np.mgrid[:24, :24].reshape(2, -1)

    def day(draw: int, number: int, touches_seed: int) -> Touches:
        presses = simulate_presses(
            None,
            N_TOUCHES,
            array=PressureArray(24, 24, pitch_mm=1.0, sensing_mm=0.9),
            max_turn_deg=15,
            max_shift_mm=1,
            random_state=100 * draw + touches_seed,
        )
        places = np.random.default_rng(draw).uniform(4, 20, (N_ELECTRODES, 2, 1))
        away = (rows - places[:, 0]) ** 2 + (columns - places[:, 1]) ** 2
        taxels = presses.images.reshape(len(presses), -1).astype(float)
        levels = (taxels @ np.exp(-away / 18).T)[:, np.newaxis]
        noise = np.random.default_rng([draw, touches_seed]).normal(size=levels.shape)
        levels += 0.01 * np.percentile(levels, 99) * noise
        return _at_rest(levels, presses.object, level, (draw, number), "none")

    return day


def camera(kind: type[GelCamera] | type[TacTipPins]) -> Day:
    """Seven shapes of one size; each day another mounting of the rubber."""

    def day(draw: int, number: int, touches_seed: int) -> Touches:
        mounted = kind().remounted(np.random.default_rng([draw, number]))
        touches = simulate_touches(
            "shapes",
            N_TOUCHES,
            mounted,
            "above",
            drift=False,
            random_state=100 * draw + touches_seed,
            n_jobs=1,
        )
        return touches.with_columns(geometry="plane")

    return day


KINDS: dict[str, Day] = {
    "19 electrodes, resting at 2 % of a strong press": electrodes(0.02),
    "19 electrodes, resting at 10 %": electrodes(0.1),
    "array of 10 x 10, resting at 5 %": array(0.05),
    "array of 10 x 10, resting at 30 %": array(0.3),
    "gel": camera(GelCamera),
    "pins": camera(TacTipPins),
}


def _at_rest(
    levels: Floats, names: Floats, level: float, seed: Sequence[int], geometry: str
) -> Touches:
    """Return touches at rest at levels of that day, less none."""
    spread = level * np.percentile(levels, 99)
    rest = spread * np.random.default_rng(seed).normal(size=levels.shape[1:])
    about = {"object": names, "geometry": geometry, "no_contact": rest}
    return Touches(levels + rest, **about)


def answers(recogniser: ObjectRecogniser, asked: Touches) -> list[float]:
    """Return % right and the log loss (nats) of touches, one by one."""
    posterior = np.maximum(recogniser.predict_proba(asked), 1e-3)
    codes = np.searchsorted(recogniser.classes_, asked.object.astype(str))
    loss = -np.log(posterior[np.arange(len(codes)), codes]).mean()
    return [100 * recogniser.score(asked, asked.object), float(loss)]


def simple(taught: Sequence[Touches], asked: Touches) -> list[float]:
    """Return % right of SVMs: less the frames, as read, and of brightness alone."""

    def changes(touches: Touches) -> Floats:
        return touches.differences()[:, ::step, ::step].reshape(len(touches), -1)

    def as_read(touches: Touches) -> Floats:
        return touches.images[:, ::step, ::step].reshape(len(touches), -1)

    def brightness(touches: Touches) -> Floats:
        return touches.images.reshape(len(touches), -1).mean(axis=1)[:, np.newaxis]

    step = 1 if asked.images.shape[2] < 40 else 5
    names, right = np.concatenate([touches.object for touches in taught]), []
    for features in (changes, as_read, brightness):
        svm = make_pipeline(StandardScaler(), SVC(C=10))
        svm.fit(np.concatenate([features(touches) for touches in taught]), names)
        right.append(100 * svm.score(features(asked), asked.object))
    return right


def of_draw(day: Day, draw: int) -> dict[str, list[float]]:
    """Return the figures of one draw by what is asked."""
    days = [day(draw, number, number) for number in range(3)]
    alone = ObjectRecogniser().fit(days[0])
    with (
        tempfile.TemporaryDirectory() as folder,
        TouchLibrary.open(Path(folder) / "library", create=True) as library,
    ):
        for number in range(2):
            library.add(days[number], session=number)
        both = ObjectRecogniser().fit(library.select())
    asked = {
        "the same day": (alone, days[:1], day(draw, 0, 3)),
        "another day": (alone, days[:1], days[1]),
        "another day, without its frame": (
            alone,
            days[:1],
            days[1].with_columns(no_contact=days[0].no_contact),
        ),
        "a third day": (both, days[:2], days[2]),
    }
    return {
        what: answers(recogniser, new) + simple(taught, new)
        for what, (recogniser, taught, new) in asked.items()
    }


def main() -> None:
    """Print a table: of each sensor and day asked one row."""
    first, last, *kinds = sys.argv[1:]
    heads = ["sensor", "asked", "right", "±", "log loss", "±"]
    heads += ["SVM less frames", "SVM as read", "brightness"]
    print("| " + " | ".join(heads) + " |")
    print("|---" * len(heads) + "|")
    for kind in kinds or KINDS:
        draws = [of_draw(KINDS[kind], k) for k in range(int(first), int(last))]
        for what in draws[0]:
            figures = np.array([draw[what] for draw in draws])
            right, loss, *others = figures.mean(axis=0)
            right_sd, loss_sd = figures[:, :2].std(axis=0)
            row = [f"{right:.0f}", f"{right_sd:.0f}", f"{loss:.2f}", f"{loss_sd:.2f}"]
            row += [f"{other:.0f}" for other in others]
            print(f"| {kind} | {what} | {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
