"""How many recorded touches simulated ones save.

    PALPATE_DATA=... python benchmarks/touches_saved.py

Six kinds of object. Per draw one real object (BathTip) of each kind is drawn; 2, 5 or
10 of its touches are learnt, alone or together with 60 simulated touches of each of
nine objects of these kinds, and 30 touches of every other real object ask for its kind.
Simulated touches are approached as those of benchmarks/how_real.py, in three sessions.

"exchanged" is a control: the kinds of the simulated objects are exchanged at random, so
that the pictures are there, but what they say of a kind is wrong. "disc" is another:
the place of the disc, the brightness and the contrast of a picture alone.
"""

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

from explore import KINDS, _accuracy, _bathtip
from palpate import Touches
from palpate._durable import write_text
from palpate.recognition import ObjectRecogniser, adapt
from palpate.simulation import find_objects, simulate_touches

COUNTS = (2, 5, 10)
N_ASKED = 30
COLUMNS = ("object", "category")


def recorded_kinds(data: Path) -> Touches:
    """Return real touches of the six kinds, these as their category."""
    kind_of = {theirs: kind for kind, names in KINDS.items() for theirs in names}
    recorded = _bathtip(data)
    recorded = recorded[np.isin(recorded.category, list(kind_of))]
    kinds = np.array([kind_of[str(name)] for name in recorded.category])
    return recorded.with_columns(category=kinds)


def drawn(recorded: Touches, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return rows of one object a kind, (n_kinds, most touches), and of the others."""
    taught, names = [], []
    for kind in KINDS:
        name = rng.choice(np.unique(recorded.object[recorded.category == kind]))
        rows = rng.permutation(np.flatnonzero(recorded.object == name))
        taught.append(rows[: max(COUNTS)])
        names.append(name)
    others = np.unique(recorded.object[~np.isin(recorded.object, names)])
    asking = [
        rng.permutation(np.flatnonzero(recorded.object == name))[:N_ASKED]
        for name in others
    ]
    return np.array(taught), np.concatenate(asking)


def simulated_kinds(seed: int) -> Touches:
    """Return simulated touches of the nine objects of these kinds."""
    both = find_objects(["household", "unseen"])
    things = [thing for thing in both if thing.category in KINDS]
    options = {"max_tilt_deg": 50, "max_roll_deg": 0, "n_sessions": 3}
    return simulate_touches(things, random_state=seed, **options)


def plain(touches: Touches) -> Touches:
    """Return touches with their labels alone, as both kinds of set have them."""
    columns = {name: touches.columns[name].astype(str) for name in COLUMNS}
    return Touches(touches.images, geometry="dome", **columns)


def exchanged(touches: Touches, rng: np.random.Generator) -> Touches:
    """Return touches whose kinds were exchanged, each for another one."""
    kinds = list(KINDS)
    shift = int(rng.integers(1, len(kinds)))
    other = dict(zip(kinds, np.roll(kinds, shift), strict=True))
    return touches.with_columns(
        category=np.array([other[str(kind)] for kind in touches.category])
    )


def one_draw(recorded: Touches, seed: int) -> dict[str, list[float]]:
    """Return accuracies after 1, 5 and 15 touches, by what was learnt and how."""
    rng = np.random.default_rng([9, seed])
    taught, asking = drawn(recorded, rng)
    simulated, tested = simulated_kinds(seed), plain(recorded[asking])
    plain_simulated = plain(simulated)
    wrong = exchanged(plain_simulated, rng)
    right: dict[str, list[float]] = {}
    for rehearse in (True, False):
        options: dict[str, Any] = {"label": "category", "random_state": seed}
        options["rehearse"] = rehearse
        name = "rehearsed" if rehearse else "plain"
        alone = ObjectRecogniser(**options).fit(plain_simulated)
        right[f"{name}, simulated, 0"] = _accuracy(alone, tested)
        for count in COUNTS:
            real = plain(recorded[taught[:, :count].ravel()])
            both = Touches.concatenate([plain_simulated, real])
            sets = {"real": real.without("object"), "simulated and real": both}
            if rehearse and count == COUNTS[1]:
                sets["exchanged and real"] = Touches.concatenate([wrong, real])
            for title, touches in sets.items():
                learnt = ObjectRecogniser(**options).fit(touches)
                right[f"{name}, {title}, {count}"] = _accuracy(learnt, tested)
            adapted = adapt(alone, real)
            right[f"{name}, simulated, adapted, {count}"] = _accuracy(adapted, tested)
    for count in COUNTS:
        rows = taught[:, :count].ravel()
        right[f"control, disc, {count}"] = [disc_alone(recorded, rows, asking)]
    return right


def disc_alone(recorded: Touches, taught: np.ndarray, asking: np.ndarray) -> float:
    """Return the accuracy of a touch by disc, brightness and contrast alone."""
    images = recorded.images.reshape(len(recorded), -1)
    rims = recorded.columns["rim_circle_row_col_radius_px"]
    senses = np.column_stack([rims, images.mean(axis=1), images.std(axis=1)])
    kinds = recorded.category.astype(str)
    model = LinearDiscriminantAnalysis(solver="lsqr", shrinkage="auto")
    hits = model.fit(senses[taught], kinds[taught]).predict(senses[asking])
    of = recorded.object[asking]
    shares = [(hits == kinds[asking])[of == name].mean() for name in np.unique(of)]
    return float(np.mean(shares))


def main() -> None:
    """Run, print a line a draw, then means and spread, and write JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    recorded = recorded_kinds(Path(os.environ["PALPATE_DATA"]))
    draws = []
    for seed in range(options.first, options.first + options.draws):
        began = time.process_time()
        draws.append(one_draw(recorded, seed))
        print(f"draw {seed}: {time.process_time() - began:.0f} s of CPU", flush=True)
        rows = {}
        for name in draws[0]:
            values = 100 * np.array([draw[name] for draw in draws])
            sd = values.std(axis=0, ddof=1) if len(values) > 1 else 0 * values[0]
            rows[name] = {
                "mean": values.mean(axis=0).round(1).tolist(),
                "sd": sd.round(1).tolist(),
                "each": values.round(1).tolist(),
            }
        if options.out:
            write_text(options.out, json.dumps({"rows": rows}, indent=1) + "\n")
    for name, row in rows.items():
        print(f"{name:40s} {row['mean']} {row['sd']}")


if __name__ == "__main__":
    main()
