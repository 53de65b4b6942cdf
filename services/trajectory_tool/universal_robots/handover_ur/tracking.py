"""Joint targets for every cycle of the controller, from setpoints that arrive irregularly.

A setpoint is extrapolated for a short time, then the joints come to rest. The tracker follows it exactly
while the change of velocity is within the acceleration limit. Otherwise, after a gap or a jump, it approaches
the setpoint within the limits of velocity and acceleration; no input causes a step of position or velocity.
"""

import math
from collections.abc import Sequence

from handover.runtime.control_cycle import runs_in_cycle

EXTRAPOLATION_S = 0.010
"""A setpoint is extrapolated no further; without another, the joints then come to rest there."""
CATCH_UP, CATCH_UP_RAD_S = 0.05, 0.02
"""A joint that is behind moves so much faster than its setpoint: a fraction of its speed, and rad/s."""
GIVE_WAY = 0.5
"""A joint that is ahead moves so much slower than its setpoint, likewise, and not backwards."""
CLOCK_GAIN = 0.02
MAX_CLOCK_ERROR_S = 0.02
_SMALL = 1e-12


class CycleClock:
    """The time of the controller's cycles: steps of equal length that follow the local clock on average."""

    def __init__(self) -> None:
        self._time_s: float | None = None

    @runs_in_cycle
    def next_s(self, now_s: float, cycles: int, cycle_s: float) -> float:
        """Return the time of this cycle, `cycles` after the last one; `now_s` is the local clock."""
        expected_s = now_s if self._time_s is None else self._time_s + cycles * cycle_s
        error_s = now_s - expected_s
        if abs(error_s) > MAX_CLOCK_ERROR_S:
            expected_s, error_s = now_s, 0.0
        self._time_s = expected_s + CLOCK_GAIN * error_s
        return self._time_s


class TargetTracker:
    """Joint targets that follow setpoints within limits of velocity (rad/s) and acceleration (rad/s^2)."""

    def __init__(self, max_rad_s: Sequence[float], max_rad_s2: Sequence[float]) -> None:
        self._max_rad_s = tuple(max_rad_s)
        self._max_rad_s2 = tuple(max_rad_s2)
        self.positions: list[float] = [0.0] * len(self._max_rad_s)
        self.velocities: list[float] = [0.0] * len(self._max_rad_s)
        self._before = (list(self.positions), list(self.velocities))
        self.lag_rad = 0.0
        """How far a joint is behind its setpoint, at most."""

    @runs_in_cycle
    def start(self, positions: Sequence[float]) -> None:
        """Begin at rest at `positions`."""
        self.positions = list(positions)
        self.velocities = [0.0] * len(self.positions)
        self.lag_rad = 0.0

    @runs_in_cycle
    def step_again(
        self,
        setpoint: tuple[Sequence[float], Sequence[float], Sequence[float]],
        age_s: float,
        cycle_s: float,
    ) -> tuple[float, ...]:
        """Replace the last step by one with a newer setpoint."""
        self.positions, self.velocities = list(self._before[0]), list(self._before[1])
        return self.step(setpoint, age_s, cycle_s)

    @runs_in_cycle
    def step(
        self,
        setpoint: tuple[Sequence[float], Sequence[float], Sequence[float]],
        age_s: float,
        cycle_s: float,
    ) -> tuple[float, ...]:
        """Return the targets of the next cycle for a setpoint (positions, velocities, accelerations).

        The setpoint was right `age_s` ago; a negative age is that of a setpoint for later.
        """
        ahead_s = min(max(age_s, -EXTRAPOLATION_S), EXTRAPOLATION_S)
        self._before = (list(self.positions), list(self.velocities))
        if age_s > EXTRAPOLATION_S and (any(setpoint[1]) or any(setpoint[2])):
            self._brake(cycle_s)
            return tuple(self.positions)
        lag_rad = 0.0
        for joint, (position, velocity, acceleration) in enumerate(zip(*setpoint, strict=True)):
            goal = position + velocity * ahead_s + acceleration * ahead_s * ahead_s / 2
            forward = velocity + acceleration * ahead_s
            self._step_joint(joint, goal, forward, cycle_s)
            behind = goal - self.positions[joint]
            lag_rad = max(lag_rad, math.copysign(behind, behind * forward) if forward else abs(behind))
        self.lag_rad = lag_rad
        return tuple(self.positions)

    @runs_in_cycle
    def _brake(self, cycle_s: float) -> None:
        """Come to rest without returning to the setpoint; all joints slow down in proportion."""
        moving = [
            limit * cycle_s / abs(velocity)
            for velocity, limit in zip(self.velocities, self._max_rad_s2, strict=True)
            if velocity
        ]
        kept = max(1.0 - min(moving, default=1.0), 0.0)
        self.velocities = [kept * velocity for velocity in self.velocities]
        self.positions = [
            position + velocity * cycle_s
            for position, velocity in zip(self.positions, self.velocities, strict=True)
        ]
        self.lag_rad = 0.0

    @runs_in_cycle
    def _step_joint(self, joint: int, goal: float, forward: float, cycle_s: float) -> None:
        limit, max_rad_s2 = self._max_rad_s[joint], self._max_rad_s2[joint]
        change = max_rad_s2 * cycle_s
        before, error = self.velocities[joint], goal - self.positions[joint]
        wanted = error / cycle_s
        if abs(wanted - before) > change + _SMALL or abs(wanted) > limit:
            behind = error - forward * cycle_s
            approach = min(abs(behind) / cycle_s, math.sqrt(max_rad_s2 * abs(behind)))
            if forward:
                share = CATCH_UP if behind * forward > 0 else GIVE_WAY
                approach = min(approach, share * abs(forward) + CATCH_UP_RAD_S)
            wanted = forward + math.copysign(approach, behind)
            wanted = min(max(wanted, -limit), limit)
            wanted = min(max(wanted, before - change), before + change)
        self.velocities[joint] = wanted
        self.positions[joint] += wanted * cycle_s
