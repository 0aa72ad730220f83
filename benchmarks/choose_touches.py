"""Touches needed until the object is named: chosen touches, random ones, a raster.

    python benchmarks/choose_touches.py --out benchmarks/choose_touches.json
    python benchmarks/choose_touches.py --pool DATA/bathtip/bathtip50.npz

In simulation the ten household objects are taught in one pose, 60 touches each in
three recordings with the object put down anew (5 mm aside along x and y), then touched
in an episode of their own: in the training pose, turned about the vertical by an
unknown angle, or on another resting face. Everything goes through the simulated arm:
noisy force, contact that shifts the object by up to 5 % of its size, approaches that
find nothing. Touches are attempts: those that found nothing count. An episode ends
when the belief by place is at 0.99 for one object; its answers stand from then on.
A seed tries every other object.

With --pool the touches of a recorded set are looked at in another order, chosen among
their contact heights and radii. One object of each category is drawn per seed; the
test touches are 25 of each, drawn at random ("between") or the last recorded ("last").

"by touch" names the most probable object by the images alone (`Belief`), "by place" by
images and the side they were touched on (`PlacedBelief`).
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from palpate import Touches
from palpate._durable import write_text
from palpate.evaluation._trial import spread
from palpate.exploration import (
    InformativeTouch,
    RandomHemisphere,
    Raster,
    TouchMap,
    TouchRecord,
    as_touches,
    explore_to_learn,
    put_down,
)
from palpate.exploration._simulated_objects import QUICK_GUARD, Stand
from palpate.recognition import ObjectRecogniser
from palpate.simulation import HOUSEHOLD, DomeCamera, SimObject
from recorded_choice import (
    InformativeRecorded,
    RandomRecorded,
    RasterRecorded,
    look_at_recorded,
)

CAMERA = DomeCamera(image_shape=(80, 80), n_nodes=24)
N_SESSIONS = 3
EVERY = 2
CONDITIONS = ("training pose", "new yaw", "other face")
STRATEGIES = ("random", "raster", "chosen")
TEST_TOUCHES = 25
WANTED = 0.95
ERROR = 0.01
Hits = dict[str, Any]


def taught(teaching: int, preset: str) -> TouchMap:
    """Touch every object in its usual pose and learn its touches by place."""
    touches = explore_to_learn(
        camera=CAMERA,
        n_sessions=N_SESSIONS,
        random_state=_seed(1, teaching),
    )
    recogniser = ObjectRecogniser(preset, random_state=teaching).fit(touches)
    return TouchMap(random_state=teaching).fit(recogniser, touches)


def one_teaching(
    teaching: int, preset: str, conditions: list[str], seeds: list[int], n_touches: int
) -> list[Hits]:
    """Run the episodes of some seeds on one teaching."""
    touch_map = taught(teaching, preset)
    hits = []
    for seed in seeds:
        for condition, strategy in product(conditions, STRATEGIES):
            for code, thing in list(enumerate(HOUSEHOLD))[seed % EVERY :: EVERY]:
                where = _seed(2, seed, code, CONDITIONS.index(condition))
                stand = _put_down(thing, condition, where)
                if stand is None:
                    continue
                named = episode(stand, touch_map, strategy, where, n_touches)
                hits.append(_hits(condition, strategy, seed, thing.name, named))
        print(f"teaching {teaching}, seed {seed}", file=sys.stderr, flush=True)
    return hits


def episode(
    stand: Stand, touch_map: TouchMap, name: str, seed: int, n_touches: int
) -> dict[str, list[str]]:
    """Return the object named after each attempt, by touch and by place."""
    choosers: dict[str, Callable[[], Any]] = {
        "random": lambda: RandomHemisphere(stand.hemisphere, seed),
        "raster": lambda: Raster(stand.hemisphere),
        "chosen": lambda: InformativeTouch(touch_map, stand.hemisphere),
    }
    strategy, belief = choosers[name](), touch_map.start()
    history: list[TouchRecord] = []
    named: dict[str, list[str]] = {"by touch": [], "by place": []}
    for _ in range(n_touches):
        record = stand.touch(strategy.next_pose(belief, history), QUICK_GUARD)
        history.append(record)
        if record.touched:
            belief.update(as_touches([record]))
        named["by touch"].append(belief.best_without_places)
        named["by place"].append(belief.best)
        if belief.doubt <= ERROR:
            break
    left = n_touches - len(history)
    return {by: names + names[-1:] * left for by, names in named.items()}


def one_pool(
    data: str, preset: str, split: str, seed: int, n_touches: int
) -> list[Hits]:
    """Look at recorded touches of ten objects, one of each category."""
    touches = Touches.load(data)
    rng = np.random.default_rng(_seed(3, seed))
    places = heights_and_radii(touches)
    train, tests = _split(touches, split, rng)
    scaled = places / places[train].std(axis=0)
    recogniser = ObjectRecogniser(preset, random_state=seed).fit(touches[train])
    touch_map = TouchMap(n_turns=1, random_state=seed)
    touch_map.fit(recogniser, touches[train], scaled[train])
    hits = []
    for thing, rows in tests.items():
        for name, chooser in _choosers(touch_map, scaled[rows], seed):
            _, by_touch, by_place = look_at_recorded(
                touch_map, touches[rows], scaled[rows], chooser, n_touches
            )
            named = {"by touch": by_touch.tolist(), "by place": by_place.tolist()}
            hits.append(_hits(split, name, seed, thing, named))
    print(f"pool {split}, seed {seed}", file=sys.stderr, flush=True)
    return hits


def heights_and_radii(touches: Touches) -> np.ndarray:
    """Return each contact's height, and distance from the object's median axis."""
    raw = np.asarray(touches.columns["position_raw"], dtype=float)
    radius = np.empty(len(raw))
    for name in np.unique(touches.object):
        rows = touches.object == name
        middle = np.median(raw[rows, :2], axis=0)
        radius[rows] = np.linalg.norm(raw[rows, :2] - middle, axis=1)
    return np.column_stack([raw[:, 2], radius])


def summary(hits: list[Hits]) -> list[dict[str, Any]]:
    """Return accuracy after each touch and touches needed, with spread over seeds."""
    rows = []
    keys = sorted({(hit["condition"], hit["strategy"]) for hit in hits})
    for condition, strategy in keys:
        for belief in ("by touch", "by place"):
            curves = _curves(hits, condition, strategy, belief)
            rows.append(
                {
                    "condition": condition,
                    "strategy": strategy,
                    "belief": belief,
                    "n_seeds": len(curves),
                    "accuracy": curves.mean(axis=0).round(4).tolist(),
                    "accuracy_sd": spread(curves).round(4).tolist(),
                    "touches_for_95": _needed(curves.mean(axis=0)),
                    "touches_for_95_range": _needed_range(curves),
                    "touches_to_stay": _needed_to_stay(curves.mean(axis=0)),
                    **_until_right(hits, condition, strategy, belief),
                }
            )
    return rows


def _put_down(thing: SimObject, condition: str, seed: int) -> Stand | None:
    """Put an object down as a condition asks; None if it has no other face."""
    rng = np.random.default_rng(seed)
    yaw = 0.0 if condition == "training pose" else rng.uniform(0, 2 * np.pi)
    n_faces = len(thing.resting_rotations)
    if condition != "other face":
        return put_down(thing, CAMERA, yaw_rad=yaw, random_state=seed)
    if n_faces == 1:
        return None
    face = int(rng.integers(1, n_faces))
    return put_down(thing, CAMERA, face=face, yaw_rad=yaw, random_state=seed)


def _hits(
    condition: str, strategy: str, seed: int, thing: str, named: dict[str, list[str]]
) -> Hits:
    hits = {belief: [name == thing for name in named[belief]] for belief in named}
    about = {"condition": condition, "strategy": strategy, "seed": seed}
    return {**about, "object": thing, **hits}


def _curves(hits: list[Hits], condition: str, strategy: str, belief: str) -> np.ndarray:
    """Return the accuracy over objects after each touch, one row per seed."""
    wanted = condition, strategy
    chosen = [hit for hit in hits if (hit["condition"], hit["strategy"]) == wanted]
    seeds = sorted({hit["seed"] for hit in chosen})
    return np.array(
        [np.mean([h[belief] for h in chosen if h["seed"] == s], axis=0) for s in seeds]
    )


def _until_right(
    hits: list[Hits], condition: str, strategy: str, belief: str
) -> dict[str, float]:
    """Return the touches after which an answer is right for good, over seeds.

    Mean over episodes, one more than the budget where it never is.
    """
    wanted = condition, strategy
    chosen = [hit for hit in hits if (hit["condition"], hit["strategy"]) == wanted]
    per_seed = []
    for seed in sorted({hit["seed"] for hit in chosen}):
        wrong = [~np.array(h[belief]) for h in chosen if h["seed"] == seed]
        last = [int(np.flatnonzero(row)[-1]) + 1 if row.any() else 0 for row in wrong]
        per_seed.append(float(np.mean(last)) + 1)
    return {
        "touches_until_right": round(float(np.mean(per_seed)), 2),
        "touches_until_right_sd": round(float(spread(per_seed)), 2),
    }


def _needed(curve: np.ndarray) -> int | None:
    """Return the touches after which the accuracy first is `WANTED`."""
    enough = np.flatnonzero(curve >= WANTED)
    return int(enough[0]) + 1 if len(enough) else None


def _needed_to_stay(curve: np.ndarray) -> int | None:
    """Return the touches from which on the accuracy is never below `WANTED`."""
    below = np.flatnonzero(curve < WANTED)
    needed = 1 if not len(below) else int(below[-1]) + 2
    return needed if needed <= len(curve) else None


def _needed_range(curves: np.ndarray) -> list[int | None]:
    """Return 5 and 95 % of the touches needed, over seeds drawn with replacement."""
    rng = np.random.default_rng(0)
    drawn = rng.integers(len(curves), size=(1000, len(curves)))
    most = curves.shape[1] + 1
    needed = [_needed(curves[rows].mean(axis=0)) or most for rows in drawn]
    low, high = np.quantile(needed, [0.05, 0.95], method="inverted_cdf")
    return [int(number) if number < most else None for number in (low, high)]


def _split(
    touches: Touches, split: str, rng: np.random.Generator
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the training touches, and the test touches of each object."""
    train, tests = [], {}
    for category in np.unique(touches.category):
        thing = str(rng.choice(np.unique(touches.object[touches.category == category])))
        rows = np.flatnonzero(touches.object == thing)
        rows = rows[np.argsort(touches.order[rows], kind="stable")]
        if split == "between":
            rows = rng.permutation(rows)
        train.append(np.sort(rows[:-TEST_TOUCHES]))
        tests[thing] = np.sort(rows[-TEST_TOUCHES:])
    return np.concatenate(train), tests


