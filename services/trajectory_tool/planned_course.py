"""The execution of a planned trajectory, with a stop on its path.

A stop slows the time of the trajectory down to zero, so that the joints stay on the checked path.
Where the time runs at the rate r, the joints have

    velocity = q' r        acceleration = q'' r^2 + q' r'        jerk = q''' r^3 + 3 q'' r r' + q' r''

The rate falls along a quintic from 1 to 0. The shortest stop is chosen for which all joints stay within the
limits of the robot; while the trajectory itself is at a limit, the stop may have to begin later. At reduced
speed there is a reserve, since a stop may use the full limits. At full speed the motion may have to end at
its target.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from services.trajectory_tool.joint_trajectory import JointTrajectory
from services.trajectory_tool.trajectory import Limits, Setpoint

STOPS_S = (0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0, 1.4, 2.0)
DELAYS_S = (0.0, 0.02, 0.04, 0.06, 0.08, 0.12, 0.16, 0.2, 0.3, 0.4)
TOLERANCE = 1.001
SAMPLE_EVERY_S = 0.004


@dataclass(frozen=True, slots=True)
class _Stop:
    """A stop: the time of the trajectory when it was requested, its delay and its duration, in s."""

    from_s: float
    delay_s: float
    takes_s: float

    @property
    def total_s(self) -> float:
        return self.delay_s + self.takes_s

    def place(self, since_s: float) -> tuple[float, float, float]:
        """Return the time of the trajectory and its first two derivatives."""
        if since_s <= self.delay_s:
            return self.from_s + since_s, 1.0, 0.0
        x = min((since_s - self.delay_s) / self.takes_s, 1.0)
        gone = x - (2.5 * x**4 - 3 * x**5 + x**6)
        rate = 1 - (10 * x**3 - 15 * x**4 + 6 * x**5)
        change = -30 * x**2 * (1 - x) ** 2 / self.takes_s
        return self.from_s + self.delay_s + self.takes_s * gone, rate, change


class PlannedCourse:
    """A motion along a trajectory or, after `may_go` was False, to rest on it. The time is an argument.

    `limits` are those of the robot, which apply to a stop.
    """

    def __init__(self, trajectory: JointTrajectory, limits: Limits, began_s: float) -> None:
        self.stopping = False
        self._trajectory = trajectory
        self._limits = limits
        self._began_s = began_s
        self._duration_s = trajectory.duration_s
        self._stop: _Stop | None = None

    def at(self, now_s: float, *, may_go: bool = True) -> Setpoint:
        """Return the setpoint at a time; the stop starts when `may_go` is False for the first time."""
        since_s = min(max(now_s - self._began_s, 0.0), self._duration_s)
        if not may_go and not self.stopping and not self.is_over(now_s):
            self.stopping = True
            self._stop = _shortest_stop(self._trajectory, since_s, self._limits)
            self._began_s, self._duration_s, since_s = now_s, self._stop.total_s, 0.0
        if self._stop is None:
            return self._trajectory.at(since_s)
        place_s, rate, change = self._stop.place(since_s)
        found = self._trajectory.at(place_s)
        if self.is_over(now_s) or place_s >= self._trajectory.duration_s:
            return Setpoint.at_rest(found.positions)
        return Setpoint(
            found.positions,
            tuple(rate * velocity for velocity in found.velocities),
            tuple(
                acceleration * rate**2 + velocity * change
                for velocity, acceleration in zip(found.velocities, found.accelerations, strict=True)
            ),
        )

    def remaining_s(self, now_s: float) -> float:
        """Return the time until the joints are at rest."""
        return max(self._began_s + self._duration_s - now_s, 0.0)

    def is_over(self, now_s: float) -> bool:
        """Return whether the joints are at rest: at the target or, after a stop, on the way."""
        return now_s - self._began_s >= self._duration_s


def _shortest_stop(trajectory: JointTrajectory, from_s: float, limits: Limits) -> _Stop:
    """Return the shortest stop within the limits; at the latest, the motion ends at its target."""
    left_s = trajectory.duration_s - from_s
    choices = sorted(
        (_Stop(from_s, delay_s, takes_s) for delay_s, takes_s in product(DELAYS_S, STOPS_S)),
        key=lambda stop: stop.total_s,
    )
    for stop in choices:
        if stop.total_s < left_s and _peak_ratio(trajectory, stop, limits) <= TOLERANCE:
            return stop
    return _Stop(from_s, left_s, SAMPLE_EVERY_S)


def _peak_ratio(trajectory: JointTrajectory, stop: _Stop, limits: Limits) -> float:
    x = np.linspace(0.0, 1.0, max(round(stop.takes_s / SAMPLE_EVERY_S), 40))
    gone = x - (2.5 * x**4 - 3 * x**5 + x**6)
    rate = (1 - (10 * x**3 - 15 * x**4 + 6 * x**5))[:, None]
    change = (-30 * x**2 * (1 - x) ** 2 / stop.takes_s)[:, None]
    second = (-(60 * x - 180 * x**2 + 120 * x**3) / stop.takes_s**2)[:, None]
    places = stop.from_s + stop.delay_s + stop.takes_s * gone
    beyond = places >= trajectory.duration_s
    places = np.minimum(places, trajectory.duration_s)
    q1, q2, q3 = (np.where(beyond[:, None], 0.0, trajectory.derivative(places, order)) for order in (1, 2, 3))
    return max(
        float((np.abs(value) / np.array(limit)).max())
        for value, limit in (
            (q1 * rate, limits.velocity),
            (q2 * rate**2 + q1 * change, limits.acceleration),
            (q3 * rate**3 + 3 * q2 * rate * change + q1 * second, limits.jerk),
        )
    )
