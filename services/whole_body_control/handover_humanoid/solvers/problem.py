"""The problem that all solvers share: levels of least squares, each in what those above leave free.

For level i, with v restricted to solutions of the levels above (CoSiMA, equation 2):

    minimise  |J_i v - b_i|^2 + epsilon |v|^2   subject to  lower <= A v <= upper
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from handover_humanoid.model.kinematics import Array

EPSILON = 1e-6
"""Regularisation: what a singular direction costs against the errors of a level."""


@dataclass(frozen=True, slots=True)
class Problem:
    """`levels` has (J, b) of each level with weights applied; A is (m, n).

    `stacked` has the same rows and targets one below the other, where the caller has them so in memory.
    """

    levels: Sequence[tuple[Array, Array]]
    matrix: Array
    lower: Array
    upper: Array
    epsilon: float = EPSILON
    stacked: tuple[Array, Array] | None = None

    @property
    def n(self) -> int:
        """Return the number of velocities."""
        return int(self.matrix.shape[1])


@dataclass(frozen=True, slots=True)
class Solution:
    """`velocity` (n,), the norm of the residual of each level, and by how much bounds were relaxed (m,)."""

    velocity: Array
    residuals: tuple[float, ...]
    slack: Array

    @property
    def is_relaxed(self) -> bool:
        """Return whether the bounds had no solution and were relaxed by the least squares of violations."""
        return bool((self.slack > SLACK_TOLERANCE).any())


SLACK_TOLERANCE = 1e-7


class Solver(Protocol):
    """Solves a problem; the same answer for the same problem, whichever solver it is."""

    @property
    def name(self) -> str:
        """The name for figures and pages."""
        ...

    def solve(self, problem: Problem) -> Solution:
        """Return the velocities. Raises `Unsolvable` for values that are not finite."""
        ...


class Unsolvable(ValueError):
    """The problem has no meaning: values that are not finite, or shapes that do not fit."""


def require_shapes(problem: Problem) -> tuple[int, int, tuple[int, ...]]:
    """Return the number of velocities, of bounds, and of rows of each level.

    Raises `Unsolvable` where they do not fit.
    """
    m, n = problem.matrix.shape
    counts = tuple([len(target) for _, target in problem.levels])
    for index, (jacobian, _) in enumerate(problem.levels):
        if jacobian.shape != (counts[index], n):
            raise Unsolvable(f"level {index} has a Jacobian of {jacobian.shape} for {counts[index]} targets")
    return n, m, counts


def require_finite(problem: Problem) -> None:
    """Raise `Unsolvable` for NaN or infinity in a task or a constraint, and name the level."""
    require_shapes(problem)
    for index, (jacobian, target) in enumerate(problem.levels):
        if not (np.isfinite(jacobian).all() and np.isfinite(target).all()):
            raise Unsolvable(f"level {index} has values that are not finite")
    if not (np.isfinite(problem.matrix).all() and np.isfinite(problem.lower).all()):
        raise Unsolvable("a constraint has values that are not finite")
    if not np.isfinite(problem.upper).all() or (problem.lower > problem.upper).any():
        raise Unsolvable("a constraint has an upper bound below its lower one, or one that is not finite")


def violations(reached: Array, lower: Array, upper: Array) -> Array:
    """Return by how much each bound is violated by `reached`, the slack that it needs."""
    return np.maximum(np.maximum(lower - reached, reached - upper), 0.0)
