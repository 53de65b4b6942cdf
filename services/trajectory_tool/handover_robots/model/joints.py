"""The joints of a robot at one time, and functions that say how they may move."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

Joints = tuple[float, ...]
"""The joint positions of a robot from its base to its flange: rad, for prismatic joints m."""

Pace = Callable[[], float]
"""Returns the allowed fraction of the speed of a motion, from 0 (stop) to 1.

Each control cycle calls it, possibly from another thread; it is cheap.
"""

Velocity = Callable[[], Joints]
"""Returns the commanded velocities of the joints: rad/s, for prismatic joints m/s; called like `Pace`."""


@dataclass(frozen=True, slots=True)
class JointState:
    """The joints at one time: `stamp_s` in s since 1970, positions in rad, velocities in rad/s.

    `efforts` are torques in Nm, measured or computed by the controller; None where it reports none.
    Prismatic joints: m, m/s, N.
    """

    stamp_s: float
    positions: Joints
    velocities: Joints
    efforts: Joints | None = None

    def written(self, names: Sequence[str]) -> dict[str, Any]:
        """Return it as JSON: `stamp` in s since 1970, rad, rad/s and Nm (m, m/s and N)."""
        written: dict[str, Any] = {
            "stamp": round(self.stamp_s, 6),
            "name": names,
            "position": [round(value, 6) for value in self.positions],
            "velocity": [round(value, 6) for value in self.velocities],
        }
        if self.efforts is not None:
            written["effort"] = self.efforts
        return written
