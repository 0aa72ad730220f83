"""Registering presses on a template: where it lies in each image, and how turned.

A pose is (angle, x, y): radians from the column axis towards the row axis, and the
template's origin in taxels from the middle of the image, x along columns and y along
rows. Templates are square, `OVERSAMPLING` pixels per taxel, origin in the middle.

A press is modelled as its template times a plane, since a hand presses unevenly.
The plane is solved for in closed form, so only the pose is searched.
"""

import numpy as np
from numpy.typing import NDArray

from ._repose import interpolate

Floats = NDArray[np.float64]

OVERSAMPLING = 2
# Prior variance of the plane's rise over `_PLANE_TAXELS`, against a level of 1.
_PLANE_PRECISION, _PLANE_TAXELS = 0.3, 3.0
_SEARCH_DEG = 5.0
_N_STEPS = 8
_DIFFERENCE = np.array([0.02, 0.05, 0.05])  # for derivatives: radians, taxels
_LONGEST_STEP = 0.3


def register(
    images: Floats, template: Floats, centres: Floats, symmetry: int
) -> tuple[Floats, Floats, Floats]:
    """Find the pose of each press.

    Parameters
    ----------
    images : ndarray of shape (n_touches, n_rows, n_cols)
    template : ndarray of shape (size, size)
    centres : ndarray of shape (n_touches, 2)
        First guess of (x, y).
    symmetry : int
        Turns in which the template looks the same; 0 for all, the angle is then 0.

    Returns
    -------
    poses : ndarray of shape (n_touches, 3)
    covariances : ndarray of shape (n_touches, 3, 3)
        As if the residuals of taxels were independent.
    errors : ndarray of shape (n_touches,)
        Sum of squared residuals.
    """
    start = _search(images, template, centres, symmetry)
    return refine(images, template, start, symmetry)


def refine(
    images: Floats, template: Floats, start: Floats, symmetry: int
) -> tuple[Floats, Floats, Floats]:
    """Improve poses by damped Gauss-Newton steps; returns as `register` does."""
    free = np.array([0, 1, 2] if symmetry else [1, 2])
    poses, damping = start.copy(), np.full(len(start), 1e-3)
    residual = _residuals(images, template, poses)
    error = (residual**2).sum(axis=1)
    for _ in range(_N_STEPS):
        normal, gradient = _normal_equations(images, template, poses, residual, free)
        damped = normal + _diagonal(damping[:, None] * _diagonal_of(normal) + 1e-12)
        step = np.linalg.solve(damped, -gradient[:, :, None])[:, :, 0]
        trial = poses.copy()
        trial[:, free] += step.clip(-_LONGEST_STEP, _LONGEST_STEP)
        new = _residuals(images, template, trial)
        new_error = (new**2).sum(axis=1)
        better = new_error < error
        poses[better], residual[better] = trial[better], new[better]
        error = np.where(better, new_error, error)
        damping = np.where(better, damping * 0.3, damping * 10).clip(1e-6, 1e6)
    normal, _ = _normal_equations(images, template, poses, residual, free)
    variance = error / max(images[0].size - 3 - len(free), 1)
    covariance = np.full((len(poses), 3, 3), np.inf)
    ridge = 1e-9 * _diagonal_of(normal).max(axis=1, keepdims=True) + 1e-12
    inverse = np.linalg.inv(normal + _diagonal(np.broadcast_to(ridge, (len(poses), len(free)))))
    covariance[np.ix_(range(len(poses)), free, free)] = variance[:, None, None] * inverse
    return poses, covariance, error


def render(template: Floats, poses: Floats, shape: tuple[int, int]) -> Floats:
    """Draw the template at each pose, (n_poses, n_rows, n_cols)."""
    x, y = _offsets(poses, shape)
    cos, sin = np.cos(poses[:, 0])[:, None, None], np.sin(poses[:, 0])[:, None, None]
    where = np.stack([cos * y - sin * x, cos * x + sin * y])
    where = OVERSAMPLING * where + (len(template) - 1) / 2
    return interpolate(template[np.newaxis], where, "zero", "cubic")


