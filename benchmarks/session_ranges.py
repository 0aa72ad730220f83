"""How recordings of real sensors differ: the ranges that simulated sessions draw from.

    python benchmarks/session_ranges.py ../shared/data

Prints the standard deviations that `DomeCamera.remounted` and `simulate_presses` take
over, and beside those of the dome what one step of each simulated cause does.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from palpate import Touches
from palpate.simulation import DomeCamera

# Rings about the middle of the disc, in radii of the rim.
INNER, MIDDLE, OUTER = (0.0, 0.2), (0.4, 0.7), (0.8, 0.95)
# A touch with this correlation with the frame of no contact shows none.
ALIKE = 0.97


def light(picture, row, col, radius):
    """Return log grey of three rings about the middle, and the outer one's slope."""
    rows, cols = np.indices(picture.shape)
    distance = np.hypot(rows - row, cols - col) / radius
    ring = (distance > OUTER[0]) & (distance < OUTER[1])
    sides = np.stack([rows - row, cols - col])[:, ring] / radius
    mean, down, right = np.linalg.lstsq(
        np.column_stack([np.ones(ring.sum()), *sides]), picture[ring], rcond=None
    )[0]
    means = [
        np.log(picture[(distance >= low) & (distance < high)].mean())
        for low, high in (INNER, MIDDLE)
    ]
    return [*means, np.log(mean), down / mean, right / mean]


def dome(folder):
    touches = Touches.load(folder / "bathtip" / "bathtip50.npz")
    pictures, idle = touches.images.astype(float), touches.no_contact
    labels = touches.columns["rim_circle_row_col_radius_px"]
    within = (slice(10, 100), slice(10, 100))
    like = [
        np.corrcoef(p[within].ravel(), idle[within].ravel())[0, 1] for p in pictures
    ]
    rims, lights = [], []
    for name in np.unique(touches.object):
        rows = touches.object == name
        rims.append(np.median(labels[rows], axis=0))
        resting = rows & (np.array(like) > ALIKE)
        if resting.sum() > 2:
            lights.append(light(np.median(pictures[resting], axis=0), *rims[-1]))
    rims, lights = np.array(rims), np.array(lights)
    radius = np.median(rims[:, 2])
    print(f"BathTip: {len(rims)} recordings, {len(lights)} of them with rest")
    print("  rim, down and right (radii):", *sd(rims[:, :2] / radius))
    print("  its radius (log):", *sd(np.log(rims[:, 2:])))
    print("  grey of the outer ring (log):", *sd(lights[:, 2:3]))
    print("  middle over outer (log):", *sd(lights[:, 1:2] - lights[:, 2:3]))
    print("  slope across, down and right (a radius):", *sd(lights[:, 3:]))
    camera = DomeCamera()
    n_rows = camera.image_shape[0]
    rim = [n_rows * v for v in (*camera.disc_centre, camera.disc_radius)]
    reference = np.array(light(camera.no_contact().astype(float), *rim))
    steps = {
        "gain": 1.1 * camera.gain,
        "specular": 1.1 * camera.specular,
        "light_slope": (0.1, 0.0),
        "camera_offset_mm": (1.0, 0.0),
    }
    for name, value in steps.items():
        other = replace(camera, **{name: value}).no_contact().astype(float)
        change = np.array(light(other, *rim)) - reference
        figures = (
            f"outer {change[2]:.4f}, middle over outer {change[1] - change[2]:.4f}"
        )
        print(f"  simulated {name} {value}: {figures}, slope {change[3:].round(4)}")


def mats(folder):
    touches = Touches.load(folder / "sessions" / "mattress.npz")
    sides = [touches[touches.session == name] for name in np.unique(touches.session)]
    rows = [
        dict(
            zip(
                zip(s.object, s.subject, strict=True),
                s.images.astype(float),
                strict=True,
            )
        )
        for s in sides
    ]
    both = sorted(set(rows[0]) & set(rows[1]))
    first, second = (np.array([side[key] for key in both]) for side in rows)
    loads = np.log(second.sum(axis=(1, 2)) / first.sum(axis=(1, 2)))
    zero = [np.percentile(levels, 5, axis=0) for levels in (first, second)]
    mean = [
        levels.mean(axis=0) - low
        for levels, low in zip((first, second), zero, strict=True)
    ]
    loaded = np.all([levels > np.percentile(levels, 60) for levels in mean], axis=0)
    gains = np.log(mean[1][loaded] / mean[0][loaded])
    half = np.sqrt(0.5)  # a difference of two sessions
    print(f"Mats: {len(both)} postures of a person on both mattresses")
    print(f"  whole load (log): {np.hypot(loads.mean(), loads.std()) * half:.3f}")
    print(f"  taxels' gain, {loaded.sum()} loaded (log): {gains.std() * half:.3f}")
    full = touches.images.max()
    moved = robust((zero[1] - zero[0]).ravel()) * half
    print(
        f"  taxels' zero: {moved:.2f} of {full} counts, {255 * moved / full:.2f} of 255"
    )


def array(folder):
    touches = Touches.load(folder / "taxel10x10" / "taxel10x10.npz")
    loads = touches.columns["frames"].astype(float).sum(axis=(2, 3))
    share_left = np.median(loads[:, -1] / loads.max(axis=1))
    print(
        f"Array: after a press {share_left:.3f} of its greatest load is left (median)"
    )


def sd(values):
    return [f"{value:.4f}" for value in np.std(values, axis=0, ddof=1)]


def robust(values):
    return 1.4826 * np.median(np.abs(values - np.median(values)))


if __name__ == "__main__":
    for part in (dome, mats, array):
        part(Path(sys.argv[1]))
