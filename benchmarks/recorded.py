"""Figures on recorded touches for docs/recognition.md.

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
from palpate.evaluation import Plan, evaluate, split_touches
from palpate.images import correct_gamma
from palpate.recognition import ObjectRecogniser

LENGTHS = (1, 3, 5, 10, 15, 20)
SHIFT_PX, GAMMA = 2.5, 1.3
N_ORDERS = 20


def main(folder: Path, out: Path, sections: list[str]) -> None:
    """Measure the sections asked for, or all; the others stay in the file."""
    touches = Touches.load(folder / "bathtip" / "bathtip50.npz")
    words = np.load(folder / "bathtip" / "visual_words50.npz")
    measures = {
        "ten": lambda: ten_objects(touches),
        "few": lambda: few_touches(touches),
        "altered": lambda: altered(touches),
        "moved": lambda: moved(touches),
        "sight": lambda: sight(touches, words),
    }
    result = json.loads(out.read_text()) if out.exists() else {}
    for name in sections or measures:
        result[name] = measures[name]()
        out.write_text(json.dumps(result, indent=1) + "\n")


def one_each(touches: Touches, number: int) -> NDArray[np.bool_]:
    """Mark the touches of the object with this number in each category."""
    chosen = []
    for category in np.unique(touches.category):
        names = np.unique(touches.object[touches.category == category])
        chosen.append(names[number % len(names)])
    return np.isin(touches.object, chosen)


def ten_objects(touches: Touches) -> dict[str, object]:
    """Ten objects, three choices; other members of their categories are unknown."""
    rows = {}
    for split in ("between", "last"):
        for number in range(3):
            known = one_each(touches, number)
            unknown = one_each(touches, number + 1)
            plan = Plan(touches=LENGTHS, orders=N_ORDERS)
            figures, _ = evaluate(
                touches[known], split=split, unknown=touches[unknown], plan=plan
            )
            keys = ("accuracy", "unknown_auroc", "unknown_refused", "ece", "decision")
            rows[f"{split} {number}"] = {k: figures[k] for k in keys}
            print(split, number, rows[f"{split} {number}"], flush=True)
    return rows


def few_touches(touches: Touches) -> dict[str, object]:
    """Ten training touches of each of ten objects, tested on the last ones."""
    rows = {}
    for number in range(3):
        plan = Plan(touches=LENGTHS, orders=N_ORDERS, train_touches=10, seed=number)
        mine = touches[one_each(touches, number)]
        figures, _ = evaluate(mine, split="last", plan=plan)
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
        levels = correct_gamma(cut[np.newaxis] / 255, gamma)[0]
        images[k] = np.round(255 * np.clip(levels, 0, 1))
    return Touches(images, object=touches.object)


def altered(touches: Touches) -> dict[str, object]:
    """Ten objects, last touches, as they are and shifted and re-exposed."""
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
    """Learn 50 objects before the camera jumped and recognise after, both ways."""
    jumps = {
        "bowl_whitebig": 24,
        "bowl_darkblue": 14,
        "bowl_blackstripes": 12,
        "bottlefull_gingerale": 9,
        "mug_blacksquared": 8,
        "softtoy_pinkrabbit": 7,
    }
    rim = touches.columns["rim_circle_row_col_radius_px"]
    early = np.ones(len(touches), dtype=bool)
    present = [name for name in jumps if name in touches.object]
    for name in present:
        rows = np.flatnonzero(touches.object == name)
        rows = rows[np.argsort(touches.order[rows])]
        early[rows[jump_of(rim[rows, :2]) :]] = False
    mine = np.isin(touches.object, present)
    result = {}
    for way, side in (("before -> after", early), ("after -> before", ~early)):
        train = touches[~mine | side]
        test = touches[mine & ~side]
        figures, _ = evaluate(train, test, plan=Plan(touches=LENGTHS, orders=N_ORDERS))
        result[way] = {"accuracy": figures["accuracy"], "n": figures["n_objects"]}
        print(way, result[way], flush=True)
    return result


def jump_of(centres: NDArray) -> int:
    """Return where a series of centres breaks best into two levels, in their middle."""
    n = len(centres)
    at = range(n // 8, n - n // 8)
    steps = [
        np.linalg.norm(np.median(centres[:k], axis=0) - np.median(centres[k:], axis=0))
        for k in at
    ]
    return at[int(np.argmax(steps))]


def sight(touches: Touches, words: "np.lib.npyio.NpzFile") -> dict[str, object]:
    """Touch, one photograph, and both; 50 objects, then unseen objects' categories."""
    counts = words["counts"].astype(float)
    share = np.sqrt(counts / np.maximum(counts.sum(axis=1, keepdims=True), 1))
    result = {}
    (last,) = split_touches(touches, "last")
    result["object"] = fused(
        [(last.train, last.test)], share, words["object"], "object"
    )
    folds = [(f.train, f.test) for f in split_touches(touches, "unseen-objects")]
    result["category"] = fused(folds, share, words["object"], "category", touches)
    return result


def fused(
    folds: list[tuple[Touches, Touches]],
    share: NDArray,
    seen: NDArray,
    label: str,
    touches: Touches | None = None,
) -> dict[str, dict[str, float]]:
    """Accuracy of touch, a photograph and both, after the lengths."""
    rng = np.random.default_rng(0)
    kinds = {n: c for t in folds[0] for n, c in zip(t.object, t.category, strict=True)}
    hits: dict[str, dict[int, list[float]]] = {
        "touch": {},
        "both": {},
        "sight": {0: []},
    }
    for train, test in folds:
        recogniser = ObjectRecogniser(label=label).fit(train)
        number = np.arange(len(seen)) % 2
        told = seen if label == "object" else np.array([kinds[n] for n in seen])
        # Objects: half of each one's photographs; categories: of known objects.
        known = number == 0 if label == "object" else np.isin(seen, train.object)
        recogniser.learn_modality("sight", share[known], told[known])
        rows = recogniser.log_likelihood(test)
        for name in np.unique(test.object):
            truth = name if label == "object" else kinds[name]
            mine = np.flatnonzero(test.object == name)
            pool = np.flatnonzero((seen == name) & ~(known & (label == "object")))
            for _ in range(N_ORDERS):
                order, photo = rng.permutation(mine), share[rng.choice(pool)]
                alone = recogniser.start().update_sense("sight", photo)
                hits["sight"][0].append(alone.best == truth)
                for k in LENGTHS:
                    if len(mine) < k:
                        continue
                    some = rows[order[:k]]
                    felt = recogniser.start().update_from_log_likelihood(some)
                    hits["touch"].setdefault(k, []).append(felt.best == truth)
                    both = felt.update_sense("sight", photo).best
                    hits["both"].setdefault(k, []).append(both == truth)
    found = {
        s: {str(k): float(np.mean(v)) for k, v in h.items()} for s, h in hits.items()
    }
    print(label, found, flush=True)
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
