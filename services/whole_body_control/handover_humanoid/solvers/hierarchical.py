"""The hierarchy as one call of daqp: its breakpoints separate the levels, and bounds are the first level.

daqp scales every row to length 1, so a level that cannot be reached is solved in another metric. Its rows
are turned before, by rotations that keep the least squares, until they have the same length.
"""

from itertools import pairwise

import daqp
import numpy as np

from handover.runtime.control_cycle import runs_in_cycle
from handover_humanoid.model.kinematics import Array
from handover_humanoid.solvers.problem import (
    Problem,
    Solution,
    Unsolvable,
    require_finite,
    require_shapes,
    violations,
)

SOLVED = (1, 2)
"""Exit flags of daqp: solved, and solved with violated rows in some level."""
FACTORS = (1.0, 10.0, 100.0)
REACHED = 5e-4
"""A level with a larger residual has a target beyond reach. daqp leaves up to this where one is reached."""
SAME_LENGTH = 1e-9


class _HierarchyArrays:
    """The arrays of one shape of problem: bounds first, then the rows of the levels, in one matrix."""

    def __init__(self, n: int, m: int, counts: tuple[int, ...]) -> None:
        ends = np.cumsum([m, *counts])
        self.break_points = np.array([0, *ends], dtype=np.int32)
        self.starts = ends[:-1] - m
        self.spans = [slice(*ends_of_level) for ends_of_level in pairwise(ends)]
        self.bounds, self.levels = slice(0, m), slice(m, int(ends[-1]))
        self.rows = np.zeros((int(ends[-1]), n))
        self.lower, self.upper = np.zeros(len(self.rows)), np.zeros(len(self.rows))
        self.sense = np.zeros(len(self.rows), dtype=np.int32)
        self.identity, self.no_gradient = np.eye(n), np.zeros(n)

    def fill(self, problem: Problem) -> None:
        """Copy a problem. Raises `Unsolvable` for values that are not finite."""
        rows, lower, upper = self.rows, self.lower, self.upper
        rows[self.bounds], lower[self.bounds], upper[self.bounds] = (
            problem.matrix,
            problem.lower,
            problem.upper,
        )
        for span, (jacobian, target) in zip(self.spans, problem.levels, strict=True):
            rows[span], lower[span] = jacobian, target
        upper[self.levels] = lower[self.levels]
        is_finite = np.isfinite(rows).all() and np.isfinite(lower).all() and np.isfinite(upper).all()
        if not is_finite or (lower > upper).any():
            require_finite(problem)

    def turn(self, residuals: tuple[float, ...]) -> bool:
        """Give the rows of levels that are not reached the same length; return whether any changed."""
        has_turned = False
        for span, residual in zip(self.spans, residuals, strict=True):
            if residual > REACHED and not _have_same_length(self.rows[span]):
                self.rows[span], self.lower[span] = _with_equal_rows(self.rows[span], self.lower[span])
                self.upper[span] = self.lower[span]
                has_turned = True
        return has_turned

    def solve(self, epsilon: float) -> Solution:
        """Return the solution. Raises `Unsolvable`."""
        # Rows that depend on each other may make it give up; a larger regularisation separates them.
        for factor in FACTORS:
            velocity, _, flag, _ = daqp.solve(
                factor * epsilon * self.identity,
                self.no_gradient,
                self.rows,
                self.upper,
                self.lower,
                self.sense,
                break_points=self.break_points,
            )
            if flag in SOLVED:
                break
        else:
            raise Unsolvable(f"the hierarchy could not be solved (daqp: {flag})")
        reached = self.rows @ velocity
        slack = violations(reached[self.bounds], self.lower[self.bounds], self.upper[self.bounds])
        squares = reached[self.levels] - self.lower[self.levels]
        squares *= squares
        if not len(self.spans):
            return Solution(np.asarray(velocity), (), slack)
        sums = np.add.reduceat(squares, self.starts) if len(squares) else np.zeros(len(self.spans))
        return Solution(np.asarray(velocity), tuple(np.sqrt(sums).tolist()), slack)


class Hierarchical:
    """daqp in its hierarchical mode: no compiled code of ours is needed. Not thread-safe."""

    name = "daqp, hierarchical"

    def __init__(self) -> None:
        self._memory: dict[tuple[int, int, tuple[int, ...]], _HierarchyArrays] = {}

    @runs_in_cycle
    def solve(self, problem: Problem) -> Solution:
        """Return the velocities. Raises `Unsolvable`."""
        shape = require_shapes(problem)
        memory = self._memory.get(shape)
        if memory is None:
            memory = self._memory[shape] = _HierarchyArrays(*shape)
        memory.fill(problem)
        solution = memory.solve(problem.epsilon)
        return memory.solve(problem.epsilon) if memory.turn(solution.residuals) else solution


def _have_same_length(jacobian: Array) -> bool:
    squares = np.einsum("ij,ij->i", jacobian, jacobian)
    longest = squares.max()
    return bool(longest - squares.min() <= SAME_LENGTH * max(longest, 1.0))


def _with_equal_rows(jacobian: Array, target: Array) -> tuple[Array, Array]:
    """Return rows of the same length with the same least squares (Bendel and Mickey 1978).

    Each rotation of the longest and the shortest row gives one of them the mean length.
    """
    rows = np.column_stack([jacobian, target])
    for _ in range(len(rows) - 1):
        squares = np.einsum("ij,ij->i", rows[:, :-1], rows[:, :-1])
        mean = squares.mean()
        short, long = int(squares.argmin()), int(squares.argmax())
        if squares[long] - squares[short] <= SAME_LENGTH * mean:
            break
        product = float(rows[short, :-1] @ rows[long, :-1])
        missing, excess = squares[short] - mean, squares[long] - mean
        tangent = (product + np.sqrt(max(product**2 - missing * excess, 0.0))) / excess
        cosine = 1.0 / np.hypot(1.0, tangent)
        sine = tangent * cosine
        rows[[short, long]] = [
            cosine * rows[short] - sine * rows[long],
            sine * rows[short] + cosine * rows[long],
        ]
    return rows[:, :-1], rows[:, -1]
