"""The motion engine by a stack of tasks: one problem a cycle, its velocities integrated to joint positions.

A problem without meaning (NaN from a sensor) or with relaxed bounds does not stop the robot: the engine holds
still for the cycle in the first case and reports both.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from services.whole_body_control.model.kinematics import Array, Kinematics
from services.whole_body_control.solvers.cascade import Cascade
from services.whole_body_control.solvers.problem import Problem, Solution, Solver, Unsolvable
from services.whole_body_control.tasks.base import NO_BOUND, Stack

DAMPING = 1e-2
"""The regularisation. With 1e-4 a stretched arm reverses at each cycle; 1e-2 costs 1 % of the speed."""


@dataclass(frozen=True, slots=True)
class Step:
    """What one cycle commands: configuration, velocity, residuals by level, and what a person should know."""

    q: Array
    velocity: Array
    residuals: dict[str, float]
    relaxed: tuple[str, ...] = ()
    fault: str = ""


class StackEngine:
    """Solves a stack for the present state and integrates it. Not thread-safe."""

    def __init__(
        self, kinematics: Kinematics, stack: Stack, solver: Solver | None = None, epsilon: float = DAMPING
    ) -> None:
        self._kinematics, self.stack = kinematics, stack
        self._solver: Solver = solver or Cascade()
        self._epsilon = epsilon

    def step(self, q: Array, dt_s: float) -> Step:
        """Return the next configuration after `dt_s`."""
        self._kinematics.update(q)
        try:
            problem, owners = self._problem(q, dt_s)
            solution = self._solver.solve(problem)
        except Unsolvable as error:
            return Step(q, np.zeros(self._kinematics.n_velocities), {}, fault=str(error))
        moved = self._kinematics.integrate(q, solution.velocity, dt_s)
        names = (level.name for level in self.stack.levels)
        residuals = dict(zip(names, solution.residuals, strict=True))
        return Step(moved, solution.velocity, residuals, tuple(_relaxed(solution, owners)))

    def _problem(self, q: Array, dt_s: float) -> tuple[Problem, list[tuple[str, int]]]:
        """Return the problem, and the number of rows of each constraint in their order."""
        levels = []
        for level in self.stack.levels:
            rows = [(task.weight, task.rows(self._kinematics)) for task in level.tasks]
            jacobian = np.vstack([weight**0.5 * each.jacobian for weight, each in rows])
            target = np.concatenate([weight**0.5 * each.velocity for weight, each in rows])
            levels.append((jacobian, target))
        bounds = [each.bounds(self._kinematics, q, dt_s) for each in self.stack.constraints]
        n = self._kinematics.n_velocities
        matrix = np.vstack([each.matrix for each in bounds]) if bounds else np.zeros((0, n))
        lower = np.concatenate([each.lower for each in bounds]) if bounds else np.zeros(0)
        upper = np.concatenate([each.upper for each in bounds]) if bounds else np.zeros(0)
        owners = [
            (each.name, len(rows.lower)) for each, rows in zip(self.stack.constraints, bounds, strict=True)
        ]
        clipped = np.maximum(lower, -NO_BOUND), np.minimum(upper, NO_BOUND)
        return Problem(levels, matrix, *clipped, self._epsilon), owners


def _relaxed(solution: Solution, owners: list[tuple[str, int]]) -> Iterator[str]:
    if not solution.is_relaxed:
        return
    start = 0
    for name, count in owners:
        most = float(solution.slack[start : start + count].max(initial=0.0))
        if most > 0:
            yield f"{name} by {most:.3g}"
        start += count
