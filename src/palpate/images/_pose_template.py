"""Learning what a part looks like from presses alone, and registering presses on it.

A pose is (angle, x, y): radians from the column axis towards the row axis, and the
template's origin in taxels from the middle of the image, x along columns and y along
rows. Templates are square, `OVERSAMPLING` pixels per taxel, origin in the middle.

A press is modelled as its template times a plane, since a hand presses unevenly.
The plane is solved for in closed form, so only the pose is searched. Where the
presses' poses are unknown, template and poses are improved in turn; how many turns
look the same is settled on presses that the template has not seen.
"""

import numpy as np
from scipy.ndimage import distance_transform_edt

from .._types import Floats, Indices
from ._orientation import interpolate, repose

Pair = tuple[Floats, Floats]

OVERSAMPLING = 2  # pixels per taxel: linear interpolation blurs less
# Penalty on the plane's rise over `_PLANE_TAXELS`, so that tilt is not unlimited.
_PLANE_PRECISION, _PLANE_TAXELS = 0.3, 3.0
_SEARCH_DEG = 10.0
_FEWEST_STEPS, _MOST_STEPS, _SMALL_GAIN = 2, 8, 1e-4
_DIFFERENCE = np.array([0.02, 0.05, 0.05])  # for derivatives: radians, taxels
_LONGEST_STEP = 0.3
_LEAST_NOISE = 1e-4
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


def learn_template(images: Floats, centres: Floats, symmetry: int) -> Pair:
    """Return a template (size, size) and poses (n, 3), from rough centres (x, y)."""
    first = np.array([[0.0, *centres[0]]])
    template = symmetrise(_average(images[:1], first), symmetry)
    poses = first
    for _ in range(_N_ROUNDS):
        poses, _ = register(images, template, centres, symmetry)
        template = improve(images, poses, symmetry)
    return template, poses


def find_symmetry(images: Floats, centres: Floats) -> int:
    """Return in how many turns the part looks the same, 0 for all.

    The highest symmetry that, imposed on a template of half the presses, fits the other
    half about as well as the best one.
    """
    halves = [np.arange(len(images)) % 2 == k for k in (0, 1)]
    learnt = [learn_template(images[half], centres[half], 1) for half in halves]
    error = {}
    for symmetry in SYMMETRIES:
        turned = [symmetrise(template, symmetry) for template, _ in learnt]
        kept = [
            (mean**2).sum() / (template**2).sum()
            for mean, (template, _) in zip(turned, learnt, strict=True)
        ]
        if min(kept) < _LEAST_LIKENESS:
            continue
        error[symmetry] = 0.0
        for seen, template, (_, poses) in zip(halves, turned, learnt, strict=True):
            poses, _ = refine(images[seen], template, poses, symmetry)
            template = improve(images[seen], poses, symmetry)
            _, errors = register(images[~seen], template, centres[~seen], symmetry)
            error[symmetry] += float(errors.sum())
    # The highest symmetry whose error on unseen presses is tolerable.
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


def improve(images: Floats, poses: Floats, symmetry: int) -> Floats:
    """Return the template of presses at known poses: an average, sharpened twice."""
    template = symmetrise(_average(images, poses), symmetry)
    for _ in range(2):
        drawn = render(template, poses, images.shape[1:])
        plane = _plane(_solve_planes(images, drawn, poses)[0], poses, images.shape[1:])
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
    return np.asarray(repose(copies, angles, interpolation="cubic").mean(axis=0))


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
    return np.asarray((total / np.maximum(weight, 1e-9))[tuple(nearest)])


def _pull(images: Floats, poses: Floats) -> Floats:
    """Turn images back onto the template, 0 where a press did not reach."""
    n_rows, n_cols = images.shape[1:]
    half = OVERSAMPLING * max(n_rows, n_cols)
    v, u = np.mgrid[-half : half + 1, -half : half + 1] / OVERSAMPLING
    cos, sin = np.cos(poses[:, 0])[:, None, None], np.sin(poses[:, 0])[:, None, None]
    row = sin * u + cos * v + poses[:, 2, None, None] + (n_rows - 1) / 2
    col = cos * u - sin * v + poses[:, 1, None, None] + (n_cols - 1) / 2
    return interpolate(images, np.stack([row, col]), "zero", "linear")


