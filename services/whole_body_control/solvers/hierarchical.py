"""The hierarchy as one call of daqp: its breakpoints separate the levels, and bounds are the first level.

daqp scales every row to length 1, so a level that cannot be reached is solved in another metric. Its rows
are turned before, by rotations that keep the least squares, until they have the same length.
"""

import daqp
import numpy as np

from services.whole_body_control.model.kinematics import Array
from services.whole_body_control.solvers.problem import Problem, Solution, Unsolvable, require_finite

SOLVED = (1, 2)
"""Exit flags of daqp: solved, and solved with violated rows in some level."""
FACTORS = (1.0, 10.0, 100.0)
REACHED = 1e-6
SAME_LENGTH = 1e-9


class Hierarchical:
    """daqp in its hierarchical mode: no compiled code of ours is needed."""

    name = "daqp, hierarchical"

    def solve(self, problem: Problem) -> Solution:
        """Return the velocities. Raises `Unsolvable`."""
        require_finite(problem)
        levels = list(problem.levels)
        solution = _solved(problem, levels)
        missed = [index for index, residual in enumerate(solution.residuals) if residual > REACHED]
        turned = False
        for index in missed:
            if not _have_same_length(levels[index][0]):
                levels[index] = _with_equal_rows(*levels[index])
                turned = True
        return _solved(problem, levels) if turned else solution


def _solved(problem: Problem, levels: list[tuple[Array, Array]]) -> Solution:
    rows = np.ascontiguousarray(np.vstack([problem.matrix, *(jacobian for jacobian, _ in levels)]))
    targets = [target for _, target in levels]
    ends = np.cumsum([0, len(problem.lower), *map(len, targets)]).astype(np.int32)
    # Rows that depend on each other may make it give up; a larger regularisation separates them.
    for factor in FACTORS:
        velocity, _, flag, _ = daqp.solve(
            factor * problem.epsilon * np.eye(problem.n),
            np.zeros(problem.n),
            rows,
            np.concatenate([problem.upper, *targets]),
            np.concatenate([problem.lower, *targets]),
            np.zeros(len(rows), dtype=np.int32),
            break_points=ends,
        )
        if flag in SOLVED:
            break
    else:
        raise Unsolvable(f"the hierarchy could not be solved (daqp: {flag})")
    reached = problem.matrix @ velocity
    slack = np.maximum(np.maximum(problem.lower - reached, reached - problem.upper), 0.0)
    residuals = tuple(float(np.linalg.norm(j @ velocity - t)) for j, t in problem.levels)
    return Solution(np.asarray(velocity), residuals, slack)


def _have_same_length(jacobian: Array) -> bool:
    squares = np.einsum("ij,ij->i", jacobian, jacobian)
    return bool(np.ptp(squares) <= SAME_LENGTH * squares.max(initial=1.0))


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
