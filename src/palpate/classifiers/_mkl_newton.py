"""Newton's step of the interior point for kernel matrices: one system per problem.

The unknowns besides the multipliers a are eliminated by hand: bounds are diagonal,
shares and their level leave a matrix of rank below the number of kernels.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ._mkl_problem import Floats, Point, Task, View, weighted

Solver = Callable[[Floats], Floats]


@dataclass
class Pull:
    """The low-rank part of Newton's matrix: what moving the shares does.

    It is F' (W - W 1 1' W / 1'W1) F with W = diag(`gain`) of shape (n_problems,
    n_kernels) and F the `forces`.
    """

    forces: Floats
    gain: Floats

    def root(self) -> Floats:
        """Return R' F, with R R' the matrix in brackets."""
        root = np.sqrt(self.gain)
        unit = root / np.sqrt(self.gain.sum(axis=1, keepdims=True))
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
        self._point, self._labels = point, task.labels
        n = point.n_touches
        self._ratio = point.right / point.left
        self._forces, pulls = view.pull, view.energies
        stiffness = self._ratio[:, 2 * n :]
        if task.norm > 1:
            slope, bend = task.slopes(point)
            self._forces, pulls = slope[:, :, None] * view.pull, slope * view.energies
            stiffness = stiffness - bend * view.energies
        self._gain = 1 / stiffness
        self._total = self._gain.sum(axis=1, keepdims=True)
        self._lean = weighted(self._gain / self._total, self._forces)
        # What the optimality conditions lack, besides the products.
        self._missing = view.missing - point.errors + point.right[:, :n]
        self._imbalance = (self._labels * point.alpha).sum(axis=1, keepdims=True)
        self._excess = point.level - pulls - point.slack
        self._surplus = point.shares.sum(axis=1, keepdims=True) - 1
        diagonal = self._ratio[:, :n] + self._ratio[:, n : 2 * n]
        pull = Pull(self._forces, self._gain)
        self._solve = factorise(diagonal, task.weights(point), pull)
        self._towards_bias: Floats | None = None

    def direction(self, target: Floats) -> Point:
        """Return the step that changes the products of left and right by `target`."""
        forces, n = self._forces, self._point.n_touches
        wanted = target / self._point.left
        push = wanted[:, 2 * n :] - self._excess
        ahead = (self._gain * push).sum(axis=1, keepdims=True) + self._surplus
        right = self._missing + wanted[:, :n] - wanted[:, n : 2 * n]
        right += self._lean * ahead - weighted(self._gain * push, forces)
        alpha, bias = self._balanced(right)
        push += (forces @ alpha[:, :, None])[:, :, 0]
        level = (self._gain * push).sum(axis=1, keepdims=True) + self._surplus
        level /= self._total
        left = np.concatenate([alpha, -alpha, self._gain * (push - level)], axis=1)
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