def register(images: Floats, template: Floats, centres: Floats, symmetry: int) -> Pair:
    """Find poses (n, 3), from rough centres, and sums of squared residuals (n,)."""
    # The best of angles a few degrees apart, at the first guess of the place.
    n_angles = max(8, int(360 / _SEARCH_DEG / symmetry)) if symmetry else 1
    angles = np.arange(n_angles) * (2 * np.pi / max(symmetry, 1) / n_angles)
    poses = np.zeros((n_angles, len(images), 3))
    poses[:, :, 0], poses[:, :, 1:] = angles[:, None], centres
    residuals = _residuals_at(images, template, poses)
    best = (residuals**2).sum(axis=2).argmin(axis=0)
    return refine(images, template, poses[best, np.arange(len(images))], symmetry)


def refine(images: Floats, template: Floats, start: Floats, symmetry: int) -> Pair:
    """Improve poses by damped Gauss-Newton steps; returns as `register` does."""
    free = _free(symmetry)
    poses, damping = start.copy(), np.full((len(start), 1), 1e-3)
    residual = _residuals(images, template, poses)
    error = (residual**2).sum(axis=1)
    for done in range(1, _MOST_STEPS + 1):
        slopes = _slopes(images, template, poses, free)
        normal = slopes @ slopes.transpose(0, 2, 1)
        normal += _diagonal(damping * np.einsum("nii->ni", normal) + 1e-12)
        step = np.linalg.solve(normal, -slopes @ residual[:, :, None])[:, :, 0]
        trial = poses.copy()
        trial[:, free] += step.clip(-_LONGEST_STEP, _LONGEST_STEP)
        new = _residuals(images, template, trial)
        new_error = (new**2).sum(axis=1)
        better = new_error < error
        poses[better], residual[better] = trial[better], new[better]
        gain = (error - new_error)[better].sum()
        error = np.where(better, new_error, error)
        factor = np.where(better, 0.3, 10.0)[:, None]
        damping = (damping * factor).clip(1e-6, 1e6)
        if done >= _FEWEST_STEPS and gain < _SMALL_GAIN * error.sum():
            break
    return poses, error


def pose_variances(
    images: Floats, template: Floats, poses: Floats, symmetry: int
) -> Floats:
    """Return the variances of angle, x and y, (n_touches, 3), infinite for a disc.

    A covariance that is robust to errors that hang together in blocks of 2 x 2 taxels;
    a ten-thousandth of a press's energy counts as noise in any case.
    """
    free = _free(symmetry)
    slopes = _slopes(images, template, poses, free)
    normal = slopes @ slopes.transpose(0, 2, 1)
    ridge = 1e-9 * normal.max(axis=(1, 2))[:, None] + 1e-12
    inverse = np.linalg.inv(normal + _diagonal(np.repeat(ridge, len(free), axis=1)))
    scores = slopes * _residuals(images, template, poses)[:, np.newaxis]
    # Taxels are summed over blocks; what follows them is kept as it is.
    shape = images.shape[1:]
    n, k, _ = scores.shape
    n_taxels = shape[0] * shape[1]
    taxels = scores[:, :, :n_taxels].reshape(n, k, *shape)
    padded = np.pad(taxels, ((0, 0), (0, 0), (0, shape[0] % 2), (0, shape[1] % 2)))
    rows, cols = padded.shape[2] // 2, padded.shape[3] // 2
    blocks = padded.reshape(n, k, rows, 2, cols, 2).sum(axis=(3, 5))
    rest = scores[:, :, n_taxels:]
    clustered = np.concatenate([blocks.reshape(n, k, -1), rest], axis=2)
    spread = inverse @ clustered @ clustered.transpose(0, 2, 1) @ inverse
    variances = np.full((len(poses), 3), np.inf)
    least = _LEAST_NOISE * (images**2).sum(axis=(1, 2)) / images[0].size
    spread += inverse * least[:, np.newaxis, np.newaxis]
    variances[:, free] = np.einsum("nii->ni", spread)
    return variances


