"""Learning what a part looks like, and how symmetric it is, from presses alone.

The presses' poses are unknown, so template and poses are improved in turn. How many
turns look the same is settled on presses that the template has not seen.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from .._types import Floats
from ._pose_register import OVERSAMPLING, fit_planes, refine, register, render
from ._repose import interpolate, repose

SYMMETRIES = (0, 8, 6, 5, 4, 3, 2, 1)
_N_ROUNDS = 4
# How much worse than others, on unseen presses, a symmetry may fit and still be
# taken. Fewer turns have more freedom to fit noise, so the fit without symmetry and
# the round one are compared with more patience. Square grids of taxels look the same
# in 1, 2 and 4 turns, and lend even a disc something of that. Set on two draws of
# simulated parts; the tests use another.
_TOLERANCE, _TOLERANCE_NONE, _TOLERANCE_ROUND = 1.05, 1.075, 1.078
_OF_THE_GRID, _TOLERANCE_GRID = (1, 2, 4), 1.3
# Symmetries that spoil the template itself more than this are not tried.
_LEAST_LIKENESS = 0.8
_ROUND_COPIES = 36


def learn_template(
    images: Floats, centres: Floats, symmetry: int
) -> tuple[Floats, Floats]:
    """Return a template of `symmetry`, and the poses of the presses on it.

    Parameters
    ----------
    images : ndarray of shape (n_touches, n_rows, n_cols)
    centres : ndarray of shape (n_touches, 2)
        First guess of (x, y) of each, in taxels.
    symmetry : int

    Returns
    -------
    template : ndarray of shape (size, size)
    poses : ndarray of shape (n_touches, 3)
    """
    first = np.array([[0.0, *centres[0]]])
    template = symmetrise(_average(images[:1], first), symmetry)
    poses = first
    for _ in range(_N_ROUNDS):
        poses, _ = register(images, template, centres, symmetry)
        template = improve(images, poses, symmetry)
    return template, poses


def find_symmetry(images: Floats, centres: Floats) -> int:
    """Return in how many turns the part looks the same, 0 for all.

    Each half of the presses teaches a template without symmetry; each symmetry is
    then imposed on it and tried on the other half. The highest symmetry that fits
    about as well as the best one is taken.
    """
    halves = np.arange(len(images)) % 2 == 0
    learnt = {}
    for name, half in (("even", halves), ("odd", ~halves)):
        learnt[name] = learn_template(images[half], centres[half], 1)
    likeness = {
        s: min(_likeness(template, s) for template, _ in learnt.values())
        for s in SYMMETRIES
    }
    error = {}
    for symmetry in SYMMETRIES:
        if likeness[symmetry] < _LEAST_LIKENESS:
            continue
        error[symmetry] = sum(
            _unseen_error(images, centres, symmetry, halves == flag, learnt[name])
            for name, flag in (("even", True), ("odd", False))
        )
    return _choose_symmetry(error)


def improve(images: Floats, poses: Floats, symmetry: int) -> Floats:
    """Return the template that fits presses at known poses.

    The average of the presses, turned back, is blurred by interpolation; two rounds
    of averaging what it leaves unexplained sharpen it again.
    """
    template = symmetrise(_average(images, poses), symmetry)
    for _ in range(2):
        drawn = render(template, poses, images.shape[1:])
        plane = fit_planes(images, drawn, poses)
        plane = np.maximum(plane, 0.3 * np.median(plane, axis=(1, 2), keepdims=True))
        rest = _pull(plane * (images - plane * drawn), poses).sum(axis=0)
        weight = _pull(plane**2, poses).sum(axis=0)
        rest /= np.maximum(weight, 1e-3 * weight.max())
        template = template + symmetrise(rest, symmetry)
    return template


def symmetrise(template: Floats, symmetry: int) -> Floats:
    """Return the mean of the template's copies in all turns that look the same."""
    n_copies = symmetry or _ROUND_COPIES
    if n_copies == 1:
        return template
    copies = np.repeat(template[np.newaxis], n_copies, axis=0)
    angles = np.arange(n_copies) * (360 / n_copies)
    mean: Floats = repose(copies, angles, interpolation="cubic").mean(axis=0)
    return mean


def template_angle(template: Floats, centroid: Floats, symmetry: int) -> float:
    """Direction in degrees in which the template reaches farthest, 0 for a disc."""
    if symmetry == 0:
        return 0.0
    half = (len(template) - 1) / 2
    grid = (np.arange(len(template)) - half) / OVERSAMPLING
    u = (grid - centroid[0]) + 1j * (grid - centroid[1])[:, None]
    shape = template > template.max() / 2
    wave = np.abs(u) ** 2 * np.exp(1j * symmetry * np.angle(u))
    return float(np.rad2deg(np.angle(wave[shape].sum())) / symmetry)


def _average(images: Floats, poses: Floats) -> Floats:
    """Mean of the presses, turned back; places none has reached copy the nearest.

    Were they empty, a bar longer than the array would seem to end there.
    """
    weight = _pull(np.ones_like(images), poses).sum(axis=0)
    total = _pull(images, poses).sum(axis=0)
    reached = weight > 0.02 * len(images)
    nearest = distance_transform_edt(~reached, return_indices=True)[1]
    mean: Floats = (total / np.maximum(weight, 1e-9))[tuple(nearest)]
    return mean


def _pull(images: Floats, poses: Floats) -> Floats:
    """Turn images back onto the template, 0 where a press did not reach."""
    n_rows, n_cols = images.shape[1:]
    half = OVERSAMPLING * max(n_rows, n_cols)
    v, u = np.mgrid[-half : half + 1, -half : half + 1] / OVERSAMPLING
    cos, sin = np.cos(poses[:, 0])[:, None, None], np.sin(poses[:, 0])[:, None, None]
    row = sin * u + cos * v + poses[:, 2, None, None] + (n_rows - 1) / 2
    col = cos * u - sin * v + poses[:, 1, None, None] + (n_cols - 1) / 2
    return interpolate(images, np.stack([row, col]), "zero", "linear")


def _likeness(template: Floats, symmetry: int) -> float:
    """Share of the template's square that is left after symmetrising."""
    kept = symmetrise(template, symmetry)
    return float((kept**2).sum() / (template**2).sum())


def _choose_symmetry(error: dict[int, float]) -> int:
    """Return the highest symmetry whose error on unseen presses is tolerable."""
    grid = [error[s] for s in error if s in _OF_THE_GRID]
    finite = [error[s] for s in error if s and s not in _OF_THE_GRID]
    if 0 in error and finite:
        limit = min(_TOLERANCE_ROUND * min(finite), _TOLERANCE_GRID * min(grid))
        if error[0] <= limit:
            return 0
    best = min(value for s, value in error.items() if s)
    several = min((value for s, value in error.items() if s > 1), default=best)
    limit = min(_TOLERANCE * several, _TOLERANCE_NONE * best)
    return max((s for s in error if s and error[s] <= limit), default=1)


def _unseen_error(
    images: Floats,
    centres: Floats,
    symmetry: int,
    seen: NDArray[np.bool_],
    learnt: tuple[Floats, Floats],
) -> float:
    """Error on the unseen half of a template learnt on the other."""
    template, poses = learnt
    template = symmetrise(template, symmetry)
    poses, _ = refine(images[seen], template, poses, symmetry)
    template = improve(images[seen], poses, symmetry)
    _, errors = register(images[~seen], template, centres[~seen], symmetry)
    return float(errors.sum())
