"""The ports `wish` and `person`: what people want of the robot, and what the hands of a person do.

Everything is a number; a wish that is too old, or not finite, is none.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from handover_humanoid.model.kinematics import Array
from handover_humanoid.patterns.regions import SIDES, Side

PLANNED_JOINTS: Final = 8
"""The most joints of an arm that throws."""
MAX_SPEED: Final = 10.0
"""Of a velocity that is wanted, in m/s or rad/s; what the robot can do is far below."""

WISH: Final = (
    "ahead_mps",
    "left_mps",
    "yaw_radps",
    "behaviour",
    "speed_share",
    "stop",
    "cancel",
    "throw_number",
    "hand",
    "target_x_m",
    "target_y_m",
    "target_z_m",
    "flight_s",
    "swing_s",
    "follow_s",
    *(f"release_{index}_rad" for index in range(PLANNED_JOINTS)),
    *(f"velocity_{index}_radps" for index in range(PLANNED_JOINTS)),
)
"""`hand` is 0 for left and 1 for right. The target is in the frame between the soles: ahead, to the left, up.
The joints of the throwing arm at the release, and their velocities, are in the order of its chain."""

PERSON: Final = tuple(
    f"{side}.{name}"
    for side in SIDES
    for name in ("held", "x_m", "y_m", "z_m", "force_x_n", "force_y_n", "force_z_n")
)
"""By the hand of the robot. `held`: 0 not, 1 by a hand at a place, 2 with a force; both in the frame between
the soles."""


@dataclass(slots=True)
class Wanted:
    """A wish, read."""

    ahead_mps: float = 0.0
    left_mps: float = 0.0
    yaw_radps: float = 0.0
    behaviour: int = 0
    speed_share: float = 0.0
    stop: bool = False
    cancel: bool = False
    throw_number: float = 0.0
    side: Side = "right"
    target: Array = field(default_factory=lambda: np.zeros(3))
    flight_s: float = 0.0
    swing_s: float = 0.0
    follow_s: float = 0.0
    release: Array = field(default_factory=lambda: np.zeros(PLANNED_JOINTS))
    velocity: Array = field(default_factory=lambda: np.zeros(PLANNED_JOINTS))

    @classmethod
    def of(cls, values: Array) -> "Wanted":
        """Return the wish of the values of `WISH`."""
        ahead, left, yaw, behaviour, share, stop, cancel, number, hand = values[:9].tolist()
        ahead, left, yaw = (min(max(speed, -MAX_SPEED), MAX_SPEED) for speed in (ahead, left, yaw))
        flight_s, swing_s, follow_s = values[12:15].tolist()
        return cls(
            ahead,
            left,
            yaw,
            int(behaviour),
            min(max(share, 0.0), 1.0),
            stop != 0,
            cancel != 0,
            number,
            SIDES[1 if hand else 0],
            values[9:12].copy(),
            flight_s,
            swing_s,
            follow_s,
            values[15 : 15 + PLANNED_JOINTS].copy(),
            values[15 + PLANNED_JOINTS :].copy(),
        )
