"""Newton's step of the interior point for kernel matrices: one system per problem.

The unknowns besides the multipliers a are eliminated by hand: bounds are diagonal,
weights and their level leave a matrix of rank below the number of kernels.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ._mkl_problem import Floats, Point, Task, View, weighted

Solver = Callable[[Floats], Floats]


@dataclass
class Pull:
    """The low-rank part of Newton's matrix: what moving the weights does.

    It is F' (W - W h h' W / h'Wh) F with W = diag(`gain`) and h = `slope`, of
    shape (n_problems, n_kernels), and F the `forces`.
    """

    forces: Floats
    gain: Floats
    slope: Floats

    def root(self) -> Floats:
        """Return R' F, with R R' the matrix in brackets."""
        root = np.sqrt(self.gain)
        unit = root * self.slope
        unit /= np.sqrt((unit * unit).sum(axis=1, keepdims=True))
        scaled = root[:, :, None] * self.forces
        scaled -= unit[:, :, None] * (unit[:, None, :] @ scaled)
        return scaled


class DualNewton:
    """The optimality conditions at one point, linearised and factorised once.

    Parameters
    ----------
    task, point, view
        The problems, where they are, and what they see there.
    factorise : callable
        (diagonal, weights, pull) -> solver of the matrix diagonal + sum_k d_k Y K_k Y
        + pull for right-hand sides of shape (n_problems, n_touches, n_columns).
    """

    def __init__(
        self,
        task: Task,
        point: Point,
        view: View,
        factorise: Callable[[Floats, Floats, Pull], Solver],
    ) -> None:
        self._point, self._view, self._labels = point, view, task.labels
        self._norm = task.norm
        n = point.n_touches
        self._ratio = point.right / point.left
        diagonal = self._ratio[:, :n] + self._ratio[:, n : 2 * n]
        self._set_gain()
        self._set_residuals()
        pull = Pull(view.pull, self._gain, self._slope)
        self._solve = factorise(diagonal, point.weights, pull)
        self._towards_bias: Floats | None = None

    def _set_gain(self) -> None:
        """How much each weight yields to its energy, and all of them together."""
        point, norm = self._point, self._norm
        self._slope = np.ones_like(point.weights)
        stiffness = self._ratio[:, 2 * point.n_touches :]
        if norm > 1:
            self._slope = point.weights ** (norm - 1)
            curvature = (norm - 1) * point.weights ** (norm - 2)
            stiffness = stiffness + point.level * curvature
        self._gain = 1 / stiffness
        self._slope_gain = self._gain * self._slope
        self._total = (self._slope * self._slope_gain).sum(axis=1, keepdims=True)
        self._lean = weighted(self._slope_gain / self._total, self._view.pull)

    def _set_residuals(self) -> None:
        """What the optimality conditions lack, besides the products."""
        point, view, n = self._point, self._view, self._point.n_touches
        self._missing = view.missing - point.errors + point.right[:, :n]
        self._imbalance = (self._labels * point.alpha).sum(axis=1, keepdims=True)
        self._excess = point.level * self._slope - view.energies - point.slack
        length = (point.weights * self._slope).sum(axis=1, keepdims=True)
        self._length = (length - 1) / self._norm

    def direction(self, target: Floats) -> Point:
        """Return the step that changes the products of left and right by `target`."""
        point, forces, n = self._point, self._view.pull, self._point.n_touches
        wanted = target / point.left
        push = wanted[:, 2 * n :] - self._excess
        ahead = (self._slope_gain * push).sum(axis=1, keepdims=True) + self._length
        right = self._missing + wanted[:, :n] - wanted[:, n : 2 * n]
        right += self._lean * ahead - weighted(self._gain * push, forces)
        alpha, bias = self._balanced(right)
        push += (forces @ alpha[:, :, None])[:, :, 0]
        level = (self._slope_gain * push).sum(axis=1, keepdims=True) + self._length
        level /= self._total
        weights = self._gain * (push - self._slope * level)
        left = np.concatenate([alpha, -alpha, weights], axis=1)
        free = np.concatenate([bias, level], axis=1)
        return Point(left, wanted - self._ratio * left, free, n)

    def _balanced(self, right: Floats) -> tuple[Floats, Floats]:
        """Solve for the multipliers and the bias that keeps them in balance."""
        labels = self._labels
        if self._towards_bias is None:
            both = self._solve(np.stack([right, labels], axis=2))
            alpha, self._towards_bias = both[:, :, 0], both[:, :, 1]
            self._stiff = (labels * self._towards_bias).sum(axis=1, keepdims=True)
        else:
            alpha = self._solve(right[:, :, None])[:, :, 0]
        pull = (labels * alpha).sum(axis=1, keepdims=True) + self._imbalance
        bias = pull / self._stiff
        return alpha - bias * self._towards_bias, bias
