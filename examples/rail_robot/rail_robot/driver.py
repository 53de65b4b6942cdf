"""A driver whose joints move at a constant speed: the smallest complete driver."""

import asyncio
import time
from typing import Self

from services.trajectory_tool.drivers import RobotContext
from services.trajectory_tool.robot import Joints, JointState, Pace, Robot

CYCLE_S = 0.02


class SteadyRobot(Robot):
    """Simulated joints of any robot model; `context` has the model, the stored state and the limits."""

    def __init__(self, context: RobotContext) -> None:
        self._positions = context.joints
        self._velocities = (0.0,) * len(context.joints)
        self._max_speeds = context.limits.velocity
        self._is_closed = context.gripper_closed
        self._is_between_fingers = context.is_between_fingers
        self._remaining_s = 0.0

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self._velocities = (0.0,) * len(self._positions)

    def state(self) -> JointState:
        return JointState(time.time(), self._positions, self._velocities)

    def remaining_s(self) -> float:
        return self._remaining_s

    def estimate_s(self, start: Joints, target: Joints, speed: float) -> float:
        return max(
            abs(there - here) / (limit * speed)
            for here, there, limit in zip(start, target, self._max_speeds, strict=True)
        )

    async def move(self, target: Joints, speed: float, pace: Pace) -> bool:
        while (remaining_s := self.estimate_s(self._positions, target, speed)) > 0:
            allowed = min(pace(), 1.0)
            if not allowed > 0:
                break
            self._step(target, min(allowed * CYCLE_S / remaining_s, 1.0))
            self._remaining_s = remaining_s
            await asyncio.sleep(CYCLE_S)
        self._velocities = (0.0,) * len(self._positions)
        self._remaining_s = 0.0
        return self._positions == target

    def _step(self, target: Joints, share: float) -> None:
        """Move every joint by `share` of what is left; a driver sends the positions to the robot here."""
        before = self._positions
        self._positions = (
            target
            if share == 1.0
            else tuple(here + share * (there - here) for here, there in zip(before, target, strict=True))
        )
        self._velocities = tuple(
            (after - here) / CYCLE_S for here, after in zip(before, self._positions, strict=True)
        )

    async def close_gripper(self) -> bool:
        self._is_closed = True
        return self._is_between_fingers(self._positions)

    async def open_gripper(self) -> None:
        self._is_closed = False

    @property
    def gripper_closed(self) -> bool:
        return self._is_closed
