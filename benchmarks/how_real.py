"""Set simulated dome touches beside real ones: a table, and a picture kept at home.

Beside them the ceiling of "simulated -> real": the category of real objects by a
recogniser that learnt one real object of each category.

Needs the real BathTip touches in the folder that PALPATE_DATA names (see
docs/explanation/how-real.md). They are not ours to publish: do not commit the picture.

    PALPATE_DATA=... python benchmarks/how_real.py --picture side-by-side.png
"""

import argparse
import json
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from palpate import Touches
from palpate.encodings import ZernikeMoments
from palpate.evaluation import Plan, evaluate, split_touches
from palpate.simulation import DomeCamera, Scene, simulate_touches

# Settings were scored on the first recordings (see docs/explanation/how-real.md)...
FITTED = ("01_stapler", "03_ball", "05_shoe", "07_mug", "09_bowl")
# ...and never on these, though their statistics were seen while settings were open.
HELD_OUT = ("02_bottleempty", "04_softtoy", "06_box", "08_bottlefull", "10_can")
PAIRS = {
    "01_stapler": "stapler",
    "03_ball": "ball",
    "07_mug": "mug",
    "02_bottleempty": "water bottle",
    "06_box": "box",
    "08_bottlefull": "shampoo bottle",
    "10_can": "porridge pot",
}
SAFE_RADIUS = 196 / 480  # of the height: the largest disc about the rim's centre
SIDE = 96
CHANGED_GREY = 20
# Mean change of touches that dent the dome well; light ones are mostly no contact.
STRONG_GREY = 18
CEILING_TOUCHES = (1, 5, 15)

Images = NDArray[np.float32]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", default=os.environ.get("PALPATE_DATA"))
    parser.add_argument("--picture", help="where to write real above simulated")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if not options.data:
        parser.error("name the folder of real touches with --data or PALPATE_DATA")
    folder = Path(options.data) / "bathtip"
    real = {name: _real(folder, name) for name in FITTED + HELD_OUT}
    plain = _cropped(
        _grey(folder / "originals" / "baselineForCalibration.jpg"), 206, 215
    )
    simulated, nothing = _simulated(options.seed)
    rows = _rows(real, plain, simulated, nothing)
    ceiling = _ceiling(Touches.load(folder / "bathtip50.npz"), options.seed)
    print(json.dumps({"touches": rows, "one real object of each": ceiling}, indent=1))
    if options.picture:
        cv2.imwrite(options.picture, _side_by_side(real, simulated))


def _real(folder: Path, name: str) -> Images:
    """Safe discs of one object's frames, each recording about its usual rim."""
    archive = np.load(folder / "bathtip50.npz")
    files = [Path(str(path)).name for path in archive["source_path"]]
    touches = dict(zip(files, range(len(files)), strict=True))
    frames = sorted((folder / "originals" / name / "01").glob("*.jpg"))
    owner = archive["object"][touches[frames[0].name]]
    rims = archive["rim_circle_row_col_radius_px"][archive["object"] == owner]
    row, col = 4 * np.median(rims, axis=0)[:2] + 1.5
    return np.stack([_cropped(_grey(frame), row, col) for frame in frames])


def _simulated(seed: int) -> tuple[dict[str, Images], Images]:
    """The same of simulated touches, approached the way the real arm could."""
    camera = DomeCamera()
    touches = simulate_touches(
        n_touches=75,
        camera=camera,
        scene=Scene(max_tilt_deg=50, max_roll_deg=0, keep_misses=True),
        drift=False,
        random_state=seed,
    )
    row, col = (480 * at - 0.5 for at in camera.disc_centre)
    discs = np.stack([_cropped(image, row, col) for image in touches.images])
    names = touches.columns["object"]
    plain = _cropped(touches.whole["no_contact"], row, col)
    return {str(name): discs[names == name] for name in np.unique(names)}, plain


def _grey(path: Path) -> NDArray[np.uint8]:
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))