def render(template: Floats, poses: Floats, shape: tuple[int, ...]) -> Floats:
    """Draw the template at each pose, (n_poses, n_rows, n_cols)."""
    x, y = _offsets(poses, shape)
    cos, sin = np.cos(poses[:, 0])[:, None, None], np.sin(poses[:, 0])[:, None, None]
    where = np.stack([cos * y - sin * x, cos * x + sin * y])
    where = OVERSAMPLING * where + (len(template) - 1) / 2
    return interpolate(template[np.newaxis], where, "zero", "cubic")


def _free(symmetry: int) -> Indices:
    """Return which of angle, x and y can be estimated."""
    return np.array([0, 1, 2] if symmetry else [1, 2])


def _slopes(images: Floats, template: Floats, poses: Floats, free: Indices) -> Floats:
    """Derivatives of the residuals, (n_touches, n_free, n_residuals)."""
    steps = np.diag(_DIFFERENCE)[free]
    ahead_and_behind = poses + np.concatenate([steps, -steps])[:, np.newaxis]
    residuals = _residuals_at(images, template, ahead_and_behind)
    ahead, behind = residuals[: len(free)], residuals[len(free) :]
    slopes: Floats = (ahead - behind) / (2 * _DIFFERENCE[free])[:, None, None]
    return slopes.transpose(1, 0, 2)


def _residuals_at(images: Floats, template: Floats, poses: Floats) -> Floats:
    """Residuals of every image at several poses each, (n_poses, n_touches, ...)."""
    n_poses, n_touches, _ = poses.shape
    many = np.tile(images, (n_poses, 1, 1))
    residuals = _residuals(many, template, poses.reshape(-1, 3))
    return residuals.reshape(n_poses, n_touches, -1)


def _residuals(images: Floats, template: Floats, poses: Floats) -> Floats:
    """Residuals of all taxels, then the penalties of the plane's two slopes."""
    drawn = render(template, poses, images.shape[1:])
    weights, size = _solve_planes(images, drawn, poses)
    misfit = images - _plane(weights, poses, images.shape[1:]) * drawn
    penalty = np.sqrt(_PLANE_PRECISION * size)[:, None] * weights[:, 1:]
    return np.concatenate([misfit.reshape(len(images), -1), penalty], axis=1)


def _solve_planes(images: Floats, drawn: Floats, poses: Floats) -> Pair:
    """Plane of each image by penalised least squares, and the template's square."""
    x, y = _offsets(poses, images.shape[1:])
    parts = np.stack([drawn, drawn * x / _PLANE_TAXELS, drawn * y / _PLANE_TAXELS])
    parts = parts.reshape(3, len(images), -1).transpose(1, 0, 2)
    normal = parts @ parts.transpose(0, 2, 1)
    size = normal[:, 0, 0].copy()
    precision = np.array([0, _PLANE_PRECISION, _PLANE_PRECISION])
    normal += _diagonal(precision * size[:, None] + 1e-9)
    target = parts @ images.reshape(len(images), -1, 1)
    return np.linalg.solve(normal, target)[:, :, 0], size


def _plane(weights: Floats, poses: Floats, shape: tuple[int, ...]) -> Floats:
    x, y = _offsets(poses, shape)
    level, along_x, along_y = weights.T[:, :, None, None]
    return np.asarray(level + (along_x * x + along_y * y) / _PLANE_TAXELS)


def _offsets(poses: Floats, shape: tuple[int, ...]) -> Pair:
    """X and y of the taxels from each pose's origin, (n, 1, cols) and (n, rows, 1)."""
    rows = np.arange(shape[0]) - (shape[0] - 1) / 2
    cols = np.arange(shape[1]) - (shape[1] - 1) / 2
    x = cols[None, None, :] - poses[:, 1, None, None]
    y = rows[None, :, None] - poses[:, 2, None, None]
    return x, y


def _diagonal(values: Floats) -> Floats:
    return values[:, :, None] * np.eye(values.shape[1])
