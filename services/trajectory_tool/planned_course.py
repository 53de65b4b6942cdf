"""The execution of a planned trajectory at a pace, with a stop on its path.

A lower pace slows the time of the trajectory down, and a stop slows it down to zero, so that the joints stay
on the checked path. Where the time runs at the rate r, the joints have

    velocity = q' r        acceleration = q'' r^2 + q' r'        jerk = q''' r^3 + 3 q'' r r' + q' r''

The rate changes along a quintic. The shortest change is chosen for which all joints stay within the limits
of the robot; while the trajectory itself is at a limit, it may have to begin later. A constant rate of 1 or
less is within the limits, as the trajectory is. So every change that was chosen can be completed, and it is
replaced only by another one that can be. At full speed the motion may have to end at its target.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from services.trajectory_tool.joint_trajectory import Array, JointTrajectory
from services.trajectory_tool.trajectory import Limits, Setpoint, rounded_pace

TAKES_S = (0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0, 1.4, 2.0)
DELAYS_S = (0.0, 0.02, 0.04, 0.06, 0.08, 0.12, 0.16, 0.2, 0.3, 0.4)
TOLERANCE = 1.001
SAMPLE_EVERY_S = 0.004
RETRY_S = 0.02
_CHOICES = sorted(product(DELAYS_S, TAKES_S), key=sum)
_AT_ONCE = [(0.0, takes_s) for takes_s in TAKES_S]


@dataclass(frozen=True, slots=True)
class _Rate:
    """The rate from the time `place_s` of the trajectory: constant for `delay_s`, then a quintic to `to`.

    `start` is the rate with its two derivatives; with a delay, these are 0. `takes_s` is 0 for a constant
    rate.
    """

    place_s: float
    start: tuple[float, float, float]
    to: float
    delay_s: float = 0.0
    takes_s: float = 0.0

    @property
    def total_s(self) -> float:
        return self.delay_s + self.takes_s

    def at(self, since_s: float) -> tuple[float, float, float, float]:
        """Return the time of the trajectory, the rate and its first two derivatives."""
        if self.takes_s == 0.0 or since_s <= self.delay_s:
            return self.place_s + self.start[0] * since_s, *self.start
        begins_s = self.place_s + self.start[0] * self.delay_s
        if since_s >= self.total_s:
            place, *_ = self._quintic(np.array(1.0))
            return begins_s + float(place) + self.to * (since_s - self.total_s), self.to, 0.0, 0.0
        place, rate, slope, curve = self._quintic(np.array((since_s - self.delay_s) / self.takes_s))
        return begins_s + float(place), float(rate), float(slope), float(curve)

    def samples(self) -> tuple[Array, Array, Array, Array]:
        """Return the quintic likewise, as arrays."""
        share = np.linspace(0.0, 1.0, max(round(self.takes_s / SAMPLE_EVERY_S), 40))
        place, rate, slope, curve = self._quintic(share)
        return self.place_s + self.start[0] * self.delay_s + place, rate, slope, curve

    def _quintic(self, x: Array) -> tuple[Array, Array, Array, Array]:
        t = self.takes_s
        r0, s0, c0 = self.start[0], self.start[1] * t, self.start[2] * t * t
        h = self.to - r0
        a3 = 10 * h - 6 * s0 - 1.5 * c0
        a4 = -15 * h + 8 * s0 + 1.5 * c0
        a5 = 6 * h - 3 * s0 - 0.5 * c0
        place = x * (r0 + x * (s0 / 2 + x * (c0 / 6 + x * (a3 / 4 + x * (a4 / 5 + x * a5 / 6)))))
        rate = r0 + x * (s0 + x * (c0 / 2 + x * (a3 + x * (a4 + x * a5))))
        slope = s0 + x * (c0 + x * (3 * a3 + x * (4 * a4 + x * 5 * a5)))
        curve = c0 + x * (6 * a3 + x * (12 * a4 + x * 20 * a5))
        return t * place, rate, slope / t, curve / (t * t)


class PlannedCourse:
    """A motion along a trajectory or, after a pace of 0, to rest on it. The time is an argument.

    `limits` are those of the robot, which apply to a change of the pace.
    """

    def __init__(self, trajectory: JointTrajectory, limits: Limits, began_s: float) -> None:
        self.stopping = False
        self._trajectory = trajectory
        self._limits = limits
        self._began_s = began_s
        self._rate = _Rate(0.0, (1.0, 0.0, 0.0), 1.0)
        self._retry_s = began_s

    @cached_property
    def _jerk_ranges(self) -> tuple[Array, Array]:
        # A sample counts with the jerks up to its neighbours: between them the jerk may jump and jump back.
        return self._trajectory.jerk_ranges(SAMPLE_EVERY_S)

    def at(self, now_s: float, *, pace: float = 1.0) -> Setpoint:
        """Return the setpoint at a time, and continue with `pace`, the allowed fraction of the speed.

        The first pace of 0 starts the stop, which later paces do not change.
        """
        since_s = max(now_s - self._began_s, 0.0)
        place_s, rate, slope, curve = self._rate.at(since_s)
        if not self.is_over(now_s):
            self._change_pace(now_s, (place_s, rate, slope, curve), rounded_pace(pace))
            if place_s == 0.0:
                rate = self._rate.start[0]
        found = self._trajectory.at(place_s)
        if self.is_over(now_s) or place_s >= self._trajectory.duration_s:
            return Setpoint.at_rest(found.positions)
        return Setpoint(
            found.positions,
            tuple(rate * velocity for velocity in found.velocities),
            tuple(
                acceleration * rate**2 + velocity * slope
                for velocity, acceleration in zip(found.velocities, found.accelerations, strict=True)
            ),
        )

    def remaining_s(self, now_s: float) -> float:
        """Return the time until the joints are at rest, at the present pace."""
        if self.is_over(now_s):
            return 0.0
        since_s = max(now_s - self._began_s, 0.0)
        if self._rate.to == 0.0:
            return self._rate.total_s - since_s
        rate = self._rate
        left_s = self._trajectory.duration_s - rate.at(max(since_s, rate.total_s))[0]
        return max(left_s / rate.to + max(rate.total_s - since_s, 0.0), 0.0)

    def is_over(self, now_s: float) -> bool:
        """Return whether the joints are at rest: at the target or, after a stop, on the way."""
        since_s = max(now_s - self._began_s, 0.0)
        if self._rate.to == 0.0 and since_s >= self._rate.total_s:
            return True
        return self._rate.at(since_s)[0] >= self._trajectory.duration_s

    def _change_pace(self, now_s: float, state: tuple[float, float, float, float], pace: float) -> None:
        """Replace the rate by the shortest change to `pace`; without one, try again later."""
        self.stopping = self.stopping or pace == 0.0
        pace = 0.0 if self.stopping else pace
        if pace == self._rate.to or now_s < self._retry_s:
            return
        place_s, *rate = state
        if place_s == 0.0:
            self._rate = _Rate(0.0, (pace, 0.0, 0.0), pace)
            self._began_s = now_s
            return
        change = self._shortest_change(place_s, (rate[0], rate[1], rate[2]), pace)
        if change is not None:
            self._rate, self._began_s = change, now_s
        else:
            self._retry_s = now_s + RETRY_S

    def _shortest_change(self, place_s: float, start: tuple[float, float, float], to: float) -> _Rate | None:
        is_constant = start[1] == 0.0 and start[2] == 0.0
        choices: Sequence[tuple[float, float]] = _CHOICES if is_constant else _AT_ONCE
        for first in range(0, len(choices), len(TAKES_S)):
            rates = [_Rate(place_s, start, to, *each) for each in choices[first : first + len(TAKES_S)]]
            for rate, is_possible in zip(rates, self._are_possible(rates), strict=True):
                if is_possible:
                    return rate
        return None

    def _are_possible(self, rates: Sequence[_Rate]) -> list[bool]:
        """Return for each change whether it ends on the path, within the limits, and never runs backwards."""
        samples = [rate.samples() for rate in rates]
        starts = np.cumsum([0, *(len(each[0]) for each in samples[:-1])])
        places, rate, slope, curve = (np.concatenate(parts) for parts in zip(*samples, strict=True))
        end_s = self._trajectory.duration_s
        beyond = places >= end_s
        q1, q2 = (
            np.where(beyond[:, None], 0.0, self._trajectory.derivative(np.minimum(places, end_s), order))
            for order in (1, 2)
        )
        lowest, highest = self._jerk_ranges
        interval = np.clip((places / self._trajectory.spacing_s).astype(np.int64), 0, len(lowest) - 1)
        q3_low, q3_high = (np.where(beyond[:, None], 0.0, each[interval]) for each in (lowest, highest))
        r, r1, r2 = rate[:, None], slope[:, None], curve[:, None]
        of_change = 3 * q2 * r * r1 + q1 * r2
        ratios = np.zeros(len(places))
        for value, limit in (
            (q1 * r, self._limits.velocity),
            (q2 * r**2 + q1 * r1, self._limits.acceleration),
            (q3_low * r**3 + of_change, self._limits.jerk),
            (q3_high * r**3 + of_change, self._limits.jerk),
        ):
            np.maximum(ratios, (np.abs(value) / np.array(limit)).max(axis=1), out=ratios)
        peaks = np.maximum.reduceat(np.where(rate < -1e-9, np.inf, ratios), starts)
        ends_s = [each[0][-1] for each in samples]
        return [
            bool(peak <= TOLERANCE and place_s < end_s) for peak, place_s in zip(peaks, ends_s, strict=True)
        ]
