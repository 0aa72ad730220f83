"""Attempts until an object is named rightly, and how well its pose is known.

    python benchmarks/places.py --belief turns --out benchmarks/places.json
    python benchmarks/places.py --belief places --out benchmarks/places.json

The file keeps the rows of every belief and teaching; a run replaces its own.

Ten simulated objects are taught, 60 touches each, on the usual face or on all. Then
each is put down at an unknown yaw, 5 mm (sd) aside along x and y, on the usual face
("new yaw"), another one ("other face") or any of them ("any face"), and touched until
the belief decides at an error of 5 %, 14 attempts at most. All beliefs and strategies
meet the same placements, at least `--episodes` a seed. A "stranger" is one of six
others, on its usual face; "unknown" is right.

"attempts" is the mean number until it is decided rightly, budget + 1 where it never is;
"less_random" by how many these are more than with random places on the same placements;
"right" the share of such episodes; "wrong" of wrong decisions; "best_by_10" the share
in which the most probable object is right after 10 attempts. Yaw (degrees, modulo the
object's symmetry) and offset (mm) are medians of their errors after 5 and 10 attempts.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from itertools import count, product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from palpate import Touches
from palpate._durable import write_text
from palpate.exploration import (
    InformativeTouch,
    PlaceBelief,
    RandomHemisphere,
    Raster,
    SurfaceMap,
    TouchMap,
    TouchRecord,
    as_touches,
    explore_to_learn,
    put_down,
)
from palpate.exploration._simulated_objects import Stand
from palpate.exploration._surface import mesh_surface
from palpate.recognition import ObjectRecogniser
from palpate.simulation import (
    HOUSEHOLD,
    DomeCamera,
    PlacedObject,
    SensorPose,
    SimObject,
    find_objects,
)

CAMERA = DomeCamera(image_shape=(80, 80), n_nodes=24)
STRATEGIES = ("random", "raster", "chosen")
CONDITIONS = ("new yaw", "other face", "stranger", "any face")
BUDGET = 14
ERROR = 0.05
POSES_AFTER = 5, 10
# As many turns as the tables distinguish look alike.
AZIMUTHS_OF_ROUND = 72
STRANGERS = find_objects(["unseen", "unlike others"])
Row = dict[str, Any]


def taught(
    teaching: int, faces: str, cache: Path | None = None, known_height: bool = True
) -> Touches:
    """Touch every object, 60 times in six sessions, each time in one step."""
    name = f"taught-{teaching}-{faces}{'-low' * (not known_height)}.npz"
    path = None if cache is None else cache / name
    if path is not None and path.exists():
        return Touches.load(path)
    touches = explore_to_learn(
        camera=CAMERA,
        n_sessions=6,
        faces=faces,
        known_height=known_height,
        guarded=False,
        random_state=seed_of(1, teaching),
        n_jobs=1,
    )
    if path is not None:
        touches.save(path)
    return touches


def placed(
    thing: SimObject, condition: str, seed: int, known_height: bool = True
) -> Stand | None:
    """Put an object down as a condition says; None if it has no other face."""
    rng = np.random.default_rng(seed)
    yaw, n_faces = float(rng.uniform(0, 2 * np.pi)), len(thing.resting_rotations)
    face = 0
    if condition.endswith("face"):
        least = int(condition == "other face")
        face = int(rng.integers(least, max(n_faces, least + 1)))
    if face >= n_faces:
        return None
    options = {"face": face, "yaw_rad": yaw, "known_height": known_height}
    return put_down(thing, CAMERA, random_state=seed, **options)


def strategy_of(name: str, stand: Stand, learnt: Any, seed: int) -> Any:
    """Return a strategy by its name."""
    makers: dict[str, Callable[[], Any]] = {
        "random": lambda: RandomHemisphere(stand.hemisphere, seed),
        "raster": lambda: Raster(stand.hemisphere),
        "chosen": lambda: InformativeTouch(learnt, stand.hemisphere),
    }
    return makers[name]()


def one_episode(
    stand: Stand, learnt: Any, name: str, seed: int, wrong_pose: bool = False
) -> Row:
    """Touch until decided; return the row of the episode."""
    strategy = strategy_of(name, stand, learnt, seed)
    by_place = isinstance(learnt, SurfaceMap)
    belief = learnt.start_before(stand.hemisphere) if by_place else learnt.start()
    history: list[TouchRecord] = []
    truth = stand.thing.name if stand.thing in HOUSEHOLD else "unknown"
    seconds: list[float] = []
    row: Row = {"object": truth, "attempts": BUDGET + 1, "decision": None, "best": []}
    # Episodes with places go on after the decision, for the poses after 10 attempts.
    goes_on = by_place and name != "raster" and stand.thing in HOUSEHOLD
    while len(history) < (10 if row["decision"] and goes_on else BUDGET):
        began = time.process_time()
        record = stand.touch_at_once(strategy.next_pose(belief, history))
        if wrong_pose:
            record = misread(record, seed)
        history.append(record)
        if by_place:
            belief.update_from_record(record)
        elif record.touched:
            belief.update(as_touches([record]))
        decision = belief.decide(ERROR)
        seconds.append(time.process_time() - began)
        row["best"].append(belief.best == truth)
        if by_place and len(history) in POSES_AFTER and truth != "unknown":
            row[f"pose_{len(history)}"] = pose_errors(stand, belief)
        if decision is not None and row["decision"] is None:
            row["decision"] = decision
            row["attempts"] = len(history) if decision == truth else BUDGET + 1
            if not goes_on:
                break
    row["cpu_ms"] = 1e3 * float(np.median(seconds))
    return row


def misread(record: TouchRecord, seed: int) -> TouchRecord:
    """Return the record of an arm that is always off by 2 mm and 2 degrees."""
    direction, axis = np.random.default_rng([seed, 5]).standard_normal((2, 3))
    turn = Rotation.from_rotvec(np.deg2rad(2) * axis / np.linalg.norm(axis))
    shift = 2 * direction / np.linalg.norm(direction)
    x, y, z = (np.asarray(record.position_mm) + shift).tolist()
    start = SensorPose(record.start.position_mm, turn.apply(record.direction))
    return replace(record, start=start, position_mm=(x, y, z))


def pose_errors(stand: Stand, belief: PlaceBelief) -> tuple[float | None, float]:
    """Return errors of yaw (degrees, None for round things) and of the offset (mm).

    Of the object that it is, modulo the symmetry of its mesh. The offset is that of the
    middle of its bounding box at yaw 0.
    """
    thing, target = stand.thing, stand.bench.target
    face, order = face_and_symmetry(thing, np.asarray(target.rotation))
    pose = belief.pose(thing.name)
    upright = PlacedObject.resting(thing, face)
    middle = np.asarray(upright.centre_mm) - np.asarray(upright.position_mm)
    cos, sin = np.cos(target.yaw_rad), np.sin(target.yaw_rad)
    turned = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ middle
    true_offset_mm = (
        turned + np.asarray(target.position_mm) - stand.hemisphere.centre_mm
    )
    offset = float(np.hypot(*(true_offset_mm - pose.offset_mm)[:2]))
    if order == AZIMUTHS_OF_ROUND:
        return None, offset
    step = 2 * np.pi / order
    turn_error = (pose.turn_rad - target.yaw_rad + step / 2) % step - step / 2
    return float(np.degrees(abs(turn_error))), offset


@cache
def _faces(thing: SimObject) -> list[int]:
    dome = DomeCamera((64, 64), n_nodes=16)
    n_faces = len(thing.resting_rotations)
    return [mesh_surface(thing, face, dome).symmetry() for face in range(n_faces)]


def face_and_symmetry(thing: SimObject, rotation: np.ndarray) -> tuple[int, int]:
    """Return the face a rotation is, and how many turns of it look alike."""
    differences = np.abs(thing.resting_rotations - rotation).max(axis=(1, 2))
    face = int(differences.argmin())
    return face, _faces(thing)[face]


def summary(rows: list[Row]) -> Row:
    """Return means over episodes, with the standard deviation over seeds."""
    right = np.array([row["decision"] == row["object"] for row in rows])
    wrong = np.array([row["decision"] not in (row["object"], None) for row in rows])
    seeds = np.array([row["seed"] for row in rows])
    attempts = np.array([row["attempts"] for row in rows], float)
    by_10 = np.array([row["best"][:10][-1] for row in rows])
    per_seed, right_per_seed, wrong_per_seed = (
        [values[seeds == seed].mean() for seed in np.unique(seeds)]
        for values in (attempts, right, wrong)
    )
    poses: Row = {}
    for after in POSES_AFTER:
        errors = [row[f"pose_{after}"] for row in rows if f"pose_{after}" in row]
        if errors:
            yaws = [yaw for yaw, _ in errors if yaw is not None]
            poses[f"yaw_deg_{after}"] = round(float(np.median(yaws)), 1)
            offsets = [offset for _, offset in errors]
            poses[f"offset_mm_{after}"] = round(float(np.median(offsets)), 1)
    return {
        "episodes": len(rows),
        "attempts": round(float(attempts.mean()), 2),
        "attempts_sd": round(float(np.std(per_seed)), 2),
        "right": round(float(right.mean()), 3),
        "right_sd": round(float(np.std(right_per_seed)), 3),
        "wrong": round(float(wrong.mean()), 3),
        "wrong_sd": round(float(np.std(wrong_per_seed)), 3),
        "best_by_10": round(float(by_10.mean()), 3),
        **poses,
        "cpu_ms": round(float(np.median([row["cpu_ms"] for row in rows])), 1),
    }


def less_random(rows: list[Row], random: list[Row]) -> Row:
    """Return attempts less those of random places there, and the error of that."""
    of_random = {row["placement"]: row["attempts"] for row in random}
    if any(row["placement"] not in of_random for row in rows):
        return {}
    less = [row["attempts"] - of_random[row["placement"]] for row in rows]
    error = np.std(less, ddof=1) / np.sqrt(len(less))
    return {
        "less_random": round(float(np.mean(less)), 2),
        "less_random_error": round(float(error), 2),
    }


def table_of(kept: dict[str, list[Row]]) -> dict[str, Row]:
    """Return the summary of each condition and strategy."""
    return {
        key: summary(rows)
        | less_random(rows, kept.get(f"{key.rsplit(', ', 1)[0]}, random", []))
        for key, rows in kept.items()
    }


def placements(
    seed: int, condition: str, n_episodes: int, known_height: bool = True
) -> Iterator[tuple[int, Stand]]:
    """Put things down in turn until there are `n_episodes` at least."""
    things = STRANGERS if condition == "stranger" else HOUSEHOLD
    n_placed = 0
    for number in count():
        for code, thing in enumerate(things):
            where = seed_of(2, seed, number, code, CONDITIONS.index(condition))
            stand = placed(thing, condition, where, known_height)
            if stand is not None:
                yield where, stand
                n_placed += 1
        if n_placed >= n_episodes:
            return


def seed_of(*numbers: int) -> int:
    """Return a seed that goes with these numbers."""
    return int(np.random.SeedSequence(numbers).generate_state(1)[0])


def map_of(belief: str, recogniser: Any, touches: Touches, seed: int) -> Any:
    """Return a map of the objects; "mesh" knows their meshes, without any picture."""
    if belief == "turns":
        return TouchMap(random_state=seed).fit(recogniser, touches)
    if belief == "places":
        return SurfaceMap(random_state=seed).fit(recogniser, touches)
    meshes = {thing.name: thing for thing in HOUSEHOLD}
    learnt = SurfaceMap(use_pictures=False, random_state=seed)
    return learnt.fit(recogniser, touches, meshes)


def keep_rows(path: Path, name: str, table: dict[str, Row]) -> None:
    """Put the rows of a table into the file of all tables."""
    tables = json.loads(path.read_text()) if path.exists() else {}
    tables[name] = {**tables.get(name, {}), **table}
    write_text(path, json.dumps(tables, indent=1, sort_keys=True) + "\n")


def main() -> None:
    """Run, print a table, and write JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--belief", choices=["turns", "places", "mesh"], default="places"
    )
    parser.add_argument("--faces", choices=["usual", "all"], default="all")
    parser.add_argument("--conditions", nargs="+", default=["new yaw", "other face"])
    parser.add_argument("--strategies", nargs="+", default=list(STRATEGIES))
    parser.add_argument("--wrong-pose", action="store_true", help="by 2 mm, 2 deg")
    parser.add_argument("--unknown-height", action="store_true", help="see put_down")
    parser.add_argument("--seeds", type=int, default=3, help="one teaching each")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=40, help="a seed, at least")
    parser.add_argument("--cache", type=Path, help="a folder for taught touches")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--rows", type=Path, help="a file to add every episode to")
    options = parser.parse_args()
    kept: dict[str, list[Row]] = {}
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        known_height = not options.unknown_height
        touches = taught(seed, options.faces, options.cache, known_height)
        recogniser = ObjectRecogniser(random_state=seed).fit(touches)
        learnt = map_of(options.belief, recogniser, touches, seed)
        for condition, name in product(options.conditions, options.strategies):
            rows = kept.setdefault(f"{condition}, {name}", [])
            for where, stand in placements(
                seed, condition, options.episodes, known_height
            ):
                row = one_episode(stand, learnt, name, where, options.wrong_pose)
                rows.append({"seed": seed, "placement": where, **row})
                if options.rows:
                    with options.rows.open("a") as file:
                        file.write(json.dumps({"of": condition, "by": name} | rows[-1]))
                        file.write("\n")
            print(seed, condition, name, flush=True)
        table = table_of(kept)
        for key, row in table.items():
            print(f"up to seed {seed}: {key:22s} {json.dumps(row)}", flush=True)
        if options.out:
            name = (
                f"{options.belief}, {options.faces}"
                + ", unknown height" * options.unknown_height
            )
            keep_rows(options.out, name + ", wrong pose" * options.wrong_pose, table)


if __name__ == "__main__":
    main()
