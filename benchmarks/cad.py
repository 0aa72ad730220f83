"""How far a mesh alone gets: objects explored, and objects known by their mesh only.

    python benchmarks/cad.py --out benchmarks/cad.json

Five simulated objects, touched with a dome that was mounted anew (`remounted`: other
light, place, rubber), at an unknown yaw, 5 mm (sd) aside, on their usual face, eight
times each. What is known of them differs:

- "explored": 36 touches each with that dome, in six sessions (`explore_to_learn`);
- "explored, surfaces of meshes": the same pictures, surfaces taken from meshes;
- "meshes and simulated pictures": no touch of that dome; surfaces from meshes, pictures
  of 36 touches of the mesh with the nominal dome;
- "meshes alone": the same without pictures;
- "mixed": every other object explored, the rest from meshes and simulated pictures.

As in benchmarks/policy.py, whose environment it is.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from palpate import Touches
from palpate._durable import write_text
from palpate.exploration import SurfaceMap, explore_to_learn
from palpate.exploration.environment import belief_touch_env
from palpate.recognition import ObjectRecogniser
from palpate.simulation import DomeCamera, find_object
from places import BUDGET, CAMERA, seed_of
from policy import Row, episodes, strategies, summary

NAMES = ("mug", "box", "pen", "stapler", "porridge pot")
N_TOUCHES, N_SESSIONS, N_ROUNDS = 36, 6, 8


def taught(camera: DomeCamera, seed: int) -> Touches:
    """Touch every object with a dome."""
    things = [find_object(name) for name in NAMES]
    options = {"n_sessions": N_SESSIONS, "guarded": False, "random_state": seed}
    return explore_to_learn(things, N_TOUCHES, camera, **options)


def maps(explored: Touches, drawn: Touches, seed: int) -> dict[str, SurfaceMap]:
    """Return a map of the objects for each kind of knowledge of them."""
    meshes = {name: find_object(name) for name in NAMES}
    from_mesh = NAMES[1::2]
    parts = (
        explored[~np.isin(explored.object, from_mesh)],
        drawn[np.isin(drawn.object, from_mesh)],
    )
    mixed = Touches.concatenate([part.without("no_contact") for part in parts])
    half_meshes = {name: meshes[name] for name in from_mesh}
    kinds: dict[str, tuple[Touches, dict[str, Any], bool]] = {
        "explored": (explored, {}, True),
        "explored, surfaces of meshes": (explored, meshes, True),
        "meshes and simulated pictures": (drawn, meshes, True),
        "meshes alone": (drawn, meshes, False),
        "mixed": (mixed, half_meshes, True),
    }
    learnt = {}
    for name, (touches, surfaces, use_pictures) in kinds.items():
        recogniser = ObjectRecogniser(random_state=seed).fit(touches)
        surface_map = SurfaceMap(use_pictures=use_pictures, random_state=seed)
        learnt[name] = surface_map.fit(recogniser, touches, surfaces)
    return learnt


def main() -> None:
    """Run, print a table, and write JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    seed = options.seed
    mounted = CAMERA.remounted(np.random.default_rng(seed_of(10, seed)))
    explored, drawn = taught(mounted, seed_of(11, seed)), taught(CAMERA, seed)
    table: dict[str, Row] = {}
    for name, surface_map in maps(explored, drawn, seed).items():
        env = belief_touch_env(surface_map, camera=mounted, max_touches=BUDGET)
        players = strategies(surface_map)
        random = episodes(env, players["random"], seed, N_ROUNDS)
        for title, rows in (
            ("random", random),
            ("chosen", episodes(env, players["chosen"], seed, N_ROUNDS)),
        ):
            row = summary(rows, random)
            by_mesh = [row["right"] for row in rows if row["object"] in NAMES[1::2]]
            row["right_of_box_and_stapler"] = round(float(np.mean(by_mesh)), 3)
            table[f"{name}, {title}"] = row
            print(f"{name + ', ' + title:40s} {json.dumps(row)}", flush=True)
    if options.out:
        write_text(options.out, json.dumps({"rows": table}, indent=1) + "\n")


if __name__ == "__main__":
    main()