def fit_planes(images: Floats, drawn: Floats, poses: Floats) -> Floats:
    """Return the plane that multiplies each drawn template to fit its image."""
    x, y = _offsets(poses, images.shape[1:])
    weights = _solve_planes(images, drawn, x, y)[0][:, :, None, None]
    return weights[:, 0] + (weights[:, 1] * x + weights[:, 2] * y) / _PLANE_TAXELS


def _search(
    images: Floats, template: Floats, centres: Floats, symmetry: int
) -> Floats:
    """Best of angles a few degrees apart, at the first guess of the place."""
    n_angles = max(8, int(360 / _SEARCH_DEG / symmetry)) if symmetry else 1
    angles = np.arange(n_angles) * (2 * np.pi / max(symmetry, 1) / n_angles)
    poses = np.column_stack([np.zeros(len(centres)), centres])
    best = np.full(len(images), np.inf)
    for angle in angles:
        trial = np.column_stack([np.full(len(centres), angle), centres])
        error = (_residuals(images, template, trial) ** 2).sum(axis=1)
        better = error < best
        poses[better], best[better] = trial[better], error[better]
    return poses


def _normal_equations(
    images: Floats,
    template: Floats,
    poses: Floats,
    residual: Floats,
    free: NDArray[np.intp],
) -> tuple[Floats, Floats]:
    slopes = []
    for index in free:
        step = np.zeros(3)
        step[index] = _DIFFERENCE[index]
        ahead = _residuals(images, template, poses + step)
        behind = _residuals(images, template, poses - step)
        slopes.append((ahead - behind) / (2 * _DIFFERENCE[index]))
    jacobian = np.stack(slopes, axis=1)
    normal = jacobian @ jacobian.transpose(0, 2, 1)
    return normal, (jacobian @ residual[:, :, None])[:, :, 0]


def _residuals(images: Floats, template: Floats, poses: Floats) -> Floats:
    """Residuals of all taxels, then the penalties of the plane's two slopes."""
    shape = images.shape[1:]
    drawn = render(template, poses, shape)
    weights, size = _solve_planes(images, drawn, *_offsets(poses, shape))
    x, y = _offsets(poses, shape)
    w = weights[:, :, None, None]
    plane = w[:, 0] + (w[:, 1] * x + w[:, 2] * y) / _PLANE_TAXELS
    misfit = (images - plane * drawn).reshape(len(images), -1)
    penalty = np.sqrt(_PLANE_PRECISION * size)[:, None] * weights[:, 1:]
    return np.concatenate([misfit, penalty], axis=1)


def _solve_planes(
    images: Floats, drawn: Floats, x: Floats, y: Floats
) -> tuple[Floats, Floats]:
    """Plane of each image by penalised least squares, and the template's square."""
    n = len(images)
    parts = np.stack([drawn, drawn * x / _PLANE_TAXELS, drawn * y / _PLANE_TAXELS])
    parts = parts.reshape(3, n, -1).transpose(1, 0, 2)
    normal = parts @ parts.transpose(0, 2, 1)
    size = normal[:, 0, 0].copy()
    precision = np.array([0, _PLANE_PRECISION, _PLANE_PRECISION])
    normal += _diagonal(precision * size[:, None] + 1e-9)
    target = parts @ images.reshape(n, -1, 1)
    return np.linalg.solve(normal, target)[:, :, 0], size


def _offsets(poses: Floats, shape: tuple[int, ...]) -> tuple[Floats, Floats]:
    """x and y of the taxels from each pose's origin, (n, 1, cols) and (n, rows, 1)."""
    rows = np.arange(shape[0]) - (shape[0] - 1) / 2
    cols = np.arange(shape[1]) - (shape[1] - 1) / 2
    x = cols[None, None, :] - poses[:, 1, None, None]
    y = rows[None, :, None] - poses[:, 2, None, None]
    return x, y


def _diagonal(values: Floats) -> Floats:
    return values[:, :, None] * np.eye(values.shape[1])


def _diagonal_of(matrices: Floats) -> Floats:
    return np.einsum("nii->ni", matrices)
