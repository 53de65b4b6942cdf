"""All levels in one quadratic program, in which each level weighs more than those below it."""

import daqp
import numpy as np

from handover_humanoid.solvers.problem import Problem, Solution, Unsolvable, require_finite

SOLVED = 1


class Weighted:
    """One quadratic program; each level weighs `ratio` times the one below it."""

    name = "weighted"

    def __init__(self, ratio: float = 100.0) -> None:
        self._ratio = ratio

    def solve(self, problem: Problem) -> Solution:
        """Return the velocities. Raises `Unsolvable`; bounds are not relaxed."""
        require_finite(problem)
        hessian, gradient = problem.epsilon * np.eye(problem.n), np.zeros(problem.n)
        for depth, (jacobian, target) in enumerate(reversed(problem.levels)):
            weight = self._ratio**depth
            hessian += weight * jacobian.T @ jacobian
            gradient -= weight * jacobian.T @ target
        velocity, _, flag, _ = daqp.solve(
            hessian, gradient, np.ascontiguousarray(problem.matrix), problem.upper, problem.lower
        )
        if flag != SOLVED:
            raise Unsolvable(f"the bounds cannot all hold (daqp: {flag}); a hierarchical solver relaxes them")
        residuals = tuple(float(np.linalg.norm(j @ velocity - t)) for j, t in problem.levels)
        return Solution(np.asarray(velocity), residuals, np.zeros(len(problem.lower)))
