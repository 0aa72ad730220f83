"""What simulated touches are worth: on other devices, and on real ones.

    python benchmarks/explore.py device                # simulation alone
    PALPATE_DATA=... python benchmarks/explore.py      # all of it, with real touches
    python benchmarks/explore.py --write docs          # tables and pictures of it

Each part replaces its rows in benchmarks/explore.json. How many touches choosing
saves is measured by benchmarks/choose_touches.py. Protocols are in
docs/explanation/exploration-measured.md.
"""

import argparse
import json
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from exploration_pictures import draw
from exploration_tables import fill
from palpate import Touches
from palpate._durable import write_text
from palpate.evaluation._episodes import run_episodes
from palpate.evaluation._trial import spread
from palpate.recognition import ObjectRecogniser, adapt
from palpate.simulation import DomeCamera, find_objects, simulate_touches

Row = dict[str, Any]
OUT = Path(__file__).with_suffix(".json")
LENGTHS = (1, 5, 15)
N_ADAPT = 20
N_DEVICE_TOUCHES = 22
HERE = DomeCamera(image_shape=(96, 96))
DEVICES = {
    "same device": HERE,
    "membrane a quarter stiffer": replace(
        HERE, youngs_mpa=0.125, thickness_mm=1.65, texture_seed=1
    ),
    "membrane twice as stiff": replace(
        HERE, youngs_mpa=0.17, thickness_mm=2.0, texture_seed=1
    ),
    "other LEDs": replace(
        HERE,
        n_leds=6,
        led_ring_radius_mm=12.0,
        diffuse=0.25,
        specular=0.7,
        shininess=8.0,
    ),
    "other camera": replace(
        HERE,
        camera_distance_mm=55.0,
        disc_centre=(0.47, 0.47),
        disc_radius=0.5,
        gamma=1.8,
        noise_sd=5.0,
    ),
}
# Simulated kinds on the left, BathTip's on the right.
KINDS = {
    "stapler": ("stapler",),
    "ball": ("ball",),
    "mug": ("mug",),
    "box": ("box",),
    "pot": ("can",),
    "bottle": ("bottleempty", "bottlefull"),
}


