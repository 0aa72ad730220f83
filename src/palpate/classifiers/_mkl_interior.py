"""Multiple kernel learning by a primal-dual interior point, many problems at once.

Newton's method with a predictor and a corrector follows the central path of the
optimality conditions. The problems of one batch advance together, each by its own
step; those that are done leave the batch.
"""

import numpy as np
from numpy.typing import NDArray

from ._mkl_gap import Best
from ._mkl_problem import Floats, KernelSystem, Point, Solution, Task, View

# A step goes this share of the way to the boundary.
_SHARE_OF_WAY = 0.99
# Products at the start, relative to the objective there per touch, and how much
# larger those of margin errors may be: measured to need the fewest iterations.
# Where touches outnumber dimensions many margins cannot be met, and errors start as
# large as they are.
_START, _CROWDED_START = (0.1, 30.0), (0.03, np.inf)


def solve_interior(
    system: KernelSystem,
    C: float,
    *,
    norm: float = 1.0,
    tol: float = 1e-6,
    max_iter: int = 100,
) -> Solution:
    """Solve multiple kernel learning for a batch of two-class problems.

    Parameters
    ----------
    system : KernelSystem
        Kernels and labels (+1, -1, or 0 for padding); both labels must occur in
        each problem.
    C : float
        Price of a margin error.
    norm : float, default=1
        The p >= 1 of the constraint |d|_p <= 1; 1 selects few kernels.
    tol : float, default=1e-6
        Relative duality gap at which a problem is done.
    max_iter : int, default=100

    Returns
    -------
    Solution
        The best machine met of each problem, even where the gap stayed above
        `tol`.

    References
    ----------
    .. [1] F. R. Bach, G. R. G. Lanckriet and M. I. Jordan, "Multiple kernel
       learning, conic duality, and the SMO algorithm", ICML, 2004.
       doi:10.1145/1015330.1015424
    .. [2] M. Kloft et al., "lp-norm multiple kernel learning", J. Mach. Learn.
       Res. 12, 2011.
    .. [3] S. Mehrotra, "On the implementation of a primal-dual interior point
       method", SIAM J. Optim. 2(4), 1992. doi:10.1137/0802028
    """
    whole = task = Task(system, C, norm)
    # Where rounding ends the path some quotients are 0 / 0; such steps are not
    # taken, and the best machine before them counts.
    with np.errstate(all="ignore"):
        point = _start(task)
        best = Best(point, tol)
        for remaining in range(max_iter, -1, -1):
            view = task.view(point)
            going = best.improve(task, point, view, last=not remaining)
            if not (remaining and going.any()):
                break
            if 2 * going.sum() <= len(going):
                best.keep(going)
                task, point, view = (
                    task.take(going),
                    point.take(going),
                    view.take(going),
                )
                going = going[going]
            point = _advanced(task, point, view, going)
        best.n_iter = np.minimum(best.n_iter, max_iter)
        return best.solution(whole)


def _start(task: Task) -> Point:
    """Equal weights; multipliers in balance, as large as pays along their ray."""
    labels, system = task.labels, task.system
    (n_problems, n), n_kernels = labels.shape, system.n_kernels
    shares = np.full((n_problems, n_kernels), 1 / n_kernels)
    ray = _ray(labels)
    pulls = system.pulls(ray)
    free = np.concatenate([np.zeros((n_problems, 2)), pulls], axis=1)
    left = np.concatenate([ray, task.C - ray, shares], axis=1)
    point = Point(left, np.zeros_like(left), free, n)
    view, slope = task.view(point), task.slopes(point)[0]
    total = ray.sum(axis=1, keepdims=True)
    energy = np.maximum(2 * view.energies.max(axis=1, keepdims=True), 1e-300)
    length = np.minimum(total / energy, task.C)
    # All that was seen along the ray grows with its length.
    free[:, 2:] *= length
    left[:, :n] = np.where(task.real > 0, length * ray, task.C / 2)
    left[:, n : 2 * n] = task.C - left[:, :n]
    missing = task.real - length * (task.real - view.missing)
    pull = slope * length**2 * view.energies
    least = 1e-3 * length * total
    free[:, 1:2] = 1.5 * np.maximum(pull.max(axis=1, keepdims=True), least)
    centre, most = _CROWDED_START if system.crowded else _START
    floor = centre * length * total / n / left
    right = np.concatenate([-missing, missing, point.level - pull], axis=1)
    point.right[...] = np.maximum(right, floor)
    np.minimum(point.errors, most * floor[:, n : 2 * n], out=point.errors)
    return point


def _ray(labels: Floats) -> Floats:
    """Multipliers in balance, at most 1/2, equal within each label."""
    plus, minus = labels > 0, labels < 0
    n_plus = plus.sum(axis=1, keepdims=True)
    n_minus = minus.sum(axis=1, keepdims=True)
    half = 0.5 * np.minimum(n_plus, n_minus)
    return np.where(plus, half / n_plus, np.where(minus, half / n_minus, 0))


def _advanced(task: Task, point: Point, view: View, going: NDArray) -> Point:
    """Return the next point: predictor, then corrector, for problems in `going`."""
    newton = task.system.newton(task, point, view)
    products = point.left * point.right
    mean = products.mean(axis=1, keepdims=True)
    ahead = newton.direction(-products)
    reach = np.minimum(1, _reach(point, ahead))
    bent = ahead.left * ahead.right
    left = (1 - reach) * mean + reach**2 * bent.mean(axis=1, keepdims=True)
    centre = mean * np.clip(left / mean, 0, 1) ** 3
    move = newton.direction(centre - products - bent)
    step = np.minimum(1, _SHARE_OF_WAY * _reach(point, move))
    moved = point.moved(step, move)
    # What is not finite shows in the step, or in the bias and the level.
    usable = going & np.isfinite(step[:, 0] + moved.free.sum(axis=1))
    if not usable.all():
        moved.overwrite(~usable, point.take(~usable))
    return moved


def _reach(point: Point, move: Point) -> Floats:
    """Return the longest step that keeps everything positive, (n_problems, 1)."""
    left = (move.left / point.left).min(axis=1)
    right = (move.right / point.right).min(axis=1)
    return (1 / np.maximum(-np.minimum(left, right), 1e-12))[:, None]
