"""The motion engine by operational-space projections, the alternative of CoSiMA to the stack of tasks as QPs.

After Khatib 1987 and Sentis 2007, with the velocities of one control period instead of accelerations:

1. Constraints that are equalities (contacts) come first, so that every level below is consistent with the
   ground under the floating base.
2. Each level is solved in the null space N of those above, by the dynamically consistent inverse
   Jbar = M^-1 J_N^T (J_N M^-1 J_N^T)^+ with J_N = J N; then N becomes N - Jbar J_N. M is the mass matrix with
   the inertia of the drives, so a level accelerates what is above it least.
3. Bounds are no part of projections. A bound that the result violates becomes an equality above the levels,
   the most violated first, and the levels are solved again, at most `MAX_ROUNDS` times.

The feed-forward of torques (`FeedForward`) turns the motion into computed torques. In contrast to the QPs a
bound that was added stays for the period, so that the motion is not always the nearest one to the tasks.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from handover.runtime.control_cycle import runs_in_cycle
from handover_humanoid.engines.stack_engine import DAMPING, Step
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.tasks.base import NO_BOUND, Stack

MAX_ROUNDS: Final = 24
TOLERANCE: Final = 1e-6
SINGULAR: Final = 1e-8
"""Directions whose mobility is below this share of the largest one are left to the levels below."""


class ProjectionEngine:
    """Solves a stack by projections and integrates the velocities. Not thread-safe."""

    def __init__(self, kinematics: Kinematics, stack: Stack, damping: float = DAMPING) -> None:
        self._kinematics, self.stack, self._damping = kinematics, stack, damping
        self._names = [level.name for level in stack.levels]

    @runs_in_cycle
    def step(self, q: Array, dt_s: float) -> Step:
        """Return the next configuration after `dt_s`."""
        kinematics = self._kinematics
        still = np.zeros(kinematics.n_velocities)
        kinematics.update(q)
        levels = []
        for level in self.stack.levels:
            rows = [(task.rows(kinematics), task.weight**0.5) for task in level.tasks]
            levels.append(
                (
                    np.vstack([weight * row.jacobian for row, weight in rows]),
                    np.concatenate([weight * row.velocity for row, weight in rows]),
                )
            )
        bounds = [limit.bounds(kinematics, q, dt_s) for limit in self.stack.constraints]
        matrix = np.vstack([np.zeros((0, len(still))), *(bound.matrix for bound in bounds)])
        lower = np.concatenate([np.zeros(0), *(bound.lower for bound in bounds)])
        upper = np.concatenate([np.zeros(0), *(bound.upper for bound in bounds)])
        parts = [
            *(stacked for level in levels for stacked in level),
            matrix,
            np.clip(lower, -NO_BOUND, NO_BOUND),
        ]
        if not all(np.isfinite(part).all() for part in (*parts, np.clip(upper, -NO_BOUND, NO_BOUND))):
            return Step(q, still, {}, fault="a task or a constraint has values that are not finite")
        mobility: Array = np.asarray(np.linalg.inv(kinematics.mass_matrix()), dtype=np.float64)
        velocity = self._bounded(levels, mobility, (matrix, lower, upper))
        residuals = {
            name: float(np.linalg.norm(jacobian @ velocity - wanted))
            for name, (jacobian, wanted) in zip(self._names, levels, strict=True)
        }
        reached, relaxed, start = matrix @ velocity, [], 0
        for constraint, rows_of in zip(self.stack.constraints, bounds, strict=True):
            part = slice(start, start + len(rows_of.lower))
            most = float(_violations(reached[part], lower[part], upper[part]).max(initial=0.0))
            if most > 100 * TOLERANCE:
                relaxed.append(f"{constraint.name} by {most:.3g}")
            start = part.stop
        return Step(kinematics.integrate(q, velocity, dt_s), velocity, residuals, tuple(relaxed))

    def _bounded(
        self,
        levels: Sequence[tuple[Array, Array]],
        mobility: Array,
        bounds: tuple[Array, Array, Array],
    ) -> Array:
        matrix, lower, upper = bounds
        is_equal = upper - lower < TOLERANCE
        active = is_equal.copy()
        target = np.where(is_equal, lower, 0.0)
        velocity = np.zeros(matrix.shape[1])
        for _ in range(MAX_ROUNDS):
            fixed = (matrix[active], target[active])
            velocity = self._projected([fixed, *levels] if active.any() else levels, mobility)
            reached = matrix @ velocity
            excess = np.where(active, 0.0, _violations(reached, lower, upper))
            worst = int(excess.argmax()) if len(excess) else 0
            if not len(excess) or excess[worst] <= TOLERANCE:
                break
            active[worst] = True
            target[worst] = lower[worst] if reached[worst] < lower[worst] else upper[worst]
        return velocity

    def _projected(self, levels: Sequence[tuple[Array, Array]], mobility: Array) -> Array:
        """Return the velocity of all levels; after each one `free` @ mobility is symmetric."""
        n = len(mobility)
        velocity, free = np.zeros(n), np.eye(n)
        for jacobian, wanted in levels:
            projected = jacobian @ free
            spread = projected @ mobility
            values, vectors = np.linalg.eigh(spread @ projected.T)
            largest = float(values[-1]) if len(values) else 0.0
            if largest < 1e-12:
                continue
            seen = values > SINGULAR * largest
            values, vectors = values[seen], vectors[:, seen]
            onto = spread.T @ vectors
            damped = values / (values**2 + (self._damping**2 * largest) ** 2)
            velocity = velocity + onto @ (damped * (vectors.T @ (wanted - jacobian @ velocity)))
            free = free - (onto / values) @ (vectors.T @ projected)
        return velocity


def _violations(reached: Array, lower: Array, upper: Array) -> Array:
    return np.maximum(np.maximum(lower - reached, reached - upper), 0.0)
