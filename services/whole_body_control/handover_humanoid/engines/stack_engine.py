"""The motion engine by a stack of tasks: one problem a cycle, its velocities integrated to joint positions.

A problem without meaning (NaN from a sensor) or with relaxed bounds does not stop the robot: the engine holds
still for the cycle in the first case and reports both. Tasks write their rows into memory that is allocated
when the engine is made.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from handover.runtime.control_cycle import runs_in_cycle
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.solvers.compiled import fastest_solver
from handover_humanoid.solvers.problem import Problem, Solution, Solver, Unsolvable
from handover_humanoid.tasks.base import NO_BOUND, Bounds, Stack, Task

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
    solve_s: float = 0.0
    """The time that the solver took."""


class _Rows:
    """The memory of the rows of all levels, and the part of each task and of each level."""

    def __init__(self, stack: Stack, n: int) -> None:
        sizes = [[task.size for task in level.tasks] for level in stack.levels]
        count = sum(map(sum, sizes))
        self.jacobian, self.velocity = np.zeros((count, n)), np.zeros(count)
        self.tasks: list[tuple[Task, Array, Array]] = []
        self.levels: list[tuple[Array, Array]] = []
        end = 0
        for level, counts in zip(stack.levels, sizes, strict=True):
            first = end
            for task, size in zip(level.tasks, counts, strict=True):
                part = slice(end, end + size)
                self.tasks.append((task, self.jacobian[part], self.velocity[part]))
                end += size
            self.levels.append((self.jacobian[first:end], self.velocity[first:end]))

    def write(self, kinematics: Kinematics) -> None:
        for task, jacobian, velocity in self.tasks:
            task.write(kinematics, jacobian, velocity)
            if task.weight != 1.0:
                for part in (jacobian, velocity):
                    np.multiply(part, task.weight**0.5, out=part)


class _BoundRows:
    """The memory of the bounds of all constraints, which grows to the most rows that were needed."""

    def __init__(self, n: int) -> None:
        self.matrix, self.lower, self.upper = np.zeros((0, n)), np.zeros(0), np.zeros(0)

    def write(self, bounds: Sequence[Bounds]) -> int:
        """Copy the rows, and return their number."""
        count = sum([len(bound.lower) for bound in bounds])
        if count > len(self.lower):
            self.matrix = np.zeros((count, self.matrix.shape[1]))
            self.lower, self.upper = np.zeros(count), np.zeros(count)
        end = 0
        for bound in bounds:
            part = slice(end, end + len(bound.lower))
            self.matrix[part] = bound.matrix
            np.maximum(bound.lower, -NO_BOUND, out=self.lower[part])
            np.minimum(bound.upper, NO_BOUND, out=self.upper[part])
            end = part.stop
        return count


class StackEngine:
    """Solves a stack for the present state and integrates it. Not thread-safe.

    The arrays of a problem belong to the engine, and change with the next step.
    """

    def __init__(
        self, kinematics: Kinematics, stack: Stack, solver: Solver | None = None, epsilon: float = DAMPING
    ) -> None:
        self._kinematics, self.stack = kinematics, stack
        self._solver = fastest_solver() if solver is None else solver
        self._epsilon = epsilon
        self._names = [level.name for level in stack.levels]
        self._rows = _Rows(stack, kinematics.n_velocities)
        self._bounds = _BoundRows(kinematics.n_velocities)

    @runs_in_cycle
    def step(self, q: Array, dt_s: float) -> Step:
        """Return the next configuration after `dt_s`."""
        self._kinematics.update(q)
        constraints = self.stack.constraints
        try:
            bounds = [constraint.bounds(self._kinematics, q, dt_s) for constraint in constraints]
            problem = self._problem(bounds)
            began_s = time.perf_counter()
            solution = self._solver.solve(problem)
            solve_s = time.perf_counter() - began_s
        except Unsolvable as error:
            return Step(q, np.zeros(self._kinematics.n_velocities), {}, fault=str(error))
        moved = self._kinematics.integrate(q, solution.velocity, dt_s)
        residuals = dict(zip(self._names, solution.residuals, strict=True))
        if not solution.is_relaxed:
            return Step(moved, solution.velocity, residuals, solve_s=solve_s)
        owners = [
            (constraint.name, len(rows.lower)) for constraint, rows in zip(constraints, bounds, strict=True)
        ]
        relaxed = tuple(_relaxed(solution, owners))
        return Step(moved, solution.velocity, residuals, relaxed, solve_s=solve_s)

    def _problem(self, bounds: Sequence[Bounds]) -> Problem:
        self._rows.write(self._kinematics)
        count, memory = self._bounds.write(bounds), self._bounds
        return Problem(
            self._rows.levels,
            memory.matrix[:count],
            memory.lower[:count],
            memory.upper[:count],
            self._epsilon,
            (self._rows.jacobian, self._rows.velocity),
        )


def _relaxed(solution: Solution, owners: list[tuple[str, int]]) -> Iterator[str]:
    start = 0
    for name, count in owners:
        most = float(solution.slack[start : start + count].max(initial=0.0))
        if most > 0:
            yield f"{name} by {most:.3g}"
        start += count