def _choosers(
    touch_map: TouchMap, places: np.ndarray, seed: int
) -> Iterator[tuple[str, Any]]:
    yield "random", RandomRecorded(len(places), seed)
    yield "raster", RasterRecorded(places)
    yield "chosen", InformativeRecorded(touch_map, places)


def _seed(*numbers: int) -> int:
    return int(np.random.SeedSequence(numbers).generate_state(1)[0])


def _others(options: argparse.Namespace, rows: list[Hits]) -> list[Hits]:
    """Return rows of the same preset in the file that were not measured again."""
    old = json.loads(options.out.read_text()) if options.out.exists() else {}
    if old.get("preset") != options.preset:
        return []
    measured = {row["condition"] for row in rows}
    return [row for row in old["rows"] if row["condition"] not in measured]


def main() -> None:
    """Run, print a table, and write JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--teachings", type=int, default=2)
    parser.add_argument("--touches", type=int, default=14)
    parser.add_argument("--preset", default="default")
    parser.add_argument("--conditions", nargs="+", default=list(CONDITIONS))
    parser.add_argument("--pool", metavar="FILE", help="an archive with position_raw")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if options.pool:
        tasks = [
            delayed(one_pool)(
                options.pool, options.preset, split, seed, options.touches
            )
            for split in ("between", "last")
            for seed in range(options.seeds)
        ]
    else:
        parts = np.array_split(np.arange(options.seeds), options.teachings)
        tasks = [
            delayed(one_teaching)(
                teaching,
                options.preset,
                options.conditions,
                seeds.tolist(),
                options.touches,
            )
            for teaching, seeds in enumerate(parts)
        ]
    results = Parallel(n_jobs=options.jobs)(tasks)
    rows = summary([hit for part in results for hit in part])
    for row in rows:
        curve = " ".join(f"{value:.2f}" for value in row["accuracy"])
        print(
            f"{row['condition']:14s} {row['strategy']:16s} {row['belief']:9s} {curve}  "
            f"95 %: {row['touches_for_95']} {row['touches_for_95_range']} "
            f"right after {row['touches_until_right']} "
            f"(sd {row['touches_until_right_sd']})"
        )
    if options.out:
        kept = {"preset": options.preset, "rows": rows + _others(options, rows)}
        write_text(options.out, json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
