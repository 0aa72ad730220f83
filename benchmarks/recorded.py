"""Figures on recorded touches for docs/explanation/results.md.

Run as `python benchmarks/recorded.py FOLDER OUT.json [SECTION ...]`, with the folder
of recorded touches (`bathtip/bathtip50.npz`, `visual_words50.npz`). Ten objects are
one of each category: its first, second or third by name. Ten minutes of one core.
"""

import json
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palpate import Touches
from palpate._durable import write_text
from palpate.evaluation import Plan, evaluate, roc_area, split_touches
from palpate.recognition._evidence import doubts
from palpate.studies.corradi2015 import beside

LENGTHS = (1, 3, 5, 10, 15, 20)
SHIFT_PX, GAMMA = 2.5, 1.3
N_ORDERS = 20
DRAWN_SEED = 20261121


def main(folder: Path, out: Path, sections: list[str]) -> None:
    """Measure the sections asked for, or all; the others stay in the file."""
    touches = Touches.load(folder / "bathtip" / "bathtip50.npz")
    photographs = beside.read_photographs(folder / "bathtip" / "visual_words50.npz")
    measures = {
        "ten": lambda: ten_objects(touches),
        "drawn": lambda: drawn_objects(touches),
        "few": lambda: few_touches(touches),
        "altered": lambda: altered(touches),
        "moved": lambda: moved(touches),
        "sight": lambda: sight(touches, photographs),
    }
    result = json.loads(out.read_text()) if out.exists() else {}
    for name in sections or measures:
        result[name] = measures[name]()
        write_text(out, json.dumps(result, indent=1) + "\n")


def one_each(touches: Touches, number: int) -> NDArray[np.bool_]:
    """Mark the touches of the object with this number in each category."""
    chosen = []
    for category in np.unique(touches.category):
        names = np.unique(touches.object[touches.category == category])
        chosen.append(names[number % len(names)])
    return np.isin(touches.object, chosen)


def ten_objects(touches: Touches) -> dict[str, object]:
    """Measure three choices of ten objects; others of their categories are unknown."""
    rows = {}
    for split in ("between", "last"):
        for number in range(3):
            learnt = one_each(touches, number)
            unknown = one_each(touches, number + 1)
            plan = Plan(touches=LENGTHS, orders=N_ORDERS)
            figures, _ = evaluate(
                touches[learnt], split=split, unknown=touches[unknown], plan=plan
            )
            keys = ("accuracy", "unknown_auroc", "unknown_refused", "ece", "decision")
            rows[f"{split} {number}"] = {k: figures[k] for k in keys}
            print(split, number, rows[f"{split} {number}"], flush=True)
    return rows


def drawn_objects(touches: Touches) -> dict[str, object]:
    """Measure six draws of ten learnt and ten unknown objects, a pair a category.

    The unknown score was settled before these were drawn; `doubt` is the area of the
    probability outside the best object alone.
    """
    rng = np.random.default_rng(DRAWN_SEED)
    rows = {}
    for draw in range(6):
        pairs = []
        for category in np.unique(touches.category):
            names = np.unique(touches.object[touches.category == category])
            pairs.append(rng.choice(names, 2, replace=False))
        learnt, unknown = (
            np.isin(touches.object, [p[i] for p in pairs]) for i in (0, 1)
        )
        for split in ("last", "between"):
            plan = Plan(touches=(1, 5, 10, 15), orders=N_ORDERS)
            figures, (trial,) = evaluate(
                touches[learnt], split=split, unknown=touches[unknown], plan=plan
            )
            keys = ("unknown_auroc", "unknown_refused", "decision")
            row = {k: figures[k] for k in keys}
            row["doubt"] = {
                str(k): roc_area(
                    *(
                        doubts(np.concatenate(episodes.after(k)[1]))
                        for episodes in (trial.episodes, trial.unknown_episodes)
                    )
                )
                for k in plan.touches
            }
            rows[f"{split} {draw}"] = row
            print("drawn", split, draw, row, flush=True)
    return rows


def few_touches(touches: Touches) -> dict[str, object]:
    """Measure ten training touches of each of ten objects, tested on the last ones."""
    rows = {}
    for number in range(3):
        plan = Plan(touches=LENGTHS, orders=N_ORDERS, train_touches=10, seed=number)
        ten = touches[one_each(touches, number)]
        figures, _ = evaluate(ten, split="last", plan=plan)
        rows[str(number)] = figures["accuracy"]
        print("few", number, figures["accuracy"], flush=True)
    return rows


def alter(touches: Touches, seed: int) -> Touches:
    """Shift images with their edges repeated, and change their gamma."""
    rng = np.random.default_rng(seed)
    images = np.empty_like(touches.images)
    border = int(np.ceil(SHIFT_PX))
    for k, image in enumerate(touches.images):
        down, right = rng.integers(-border, border + 1, 2)
        wide = np.pad(image, border, mode="edge")
        rows, cols = image.shape
        cut = wide[border + down :, border + right :][:rows, :cols]
        gamma = np.exp(rng.uniform(-1, 1) * np.log(GAMMA))
        white = cut.max() / 255
        levels = white * (cut / 255 / white) ** gamma
        images[k] = np.round(255 * np.clip(levels, 0, 1))
    return Touches(images, object=touches.object)


def altered(touches: Touches) -> dict[str, object]:
    """Measure the last touches of ten objects, as recorded, and altered."""
    rows = {}
    for number in range(3):
        (fold,) = split_touches(touches[one_each(touches, number)], "last")
        changed = alter(fold.test, number)
        plan = Plan(touches=LENGTHS, orders=N_ORDERS)
        for name, test in (("as they are", fold.test), ("altered", changed)):
            figures, _ = evaluate(fold.train, test, plan=plan)
            rows[f"{name} {number}"] = figures["accuracy"]
            print(name, number, figures["accuracy"], flush=True)
    return rows


def moved(touches: Touches) -> dict[str, object]:
    """Learn 50 objects before the camera jumped and test after, and the reverse."""
    results = beside.moved(touches, Plan(touches=LENGTHS, orders=N_ORDERS))
    result: dict[str, object] = {}
    for direction, figures in results.items():
        result[direction] = {"accuracy": figures["accuracy"], "n": figures["n_objects"]}
        print(direction, result[direction], flush=True)
    return result


def sight(touches: Touches, photographs: beside.Photographs) -> dict[str, object]:
    """Measure touch, a photograph, and both; 50 objects, then unseen categories."""
    result: dict[str, object] = {}
    for label in beside.SPLIT_FOR:
        plan = Plan(label=label, touches=LENGTHS, orders=N_ORDERS)
        right = beside.sight(touches, photographs, plan)
        result[label] = {
            sense: {str(k): float(shares.mean()) for k, shares in curve.items()}
            for sense, curve in right.items()
        }
        print(label, result[label], flush=True)
    return result


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
