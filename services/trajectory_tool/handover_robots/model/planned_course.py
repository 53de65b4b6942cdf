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
from typing import TypeVar

import numpy as np

from handover_robots.model.joint_trajectory import Array, JointTrajectory
from handover_robots.model.trajectory import Limits, Setpoint, rounded_pace

TAKES_S = (0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0, 1.4, 2.0)
DELAYS_S = (0.0, 0.02, 0.04, 0.06, 0.08, 0.12, 0.16, 0.2, 0.3, 0.4)
TOLERANCE = 1 + 1e-5
VERIFY_EVERY_S = 0.001
MIN_SAMPLES = 40
MAX_SAMPLES = 100
"""Of one change in the first comparison; the change that is chosen is verified with all samples."""
CHANGES_A_CYCLE = 12
T = TypeVar("T", float, Array)
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
            place = self._quintic(1.0)[0]
            return begins_s + place + self.to * (since_s - self.total_s), self.to, 0.0, 0.0
        place, rate, slope, curve = self._quintic((since_s - self.delay_s) / self.takes_s)
        return begins_s + place, rate, slope, curve

    def samples(self, max_samples: int | None = None) -> tuple[Array, Array, Array, Array]:
        """Return the quintic likewise, as arrays: each `VERIFY_EVERY_S`, or fewer."""
        count = max(round(self.takes_s / VERIFY_EVERY_S), MIN_SAMPLES)
        share = np.linspace(0.0, 1.0, min(count, max_samples or count))
        place, rate, slope, curve = self._quintic(share)
        return self.place_s + self.start[0] * self.delay_s + place, rate, slope, curve

    def _quintic(self, x: T) -> tuple[T, T, T, T]:
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
        self.trajectory = trajectory
        self._limits = limits
        self._began_s = began_s
        self._rate = _Rate(0.0, (1.0, 0.0, 0.0), 1.0)
        self._tried = 0
        """How many changes to the wanted pace were tried in the cycles before."""
        self._wanted = 1.0

    def at(self, now_s: float, *, pace: float = 1.0) -> Setpoint:
        """Return the setpoint at a time, and continue with `pace`, the allowed fraction of the speed.

        The first pace of 0 starts the stop, which later paces do not change.
        """
        place_s, rate, slope, curve = self._rate.at(max(now_s - self._began_s, 0.0))
        if not self._is_over(now_s, place_s):
            self._change_pace(now_s, (place_s, rate, slope, curve), rounded_pace(pace))
            if place_s == 0.0:
                rate = self._rate.start[0]
        setpoint = self.trajectory.at(place_s)
        if self._is_over(now_s, place_s):
            return Setpoint.at_rest(setpoint.positions)
        return Setpoint(
            setpoint.positions,
            tuple(rate * velocity for velocity in setpoint.velocities),
            tuple(
                acceleration * rate**2 + velocity * slope
                for velocity, acceleration in zip(setpoint.velocities, setpoint.accelerations, strict=True)
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
        left_s = self.trajectory.duration_s - rate.at(max(since_s, rate.total_s))[0]
        return max(left_s / rate.to + max(rate.total_s - since_s, 0.0), 0.0)

    def is_over(self, now_s: float) -> bool:
        """Return whether the joints are at rest: at the target or, after a stop, on the way."""
        return self._is_over(now_s, self._rate.at(max(now_s - self._began_s, 0.0))[0])

    def _is_over(self, now_s: float, place_s: float) -> bool:
        is_at_rest = self._rate.to == 0.0 and now_s - self._began_s >= self._rate.total_s
        return is_at_rest or place_s >= self.trajectory.duration_s

    def _change_pace(self, now_s: float, state: tuple[float, float, float, float], pace: float) -> None:
        """Replace the rate by a short change to `pace`.

        A cycle compares only some changes, shortest first, so that none takes long; the next one continues.
        """
        self.stopping = self.stopping or pace == 0.0
        pace = 0.0 if self.stopping else pace
        if pace != self._wanted:
            self._wanted, self._tried = pace, 0
        if pace == self._rate.to:
            return
        place_s, *rate = state
        if place_s == 0.0:
            self._rate = _Rate(0.0, (pace, 0.0, 0.0), pace)
            self._began_s = now_s
            return
        change = self._next_change(place_s, (rate[0], rate[1], rate[2]), pace)
        if change is not None:
            self._rate, self._began_s, self._tried = change, now_s, 0

    def _next_change(self, place_s: float, start: tuple[float, float, float], to: float) -> _Rate | None:
        is_constant = start[1] == 0.0 and start[2] == 0.0
        choices: Sequence[tuple[float, float]] = _CHOICES if is_constant else _AT_ONCE
        first = self._tried % len(choices)
        self._tried = first + CHANGES_A_CYCLE
        rates = [_Rate(place_s, start, to, *choice) for choice in choices[first : self._tried]]
        for rate, is_possible in zip(rates, self._are_possible(rates, MAX_SAMPLES), strict=True):
            if is_possible and self._are_possible([rate])[0]:
                return rate
        return None

    @cached_property
    def _jerk_ranges(self) -> tuple[Array, Array]:
        # A sample counts with the jerks up to its neighbours: between them the jerk may jump and jump back.
        return self.trajectory.jerk_ranges(VERIFY_EVERY_S)

    @cached_property
    def _accelerations(self) -> Array:
        # At the ends of the intervals of the spline; in between, they are linear.
        return np.asarray(np.diff(self.trajectory.points, 2, axis=0) / self.trajectory.spacing_s**2)

    def _are_possible(self, rates: Sequence[_Rate], max_samples: int | None = None) -> list[bool]:
        """Return for each change whether it ends on the path, within the limits, and never runs backwards."""
        samples = [rate.samples(max_samples) for rate in rates]
        starts = np.cumsum([0, *(len(sample[0]) for sample in samples[:-1])])
        places, rate, slope, curve = (np.concatenate(parts) for parts in zip(*samples, strict=True))
        end_s = self.trajectory.duration_s
        beyond = places >= end_s
        # A change whose rate turns negative is refused below; it may run back to before the start.
        within_s = np.clip(places, 0.0, end_s)
        q1, q2 = (
            np.where(beyond[:, None], 0.0, self.trajectory.derivative(within_s, order)) for order in (1, 2)
        )
        lowest, highest = self._jerk_ranges
        interval = np.clip((within_s / self.trajectory.spacing_s).astype(np.int64), 0, len(lowest) - 1)
        q2_first, q2_last = (
            np.where(beyond[:, None], 0.0, self._accelerations[interval + end]) for end in (0, 1)
        )
        q3_low, q3_high = (np.where(beyond[:, None], 0.0, bound[interval]) for bound in (lowest, highest))
        r, r1, r2 = rate[:, None], slope[:, None], curve[:, None]
        of_change = 3 * q2 * r * r1 + q1 * r2
        ratios = np.zeros(len(places))
        for value, limit in (
            (q1 * r, self._limits.velocity),
            (q2_first * r**2 + q1 * r1, self._limits.acceleration),
            (q2_last * r**2 + q1 * r1, self._limits.acceleration),
            (q3_low * r**3 + of_change, self._limits.jerk),
            (q3_high * r**3 + of_change, self._limits.jerk),
        ):
            np.maximum(ratios, (np.abs(value) / np.array(limit)).max(axis=1), out=ratios)
        peaks = np.maximum.reduceat(np.where(rate < -1e-9, np.inf, ratios), starts)
        ends_s = [sample[0][-1] for sample in samples]
        return [
            bool(peak <= TOLERANCE and place_s < end_s) for peak, place_s in zip(peaks, ends_s, strict=True)
        ]
