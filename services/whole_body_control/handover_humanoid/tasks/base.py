"""What a task and a constraint are, and how they form a stack.

A task is `<J, xdot* + lambda e>` (CoSiMA, equation 1): the velocity v is to satisfy `J v = xdot* + lambda e`.
A constraint bounds `A v`. Tasks on one level share its priority by their weights, and disturb no level above:

    stack = (left_sole & right_sole) / com / (left_hand & right_hand) / waist / posture << limits

`&` joins tasks on one level, `/` puts a level below, `<<` adds constraints, `0.1 * task` weights a task.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from handover_humanoid.model.kinematics import Array, Kinematics

NO_BOUND = 1e30


@dataclass(frozen=True, slots=True)
class Rows:
    """Rows of a task: `jacobian` (m, n_velocities) and `velocity` (m,), in the unit of the task."""

    jacobian: Array
    velocity: Array


@dataclass(frozen=True, slots=True)
class Bounds:
    """Rows of a constraint: `lower <= matrix @ v <= upper`, all (m, ...)."""

    matrix: Array
    lower: Array
    upper: Array


class Level:
    """Tasks of the same priority."""

    def __init__(self, *tasks: "Task") -> None:
        self.tasks = tasks

    def __and__(self, other: "Level") -> "Level":
        """Join the tasks of both on one level."""
        return Level(*self.tasks, *other.tasks)

    def __truediv__(self, other: "Level") -> "Stack":
        """Put a level below this one."""
        return Stack((self,)) / other

    def __lshift__(self, constraints: "Constraint | Iterable[Constraint]") -> "Stack":
        """Return a stack of this level under constraints."""
        return Stack((self,)) << constraints

    @property
    def name(self) -> str:
        """Return the names of the tasks, as in the notation."""
        return " & ".join(task.label for task in self.tasks)


class Task(Level, ABC):
    """One task. `gain` is lambda in 1/s: the share of the error that is removed per second."""

    def __init__(self, label: str, gain: float) -> None:
        super().__init__(self)
        if not gain >= 0:
            raise ValueError(f'the gain of the task "{label}" is {gain}; it must be 0 or more, in 1/s')
        self.label, self.gain, self.weight = label, gain, 1.0

    def __rmul__(self, weight: float) -> Self:
        """Weight the task against the others on its level."""
        if not 0 < weight < np.inf:
            raise ValueError(
                f'the weight of the task "{self.label}" is {weight}; it must be above 0 and finite'
            )
        self.weight *= weight
        return self

    @property
    @abstractmethod
    def size(self) -> int:
        """The number of rows."""

    @abstractmethod
    def write(self, kinematics: Kinematics, jacobian: Array, velocity: Array) -> None:
        """Write the rows for the state that `kinematics` was updated with, as `Rows` says."""

    def rows(self, kinematics: Kinematics) -> Rows:
        """Return the rows for the state that `kinematics` was updated with."""
        rows = Rows(np.empty((self.size, kinematics.n_velocities)), np.empty(self.size))
        self.write(kinematics, rows.jacobian, rows.velocity)
        return rows

    @abstractmethod
    def error(self, kinematics: Kinematics) -> Array:
        """Return the error that the task removes: desired minus actual, in its unit."""


class Constraint(ABC):
    """A bound on velocities that every level obeys."""

    name: str

    @abstractmethod
    def bounds(self, kinematics: Kinematics, q: Array, dt_s: float) -> Bounds:
        """Return the rows for the state `q`, so that they hold for the next `dt_s`.

        The arrays belong to the constraint, and change with the next call.
        """


@dataclass(frozen=True, slots=True)
class Stack:
    """Levels, the most important first, under constraints."""

    levels: tuple[Level, ...]
    constraints: tuple[Constraint, ...] = ()

    def __truediv__(self, other: Level) -> "Stack":
        """Put a level below all others."""
        return replace(self, levels=(*self.levels, other))

    def __lshift__(self, constraints: Constraint | Iterable[Constraint]) -> "Stack":
        """Add constraints."""
        more = (constraints,) if isinstance(constraints, Constraint) else tuple(constraints)
        return replace(self, constraints=(*self.constraints, *more))

    def __str__(self) -> str:
        """Return the notation."""
        levels = (f"({level.name})" if len(level.tasks) > 1 else level.name for level in self.levels)
        constraints = ", ".join(constraint.name for constraint in self.constraints)
        return " / ".join(levels) + (f" << {constraints}" if constraints else "")
