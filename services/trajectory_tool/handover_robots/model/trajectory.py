"""A trajectory: the joint positions as a function of time, within the joint limits.

A late control cycle therefore still uses the correct position. A motion is a straight line in joint space,
and a stop stays on that line. ruckig computes the profile along the line.
"""

import math
from dataclasses import dataclass
from typing import Any

from ruckig import ControlInterface, InputParameter, Result, Ruckig, RuckigError
from ruckig import Trajectory as RuckigProfile

from handover.messages import text_of
from handover_robots.model.faults import RobotFault
from handover_robots.model.joints import Joints

NOTHING_RAD = 1e-9
"""A smaller rotation is ignored."""


@dataclass(frozen=True, slots=True)
class Limits:
    """The limits of each joint: rad/s, rad/s^2, rad/s^3."""

    velocity: Joints
    acceleration: Joints
    jerk: Joints

    def slowed(self, speed: float) -> "Limits":
        """Return the limits for the same motion at `speed` (0 to 1)."""
        return Limits(
            tuple(speed * value for value in self.velocity),
            tuple(speed**2 * value for value in self.acceleration),
            tuple(speed**3 * value for value in self.jerk),
        )


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Position, velocity and acceleration of the joints: rad, rad/s, rad/s^2."""

    positions: Joints
    velocities: Joints
    accelerations: Joints

    @classmethod
    def at_rest(cls, positions: Joints) -> "Setpoint":
        """Return the setpoint of joints at rest."""
        still = (0.0,) * len(positions)
        return cls(positions, still, still)

    @property
    def derivatives(self) -> tuple[Joints, Joints, Joints]:
        """Return positions, velocities and accelerations."""
        return self.positions, self.velocities, self.accelerations

    @property
    def is_at_rest(self) -> bool:
        """Return whether no joint moves or accelerates."""
        return all(abs(value) < NOTHING_RAD for value in (*self.velocities, *self.accelerations))


@dataclass(frozen=True, slots=True)
class _Line:
    """The line from `start` to `target`, parametrized from 0 to 1."""

    start: Joints
    target: Joints

    @property
    def way(self) -> Joints:
        return tuple(end - here for here, end in zip(self.start, self.target, strict=True))

    def along(self, limits: Limits) -> tuple[float, float, float]:
        """Return the limits of the parameter such that no joint exceeds its limits."""
        return (
            min(_allowed(limits.velocity, self.way)),
            min(_allowed(limits.acceleration, self.way)),
            min(_allowed(limits.jerk, self.way)),
        )

    def at(self, place: float, velocity: float, acceleration: float) -> Setpoint:
        way = self.way
        return Setpoint(
            tuple(here + place * distance for here, distance in zip(self.start, way, strict=True)),
            tuple(velocity * distance for distance in way),
            tuple(acceleration * distance for distance in way),
        )


class Course:
    """A motion to its target or, after a pace of 0, to rest. The time is an argument.

    `cruise` are the limits of the motion, `limits` those of the robot, which apply to a stop and to a lower
    pace. Raises `RobotFault` when there is no such motion.
    """

    def __init__(self, start: Joints, target: Joints, cruise: Limits, limits: Limits, began_s: float) -> None:
        self.stopping = False
        self._line = _Line(start, target)
        if not all(map(math.isfinite, (*start, *target))):
            raise RobotFault.translated(
                "robot.no_motion",
                "there is no motion from {start} to {target}: each angle must be a number",
                start=str(start),
                target=str(target),
            )
        self._cruise = cruise
        self._limits = limits
        self._began_s = began_s
        self._pace = 1.0
        self._is_slowing = False
        self._profile: Any = None
        self._duration_s = 0.0
        if any(abs(distance) > NOTHING_RAD for distance in self._line.way):
            self._follow(_to_the_end(self._line.along(cruise)))

    def at(self, now_s: float, *, pace: float = 1.0) -> Setpoint:
        """Return the setpoint at a time, and continue with `pace`, the allowed fraction of the cruise speed.

        The first pace of 0 starts the stop, which later paces do not change. The joints slow down to a lower
        pace within the limits of the robot.
        """
        since_s = min(max(now_s - self._began_s, 0.0), self._duration_s)
        if self.is_over(now_s) and not self.stopping:
            return Setpoint.at_rest(self._line.target)
        place, velocity, acceleration = (values[0] for values in self._profile.at_time(since_s))
        if self.is_over(now_s):
            return Setpoint.at_rest(self._line.at(place, 0.0, 0.0).positions)
        if not self.stopping:
            self._change_pace(now_s, (place, velocity, acceleration), rounded_pace(pace))
        return self._line.at(place, velocity, acceleration)

    def remaining_s(self, now_s: float) -> float:
        """Return the time until the joints are at rest."""
        return max(self._began_s + self._duration_s - now_s, 0.0)

    def is_over(self, now_s: float) -> bool:
        """Return whether the joints are at rest: at the target or, after a stop, on the way."""
        return now_s - self._began_s >= self._duration_s

    def _change_pace(self, now_s: float, state: tuple[float, float, float], pace: float) -> None:
        if pace == 0.0:
            self.stopping = True
            self._began_s = now_s
            self._follow(_to_rest(state, self._line.along(self._limits)))
        elif pace != self._pace:
            self._is_slowing = pace < self._pace
            self._pace = pace
            self._continue(now_s, state, self._limits if self._is_slowing else self._cruise)
        elif self._is_slowing and self._has_slowed(state):
            self._is_slowing = False
            self._continue(now_s, state, self._cruise)

    def _has_slowed(self, state: tuple[float, float, float]) -> bool:
        velocity, acceleration, _ = self._line.along(self._cruise)
        return state[1] <= self._pace * velocity * 1.001 and abs(state[2]) <= acceleration

    def _continue(self, now_s: float, state: tuple[float, float, float], limits: Limits) -> None:
        """Follow a profile to the end at the present pace; one that overshoots the target is not used."""
        velocity = self._line.along(self._cruise)[0]
        _, acceleration, jerk = self._line.along(limits)
        before, before_s = self._profile, self._duration_s
        self._follow(_to_the_end((self._pace * velocity, acceleration, jerk), state))
        reached = self._profile.position_extrema[0]
        if reached.max > 1.0 + 1e-9 or reached.min < state[0] - 1e-9:
            self._profile, self._duration_s = before, before_s
        else:
            self._began_s = now_s

    def _follow(self, inputs: Any) -> None:
        profile = RuckigProfile(1)
        try:
            result = Ruckig(1).calculate(inputs, profile)
        except RuckigError as error:
            raise RobotFault.translated(
                "robot.no_motion_because",
                "there is no motion along {line}: {error}",
                line=str(self._line),
                error=text_of(error),
            ) from error
        if result not in {Result.Working, Result.Finished}:
            raise RobotFault.translated(
                "robot.no_motion_along",
                "there is no motion along {line}: {result}",
                line=str(self._line),
                result=result,
            )
        self._profile, self._duration_s = profile, float(profile.duration)


def rounded_pace(pace: float) -> float:
    """Return a pace rounded down to 2 %, so that small changes cause no new profile; 0 for no number."""
    return math.floor(min(pace, 1.0) * 50 + 1e-9) / 50 if pace > 0 else 0.0


def duration_s(start: Joints, target: Joints, cruise: Limits) -> float:
    """Return the duration of the motion from rest to rest. Raises `RobotFault`."""
    return Course(start, target, cruise, cruise, began_s=0.0).remaining_s(0.0)


def _allowed(limits: Joints, way: Joints) -> list[float]:
    moved = ((limit, abs(distance)) for limit, distance in zip(limits, way, strict=True))
    return [limit / distance for limit, distance in moved if distance > NOTHING_RAD]


def _to_the_end(
    along: tuple[float, float, float], state: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Any:
    inputs = _given(state, along)
    inputs.target_position = [1.0]
    return inputs


def _to_rest(state: tuple[float, float, float], along: tuple[float, float, float]) -> Any:
    inputs = _given(state, along)
    inputs.control_interface = ControlInterface.Velocity
    inputs.target_velocity = [0.0]
    return inputs


def _given(start: tuple[float, float, float], along: tuple[float, float, float]) -> Any:
    inputs = InputParameter(1)
    position, velocity, acceleration = start
    inputs.current_position, inputs.current_velocity = [position], [velocity]
    inputs.current_acceleration = [acceleration]
    inputs.max_velocity, inputs.max_acceleration, inputs.max_jerk = ([value] for value in along)
    return inputs