def _cropped(image: NDArray[Any], row: float, col: float) -> Images:
    """Square about the disc's centre, (SIDE, SIDE), noise smoothed as in both."""
    half = SAFE_RADIUS * image.shape[0]
    step = 2 * half / SIDE
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 2.0)
    left, top = col - half + step / 2, row - half + step / 2
    place = np.array([[step, 0, left], [0, step, top]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(smooth, place, (SIDE, SIDE), flags=flags))


def _ceiling(touches: Touches, seed: int) -> dict[str, Any]:
    """Accuracy on the other objects, each object of a category learnt in turn."""
    plan = Plan(label="category", touches=CEILING_TOUCHES, seed=seed)
    runs = []
    # The folds of unseen objects with their parts exchanged: one object teaches.
    for fold in split_touches(touches, "unseen-objects"):
        figures, _ = evaluate(fold.test, fold.train, plan=plan)
        runs.append([100 * figures["accuracy"][str(k)] for k in CEILING_TOUCHES])
    shares = np.array(runs)
    return {
        "after": CEILING_TOUCHES,
        "mean": _rounded(shares.mean(axis=0), 1),
        "sd": _rounded(shares.std(axis=0, ddof=1), 1),
        "each": [_rounded(run, 1) for run in shares],
    }


def _disc() -> NDArray[np.bool_]:
    at = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
    return np.hypot(at[:, None], at) < 1


def _rows(
    real: dict[str, Images],
    plain: Images,
    simulated: dict[str, Images],
    nothing: Images,
) -> list[dict[str, Any]]:
    groups = {
        "real, fitted on": np.concatenate([real[name] for name in FITTED]),
        "real, held out": np.concatenate([real[name] for name in HELD_OUT]),
    }
    rows = [_described(name, images, plain) for name, images in groups.items()]
    all_simulated = np.concatenate(list(simulated.values()))
    rows.append(_described("simulated, ten objects", all_simulated, nothing))
    for theirs, ours in PAIRS.items():
        kind = "fitted on" if theirs in FITTED else "held out"
        rows.append(_described(f"real {theirs[3:]} ({kind})", real[theirs], plain))
        rows.append(_described(f"simulated {ours}", simulated[ours], nothing))
    return rows


def _described(name: str, images: Images, plain: Images) -> dict[str, Any]:
    """Statistics of a set against its picture of no contact."""
    disc = _disc()
    change = np.abs(images - plain)[:, disc]
    area = (change > CHANGED_GREY).mean(axis=1)
    like_nothing = np.array([np.corrcoef(i[disc], plain[disc])[0, 1] for i in images])
    strong = images[change.mean(axis=1) > STRONG_GREY]
    slope = np.hypot(*np.gradient(strong, axis=(1, 2)))[:, disc]
    greys = np.quantile(images[:, disc], [0.01, 0.25, 0.5, 0.75])
    return {
        "name": name,
        "n_touches": len(images),
        "area_quartiles": _rounded(np.quantile(area, [0.25, 0.5, 0.75]), 2),
        "mean_change": _rounded(np.quantile(change.mean(axis=1), [0.25, 0.5, 0.75]), 1),
        "no_contact": round(float((like_nothing > 0.98).mean()), 3),
        "grey_1_25_50_75": _rounded(greys, 0),
        "saturated": round(float((images[:, disc] > 250).mean()), 3),
        "components_95": _components(images),
        "strong": round(len(strong) / len(images), 2),
        "strong_slope_50_90_99": _rounded(np.quantile(slope, [0.5, 0.9, 0.99]), 1),
        "strong_order_shares": _rounded(_spectrum(strong), 3),
    }


def _spectrum(images: Images) -> NDArray[np.float64]:
    """Share of the orthonormal moments' energy by order, 1 to 15."""
    encoder = ZernikeMoments(15, weight="noll", drop_constant=True)
    moments = encoder.fit_transform(_standardised(images))
    order = encoder.indices_[:, 0]
    energy = np.array([(moments[:, order == n] ** 2).sum() for n in range(1, 16)])
    return np.asarray(energy / energy.sum())


def _components(images: Images) -> int:
    """How many principal components of the moments hold 95 % of the variance."""
    encoder = ZernikeMoments(15, weight="n+1", drop_constant=True)
    moments = encoder.fit_transform(_standardised(images))
    centred = moments - moments.mean(axis=0)
    variance = np.linalg.svd(centred, compute_uv=False) ** 2
    return int(np.searchsorted(np.cumsum(variance) / variance.sum(), 0.95)) + 1


def _standardised(images: Images) -> Images:
    inside = images[:, _disc()]
    mean, sd = inside.mean(axis=1), inside.std(axis=1)
    return np.asarray((images - mean[:, None, None]) / sd[:, None, None])


def _rounded(values: NDArray[Any], digits: int) -> list[float]:
    return [round(float(value), digits) for value in values]


def _side_by_side(
    real: dict[str, Images], simulated: dict[str, Images]
) -> NDArray[np.uint8]:
    """Eight evenly chosen touches of each pair, real above simulated."""
    strips = []
    for theirs, ours in PAIRS.items():
        for images in (real[theirs], simulated[ours]):
            chosen = images[np.linspace(0, len(images) - 1, 10).astype(int)]
            strips.append(np.hstack(list(chosen)))
        strips.append(np.full((6, strips[-1].shape[1]), 255, np.float32))
    return np.vstack(strips).astype(np.uint8)


if __name__ == "__main__":
    main()
