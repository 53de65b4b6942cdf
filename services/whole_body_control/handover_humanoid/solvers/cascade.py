"""A cascade in null spaces: each level is an ordinary least squares in what the levels above leave free.

Only a level whose unbounded solution violates a bound becomes a quadratic program, in its reduced variables.
This is the reference in NumPy; `daqp` solves the small programs.
"""

from dataclasses import dataclass

import daqp
import numpy as np

from handover_humanoid.model.kinematics import Array
from handover_humanoid.solvers.problem import (
    SLACK_TOLERANCE,
    Problem,
    Solution,
    Unsolvable,
    require_finite,
    violations,
)

RANK_TOLERANCE = 1e-6
"""Singular values below are free directions; the regularisation damps those just above."""
FEASIBLE = 1e-8
EQUALITY = 1e-12
PRIMAL_TOLERANCE = 1e-9
SINGULAR_TOLERANCES = (1e-11, 1e-14)
"""With the first, its default, daqp may take rows for dependent that are not, and find no solution."""
SOFT, SOLVED = 8, 1
"""`sense` and exit flag of daqp."""


@dataclass(frozen=True, slots=True)
class _Bounds:
    """Rows `low <= matrix @ y <= high`."""

    matrix: Array
    low: Array
    high: Array

    def of_step(self, free: "_Free") -> "_Bounds":
        """Return the bounds of y for v = fixed + basis @ y.

        They contain the velocity of the levels above, which may violate a bound by a rounding error.
        """
        reached, offset = self.matrix @ free.velocity, self.matrix @ free.fixed
        low, high = np.minimum(self.low, reached) - FEASIBLE, np.maximum(self.high, reached) + FEASIBLE
        return _Bounds(self.matrix @ free.basis, low - offset, high - offset)

    def holds(self, step: Array) -> bool:
        reached = self.matrix @ step
        return bool((reached >= self.low - FEASIBLE).all() and (reached <= self.high + FEASIBLE).all())


class Cascade:
    """The cascade; see the module."""

    name = "null-space cascade"

    def solve(self, problem: Problem) -> Solution:
        """Return the velocities. Raises `Unsolvable`."""
        require_finite(problem)
        slack, allowed = needed_slack(problem)
        lower, upper = problem.lower - slack, problem.upper + slack
        # What is equal (contacts) takes its directions away; it would make every level a quadratic program.
        equal = upper - lower <= EQUALITY
        velocity, basis = _exact(problem.matrix[equal], lower[equal], problem.n)
        velocity = velocity + basis @ (basis.T @ allowed)
        bounds = _Bounds(problem.matrix[~equal], lower[~equal], upper[~equal])
        residuals: list[float] = []
        for jacobian, target in problem.levels:
            if basis.shape[1]:
                velocity = _level(jacobian, target, _Free(velocity, basis), bounds, problem.epsilon)
                basis = basis @ _null_space(jacobian @ basis)
            residuals.append(float(np.linalg.norm(jacobian @ velocity - target)))
        return Solution(velocity, tuple(residuals), slack)


@dataclass(frozen=True, slots=True)
class _Free:
    """The velocity of the levels above, and a basis of the directions that they leave free."""

    velocity: Array
    basis: Array

    @property
    def fixed(self) -> Array:
        """Return the part of the velocity outside of the free directions; the part within is chosen again."""
        return np.asarray(self.velocity - self.basis @ (self.basis.T @ self.velocity))


def _level(jacobian: Array, target: Array, free: _Free, bounds: _Bounds, epsilon: float) -> Array:
    """Return the velocity after this level."""
    basis, fixed = free.basis, free.fixed
    reduced = jacobian @ basis
    hessian = reduced.T @ reduced + epsilon * np.eye(basis.shape[1])
    gradient = -reduced.T @ (target - jacobian @ fixed)
    step: Array = np.asarray(np.linalg.solve(hessian, -gradient))
    of_step = bounds.of_step(free)
    if not of_step.holds(step):
        for singular in SINGULAR_TOLERANCES:
            step, _, flag, _ = daqp.solve(
                hessian,
                gradient,
                np.ascontiguousarray(of_step.matrix),
                of_step.high,
                of_step.low,
                primal_tol=PRIMAL_TOLERANCE,
                sing_tol=singular,
            )
            if flag == SOLVED:
                break
        if flag != SOLVED:
            # Nothing but a rounding error is left of the free directions: the levels above have used them up.
            return free.velocity
    return np.asarray(fixed + basis @ step)


def _exact(matrix: Array, values: Array, n: int) -> tuple[Array, Array]:
    """Return the smallest velocity with `matrix @ v = values`, and a basis of what stays free."""
    if not len(values):
        return np.zeros(n), np.eye(n)
    velocity = np.linalg.lstsq(matrix, values, rcond=RANK_TOLERANCE)[0]
    return np.asarray(velocity), _null_space(matrix)


def _null_space(matrix: Array) -> Array:
    """Return an orthonormal basis of the null space, one column for each free direction."""
    _, values, right = np.linalg.svd(matrix)
    rank = int((values > RANK_TOLERANCE).sum())
    return np.asarray(right[rank:].T)


def needed_slack(problem: Problem) -> tuple[Array, Array]:
    """Return by how much each bound must be relaxed so that all hold, and a velocity that obeys them then.

    The relaxation is the least squares of violations. Raises `Unsolvable`.
    """
    if ((problem.lower <= 0) & (problem.upper >= 0)).all():
        return np.zeros(len(problem.lower)), np.zeros(problem.n)
    sense = np.full(len(problem.lower), SOFT, dtype=np.int32)
    velocity, _, flag, _ = daqp.solve(
        problem.epsilon * np.eye(problem.n),
        np.zeros(problem.n),
        np.ascontiguousarray(problem.matrix),
        problem.upper,
        problem.lower,
        sense,
        rho_soft=1e-6 * problem.epsilon,
    )
    if flag <= 0:
        raise Unsolvable(f"the constraints could not be examined (daqp: {flag})")
    reached = problem.matrix @ velocity
    slack = violations(reached, problem.lower, problem.upper)
    return np.where(slack > SLACK_TOLERANCE, slack, 0.0), np.asarray(velocity)