def device(data: Path | None, preset: str, n_seeds: int) -> list[Row]:
    """Return accuracy on another device, before and after adapting with 20 touches."""
    accuracies: dict[str, list[Any]] = {name: [] for name in DEVICES}
    for seed in range(n_seeds):
        taught = simulate_touches(camera=HERE, n_sessions=3, random_state=seed)
        recogniser = ObjectRecogniser(preset, random_state=seed).fit(taught)
        for name, camera in DEVICES.items():
            touches = simulate_touches(
                n_touches=N_DEVICE_TOUCHES,
                camera=camera,
                n_sessions=2,
                random_state=1000 + seed,
            )
            few = _first(touches, N_ADAPT // len(recogniser.classes_))
            tested = touches[np.setdiff1d(np.arange(len(touches)), few)]
            adapted = adapt(recogniser, touches[few])
            accuracies[name].append(
                [_accuracy(recogniser, tested), _accuracy(adapted, tested)]
            )
    return [
        {
            "device": name,
            "n_seeds": n_seeds,
            "touches": list(LENGTHS),
            "before": np.mean(values, axis=0)[0].round(3).tolist(),
            "before_sd": spread(values)[0].round(3).tolist(),
            "after": np.mean(values, axis=0)[1].round(3).tolist(),
            "after_sd": spread(values)[1].round(3).tolist(),
        }
        for name, values in accuracies.items()
    ]


def real(data: Path | None, preset: str, n_seeds: int) -> list[Row]:
    """Learn kinds of object on simulated touches, recognise them on real ones."""
    if data is None:
        raise SystemExit("The part 'real' needs PALPATE_DATA.")
    names = {kind: ours for ours, theirs in KINDS.items() for kind in theirs}
    recorded = _bathtip(data)
    recorded = recorded[np.isin(recorded.category, list(names))]
    kinds = np.array([names[str(kind)] for kind in recorded.category])
    recorded = recorded.with_columns(category=kinds)
    both = find_objects(["household", "unseen"])
    things = [thing for thing in both if thing.category in KINDS]
    accuracies = []
    for seed in range(n_seeds):
        taught = simulate_touches(things, n_sessions=3, random_state=seed)
        recogniser = ObjectRecogniser(preset, label="category", random_state=seed).fit(
            taught
        )
        few, tested_rows = _few_real(recorded, seed)
        tested = recorded[tested_rows]
        adapted = adapt(recogniser, recorded[few])
        alone = ObjectRecogniser(preset, label="category", random_state=seed)
        alone.fit(recorded[few].without("object"))
        within, held_out = _within(taught, seed)
        itself = ObjectRecogniser(preset, label="category", random_state=seed).fit(
            within
        )
        accuracies.append(
            [
                _accuracy(learnt, touches)
                for learnt, touches in (
                    (recogniser, tested),
                    (adapted, tested),
                    (alone, tested),
                    (itself, held_out),
                )
            ]
        )
    titles = (
        "simulated",
        "simulated, adapted with 18 real touches",
        "those 18 real touches alone",
        "simulated, tested on simulated",
    )
    mean, sd = np.mean(accuracies, axis=0), spread(accuracies)
    return [
        {
            "learnt on": title,
            "n_kinds": len(KINDS),
            "n_seeds": n_seeds,
            "touches": list(LENGTHS),
            "accuracy": mean[number].round(3).tolist(),
            "accuracy_sd": sd[number].round(3).tolist(),
        }
        for number, title in enumerate(titles)
    ]


def _few_real(recorded: Touches, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rows of three touches of one object a kind, and of all other objects."""
    rng = np.random.default_rng(seed)
    few, used = [], []
    for kind in KINDS:
        names = np.unique(recorded.object[recorded.category == kind])
        name = rng.choice(names)
        rows = np.flatnonzero(recorded.object == name)
        few.append(rng.permutation(rows)[: N_ADAPT // len(KINDS)])
        used.append(name)
    return np.concatenate(few), np.flatnonzero(~np.isin(recorded.object, used))


def _within(taught: Touches, seed: int) -> tuple[Touches, Touches]:
    """Return the touches without, and those of, the last session of each object."""
    last = taught.columns["session"] == np.max(taught.columns["session"])
    return taught[~last], taught[last]


def _accuracy(recogniser: ObjectRecogniser, touches: Touches) -> list[float]:
    """Return the accuracy after each of `LENGTHS`, mean over objects and 20 orders."""
    truth = touches.object if recogniser.label == "object" else touches.category
    objects = touches.object
    log_likelihood = recogniser.log_likelihood(touches)
    episodes = run_episodes(recogniser, log_likelihood, objects, truth, 20, 0)
    return [float(episodes.scores(k).accuracy.mean()) for k in LENGTHS]


def _first(touches: Touches, each: int) -> np.ndarray:
    """Return the rows of the first touches of each object."""
    objects = touches.object
    rows = [np.flatnonzero(objects == name)[:each] for name in np.unique(objects)]
    return np.concatenate(rows)


def _bathtip(data: Path) -> Touches:
    return Touches.load(data / "bathtip" / "bathtip50.npz")


PARTS: dict[str, tuple[Callable[[Path | None, str, int], list[Row]], int]] = {
    "device": (device, 5),
    "real": (real, 5),
}


def main() -> None:
    """Run the parts that are asked for and write them beside this script."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], default=[])
    parser.add_argument("--preset", default="default")
    parser.add_argument("--runs", type=int, help="seeds")
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--write", type=Path, metavar="DOCS")
    options = parser.parse_args()
    kept = json.loads(options.out.read_text()) if options.out.exists() else {}
    if options.write is not None:
        fill(options.write / "explanation" / "exploration-measured.md", kept)
        draw(options.write / "images")
        return
    folder = os.environ.get("PALPATE_DATA")
    data = None if folder is None else Path(folder)
    for name in options.parts or PARTS:
        measure, usual = PARTS[name]
        began = time.process_time()
        rows = measure(data, options.preset, options.runs or usual)
        cpu_s = round(time.process_time() - began)
        kept[name] = {"preset": options.preset, "cpu_s": cpu_s, "rows": rows}
        write_text(options.out, json.dumps(kept, indent=1) + "\n")
        for row in rows:
            print(name, json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
