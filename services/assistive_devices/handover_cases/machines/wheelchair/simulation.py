"""A simulated wheelchair, and a person who drives it along a course by leaning. Pure.

The chair follows its command with a lag of 0.25 s (motors and mass), on a plane without slip. The person
looks at the next point of the course and leans towards it, with a lag of 0.4 s. Effort has a share that
follows the speed, since balancing costs little, and one that the trial sets: a climb, a load, anxiety.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

LAG_S: Final = 0.25
LEAN_LAG_S: Final = 0.4
COURSE_M: Final = ((0.0, 0.0), (10.0, 0.0), (10.0, 5.0), (0.0, 5.0))
REACHED_M: Final = 0.7
FULL_TURN_RAD: Final = 0.9
"""The angle to the next point at which the person leans sideways as far as possible."""
EFFORT_OF_SPEED: Final = 0.03


@dataclass(frozen=True, slots=True)
class Chair:
    """Place (m), heading (rad) and velocity of the chair."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    linear_mps: float = 0.0
    angular_radps: float = 0.0
    travelled_m: float = 0.0

    def step(self, linear: float, angular: float, dt_s: float) -> "Chair":
        """Return the chair `dt_s` later with a command in m/s and rad/s."""
        share = 1 - math.exp(-dt_s / LAG_S)
        linear_mps = self.linear_mps + share * (linear - self.linear_mps)
        angular_radps = self.angular_radps + share * (angular - self.angular_radps)
        heading = self.heading_rad + angular_radps * dt_s
        middle = (self.heading_rad + heading) / 2
        return Chair(
            self.x_m + linear_mps * math.cos(middle) * dt_s,
            self.y_m + linear_mps * math.sin(middle) * dt_s,
            math.remainder(heading, math.tau),
            linear_mps,
            angular_radps,
            self.travelled_m + abs(linear_mps) * dt_s,
        )


@dataclass(frozen=True, slots=True)
class Driver:
    """The person: `lean` to the right and forwards, -1 to 1."""

    lean: tuple[float, float] = (0.0, 0.0)
    target: int = 1
    strain: float = 0.0
    """Effort beside that of driving."""

    def step(self, chair: Chair, dt_s: float, *, wants_to_drive: bool) -> "Driver":
        """Return the person `dt_s` later."""
        x_m, y_m = COURSE_M[self.target]
        ahead_m = math.dist((x_m, y_m), (chair.x_m, chair.y_m))
        target = (self.target + 1) % len(COURSE_M) if ahead_m < REACHED_M else self.target
        bearing = math.remainder(math.atan2(y_m - chair.y_m, x_m - chair.x_m) - chair.heading_rad, math.tau)
        right = min(max(-bearing / FULL_TURN_RAD, -1.0), 1.0)
        wanted = (right, 1.0) if wants_to_drive else (0.0, 0.0)
        share = 1 - math.exp(-dt_s / LEAN_LAG_S)
        lean = (
            self.lean[0] + share * (wanted[0] - self.lean[0]),
            self.lean[1] + share * (wanted[1] - self.lean[1]),
        )
        return replace(self, lean=lean, target=target)

    def effort(self, chair: Chair) -> float:
        """Return the effort, 0 to 1."""
        return min(self.strain + EFFORT_OF_SPEED * abs(chair.linear_mps), 1.0)
