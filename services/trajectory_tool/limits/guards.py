"""Guards of the limiter: what depends on the place of the arm, not on a joint alone.

`CollisionGuard` uses the collision model of motion planning, `ToolSpeedGuard` the speed of the tool. Each is
used by one thread, and sees the configurations that the joints pass on their way to rest.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from services.trajectory_tool.obstacles import World
from services.trajectory_tool.planning import is_available
from services.trajectory_tool.robot import Joints
from services.trajectory_tool.robot_model import RobotModel
from services.trajectory_tool.trajectory import Setpoint

MARGIN_M = 0.002
LADDER_M = tuple(0.004 * 2.0**step for step in range(9))
"""The travels that one query certifies; each has its own set of requests."""
FORWARD_S = 1e-4
RESERVE = 0.95
"""The fraction of the limit of the tool that is used, since a way to rest is checked at samples."""


class Guard(Protocol):
    """A rule for setpoints."""

    def start(self, joints: Joints) -> None:
        """Begin a motion at rest at `joints`."""

    def violation(self, setpoint: Setpoint) -> str | None:
        """Return why a setpoint of a planned motion is refused; None if it is permitted."""

    def permits_stop(self, stop: Sequence[Setpoint]) -> bool:
        """Return whether a way to rest is permitted; the first setpoint is the next to be commanded."""


class CollisionGuard:
    """The robot touches neither itself nor its surroundings.

    A motion that begins in contact may leave it. `world` is read at the start of each motion. Needs the extra
    `motion`.
    """

    def __init__(self, model: RobotModel, world: Callable[[], World]) -> None:
        self._model = model
        self._world = world
        self._collisions: Any = None
        self._is_leaving = False

    def start(self, joints: Joints) -> None:
        """Begin a motion; take the present surroundings."""
        from services.trajectory_tool.planning.arm import Arm  # noqa: PLC0415 - needs the extra
        from services.trajectory_tool.planning.collision import Collisions  # noqa: PLC0415

        world = self._world()
        if self._collisions is None or self._collisions.world != world:
            self._collisions = Collisions(Arm(self._model), world)
        self._is_leaving = not self._collisions.is_free(np.array(joints))

    def violation(self, setpoint: Setpoint) -> str | None:
        """Return what touches."""
        joints = np.array(setpoint.positions)
        is_free = self._collisions.is_free(joints)
        if is_free or self._is_leaving:
            self._is_leaving = not is_free
            return None
        nearest = self._collisions.closest(joints)
        return f"{nearest.first} would touch {nearest.second}"

    def permits_stop(self, stop: Sequence[Setpoint]) -> bool:
        """Return whether the way to rest is free, with what lies between its setpoints."""
        if self._is_leaving:
            self._is_leaving = not self._collisions.is_free(np.array(stop[0].positions))
            return True
        path = np.array([setpoint.positions for setpoint in stop])
        return self._is_free(path) or all(
            self._is_free(path[number : number + 2]) for number in range(len(path) - 1)
        )

    def _is_free(self, path: Any) -> bool:
        """Return whether every configuration between the extremes of `path` is free, by one query."""
        lower, upper = path.min(axis=0), path.max(axis=0)
        travel_m = float(self._collisions.reach @ (upper - lower)) / 2
        covering = next((step for step in LADDER_M if step >= travel_m), None)
        if covering is None:
            return False
        return bool(self._collisions.is_free_within((lower + upper) / 2, covering, MARGIN_M))


class ToolSpeedGuard:
    """The tool moves at `max_mps()` at most; faster at the time of a lower limit, it gets no faster.

    It governs commanded velocities. A planned motion is slowed down as a whole, by its pace.
    """

    def __init__(self, model: RobotModel, max_mps: Callable[[], float]) -> None:
        self._model = model
        self._max_mps = max_mps
        self._speed_mps = 0.0
        self._arm: Any = None

    def start(self, joints: Joints) -> None:  # noqa: ARG002
        """Begin a motion at rest."""
        self._speed_mps = 0.0
        if self._arm is None and is_available() and self._max_mps() < math.inf:
            from services.trajectory_tool.planning.arm import Arm  # noqa: PLC0415 - needs the extra

            self._arm = Arm(self._model)

    def violation(self, setpoint: Setpoint) -> None:
        """Permit every setpoint of a planned motion."""
        if self._max_mps() < math.inf:
            self._speed_mps = self._tool_speed_mps(setpoint)

    def permits_stop(self, stop: Sequence[Setpoint]) -> bool:
        """Return whether the tool is slow enough on its way to rest."""
        limit_mps = self._max_mps()
        if limit_mps == math.inf:
            return True
        is_slow = self._speed_mps <= limit_mps
        allowed_mps = limit_mps * RESERVE if is_slow else self._speed_mps * (1 + 1e-9)
        return all(self._tool_speed_mps(each) <= allowed_mps for each in stop)

    def _tool_speed_mps(self, setpoint: Setpoint) -> float:
        if self._arm is None:
            return tool_speed_mps(self._model, setpoint)
        return float(self._arm.tool_speed_mps(np.array(setpoint.positions), np.array(setpoint.velocities)))


def tool_speed_mps(model: RobotModel, setpoint: Setpoint) -> float:
    """Return the speed of the tip of the tool."""
    if not any(setpoint.velocities):
        return 0.0
    soon = tuple(
        position + FORWARD_S * velocity
        for position, velocity in zip(setpoint.positions, setpoint.velocities, strict=True)
    )
    return model.tool_pose(setpoint.positions).distance_m(model.tool_pose(soon)) / FORWARD_S
