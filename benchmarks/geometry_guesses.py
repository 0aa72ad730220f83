"""Why geometry names simulated presses so well: each guess tried by itself.

Area and perimeter of the cleaned image name 91-95 % of simulated presses, and 63 % of
the paper's (docs/explanation/liu2014.md). Each condition here is one thing that a real
array may have and the simulated one has not, or has less of; 3-NN, ten runs of twofold
cross-validation, seed 0. What the simulator does not model is put into its images:
hysteresis as a share of the press before that stays, or as a strength that depends on
the branch of the loop; rounded edges as the mean of presses with faces of three sizes.

    python benchmarks/geometry_guesses.py
"""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import Polygon

from palpate.simulation import Part, PressureArray, find_parts, simulate_presses
from palpate.studies.liu2014 import Liu2014Plan
from palpate.studies.liu2014.methods import Job, Neighbours, nested_figure
from palpate.studies.liu2014.plan import encode

N_PRESSES, RUNS, SEED = 20, 10, 0
# In the order of their names, as in the study: 3-NN names the first of equal ones.
PARTS = find_parts()
NUMBERS = np.unique([part.name for part in PARTS], return_inverse=True)[1]
CODES = np.repeat(NUMBERS, N_PRESSES)
COMPARED = (("GE", "z-scored"), ("GE", "raw"), ("FD", "raw"), ("FD+GE", "raw"))

Images = NDArray[np.float64]


def main() -> None:
    for name, images in _conditions():
        levels = np.clip(np.rint(images), 0, 255).astype(np.uint8)
        encoded = encode(levels, 2, 40)
        figures = {
            f"{encoding}, {scaling}": _right(encoded.features(encoding, 40), scaling)
            for encoding, scaling in COMPARED
        }
        print(json.dumps({"condition": name, **figures}), flush=True)


def _right(features: Images, scaling: str) -> str:
    job = Job({"features": scaling}, features, CODES, Neighbours())
    runs = [job.run(Liu2014Plan(seed=SEED), run) for run in range(RUNS)]
    figure = nested_figure(job.method.settings, runs)
    return f"{figure['ours']:.1f} ± {figure['sd']:.1f}"


def _conditions() -> Iterator[tuple[str, Images]]:
    rng = np.random.default_rng(SEED)
    plain = _pressed()
    yield "as it is", plain
    for load in ((3.0, 4.5), (1.0, 5.0)):
        yield f"load {load[0]:g}-{load[1]:g} kgf", _pressed(load_kgf=load)
    for spread in (0.0, 0.3, 0.5):
        device = PressureArray(gain_spread=spread)
        yield f"gains of the taxels, {spread:g}", _pressed(array=device)
    for spread in (0.2, 0.5):
        gains = np.exp(spread * rng.standard_normal(plain.shape) - spread**2 / 2)
        yield f"gains drawn anew every press, {spread:g}", plain * gains
    order = rng.permutation(len(plain))
    before = np.empty_like(plain)
    before[order] = plain[np.roll(order, 1)]
    for share in (0.1, 0.2, 0.3):
        yield f"{100 * share:g} % of the press before, any part", plain + share * before
    previous = np.roll(plain, 1, axis=0)
    yield "20 % of the press before, part after part", plain + 0.2 * previous
    branch = rng.uniform(0.8, 1.2, (len(plain), 1, 1))
    yield "strength by the branch, 20 % either way", plain * branch
    for radius in (0.25, 0.5):
        faces = [[_inset(part, f * radius) for part in PARTS] for f in (0, 0.5, 1)]
        rounded = np.mean([_pressed(parts=face) for face in faces], axis=0)
        yield f"edges rounded by {radius} mm", rounded
    yield "tilt 0.3 degrees", _pressed(tilt_sd_deg=0.3)
    yield "unevenness 20 µm", _pressed(roughness_um=20)
    yield "noise 30 kPa", _pressed(array=PressureArray(noise_kpa=30))
    yield "dead zone 200 kPa", _pressed(array=PressureArray(dead_zone_kpa=200))
    yield "cover of 10 MPa", _pressed(array=PressureArray(cover_modulus_mpa=10))


def _pressed(parts: Any = PARTS, **options: Any) -> Images:
    """Return simulated presses, (n_presses, rows, cols), at the same places always."""
    touches = simulate_presses(parts, N_PRESSES, random_state=SEED, **options)
    return touches.images.astype(np.float64)


def _inset(part: Part, depth_mm: float) -> Part:
    """Return the part with every edge of its face drawn back."""
    face = Polygon(part.outline_mm, part.holes_mm).buffer(-depth_mm, join_style="mitre")
    return Part.from_polygon(part.name, face, symmetry=part.symmetry)


if __name__ == "__main__":
    main()
