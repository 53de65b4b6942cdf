"""Trajectories of all joints as uniform cubic B-splines: they leave and reach rest, with bounded jerk.

A position is a convex combination of four control points. The velocity is one of the first differences
of the control points, divided by the spacing; the acceleration one of the second, the jerk of the third.
So the largest difference is a bound of the derivative at every time, not only at samples:

    |velocity| <= max|P[k+1] - P[k]| / h        |jerk| <= max|P[k+3] - 3 P[k+2] + 3 P[k+1] - P[k]| / h^3

Example: control points 0 0 0 1 1 1 with h = 1 s move by 1 rad in 3 s, at up to 0.67 rad/s (bound: 1).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from handover_robots.model.joints import Joints
from handover_robots.model.trajectory import Limits, Setpoint

Array = NDArray[np.float64]

U = TypeVar("U", float, Array)

_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class Violation:
    """A limit that a trajectory exceeds: which one, of which joint, and by which factor."""

    quantity: str
    joint: int
    ratio: float


@dataclass(frozen=True)
class JointTrajectory:
    """A motion from rest to rest: control points (rows, three equal ones at both ends), spacing in s."""

    points: Array
    spacing_s: float

    @cached_property
    def duration_s(self) -> float:
        """Return the duration."""
        return (len(self.points) - 3) * self.spacing_s

    @property
    def start(self) -> Joints:
        """Return the first joint positions."""
        return tuple(self.points[0].tolist())

    @property
    def target(self) -> Joints:
        """Return the last joint positions."""
        return tuple(self.points[-1].tolist())

    @cached_property
    def _per_second(self) -> Array:
        """Return what turns derivatives by the intervals into those by the time, one row an order."""
        return np.array([[self.spacing_s**-order] for order in range(3)])

    def at(self, time_s: float) -> Setpoint:
        """Return the setpoint at a time since the start; at rest before and after."""
        h = self.spacing_s
        time_s = min(max(time_s, 0.0), self.duration_s)
        first = min(int(time_s / h), len(self.points) - 4)
        weights = np.array(spline_weights(time_s / h - first))
        position, velocity, acceleration = (
            weights @ self.points[first : first + 4] * self._per_second
        ).tolist()
        return Setpoint(tuple(position), tuple(velocity), tuple(acceleration))

    def positions(self, step_s: float) -> Array:
        """Return the positions every `step_s` and at the end, one row each."""
        count = max(math.ceil(self.duration_s / step_s), 1)
        times = np.minimum(np.arange(count + 1) * step_s, self.duration_s)
        return self.derivative(times, 0)

    def derivative(self, times_s: Array, order: int) -> Array:
        """Return position (0), velocity, acceleration or jerk (3) at times, one row each."""
        h, p = self.spacing_s, self.points
        first = np.minimum((times_s / h).astype(np.int64), len(p) - 4)
        u = (times_s / h - first)[:, None]
        v = 1 - u
        a, b, c, d = p[first], p[first + 1], p[first + 2], p[first + 3]
        match order:
            case 0:
                sums = v**3 * a + (3 * u**3 - 6 * u**2 + 4) * b + (3 * v**3 - 6 * v**2 + 4) * c + u**3 * d
                return np.asarray(sums / 6)
            case 1:
                return np.asarray((v**2 * (b - a) + (1 + 2 * u * v) * (c - b) + u**2 * (d - c)) / (2 * h))
            case 2:
                return np.asarray((v * (c - 2 * b + a) + u * (d - 2 * c + b)) / h**2)
            case _:
                return np.asarray((d - 3 * c + 3 * b - a) / h**3)

    def jerk_ranges(self, within_s: float) -> tuple[Array, Array]:
        """Return the smallest and the largest jerk within `within_s` of each interval, one row each.

        The jerk is constant in each interval of `spacing_s` and jumps between them.
        """
        jerks = np.diff(self.points, 3, axis=0) / self.spacing_s**3
        reach = math.ceil(within_s / self.spacing_s)
        padded = np.pad(jerks, ((reach, reach), (0, 0)), mode="edge")
        near = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0)
        return near.min(axis=2), near.max(axis=2)

    def ratios(self, limits: Limits) -> tuple[Array, Array, Array]:
        """Return bounds of velocity, acceleration and jerk of each joint, as fractions of the limits."""
        fractions = []
        for order, limit in enumerate((limits.velocity, limits.acceleration, limits.jerk), 1):
            peak = np.abs(np.diff(self.points, order, axis=0)).max(axis=0, initial=0.0)
            fractions.append(peak / (self.spacing_s**order * np.array(limit)))
        return fractions[0], fractions[1], fractions[2]

    def violations(self, limits: Limits) -> Iterator[Violation]:
        """Yield the limits of velocity, acceleration and jerk that are exceeded."""
        for quantity, ratios in zip(("velocity", "acceleration", "jerk"), self.ratios(limits), strict=True):
            for joint, ratio in enumerate(ratios.tolist()):
                if ratio > 1 + _TOLERANCE:
                    yield Violation(quantity, joint, ratio)

    def slowed(self, speed: float) -> "JointTrajectory":
        """Return the same motion at `speed`, a fraction above 0 and up to 1."""
        return JointTrajectory(self.points, self.spacing_s / speed)

    def within(self, limits: Limits) -> "JointTrajectory":
        """Return the same motion, slowed as little as the limits demand."""
        velocity, acceleration, jerk = (float(ratio.max(initial=0.0)) for ratio in self.ratios(limits))
        factor = max(velocity, acceleration ** (1 / 2), jerk ** (1 / 3))
        return self if factor <= 1 else JointTrajectory(self.points, self.spacing_s * factor * (1 + 1e-12))


def spline_weights(u: U) -> tuple[tuple[U, U, U, U], ...]:
    """Return the weights of the four control points at the fraction `u` of an interval, and two derivatives.

    They are those for intervals of length 1; a derivative of order k is divided by the length to the k.
    """
    v = 1 - u
    return (
        (v**3 / 6, (3 * u**3 - 6 * u**2 + 4) / 6, (3 * v**3 - 6 * v**2 + 4) / 6, u**3 / 6),
        (-(v**2) / 2, (v**2 - 1 - 2 * u * v) / 2, (1 + 2 * u * v - u**2) / 2, u**2 / 2),
        (v, u - 2 * v, v - 2 * u, u),
    )
