"""A simulated robot: kinematic, its joints follow the trajectory 125 times a second."""

import time
from collections.abc import Callable
from typing import Self

from handover.runtime.control_cycle import runs_in_cycle
from handover_robots.driver_base.context import Clock, RobotContext
from handover_robots.driver_base.control_thread import ControlThread, Cycles
from handover_robots.driver_base.cyclic_robot import CyclicRobot
from handover_robots.driver_base.position_file import PositionFile
from handover_robots.limits.limiter import Limiter
from handover_robots.model.joints import Joints, JointState
from handover_robots.model.trajectory import Limits, Setpoint

THREAD = "controlThread"


class SimulatedRobot(CyclicRobot):
    """Joints that start at rest at `joints` and a gripper that takes `gripper_s` for an action.

    `something_there` returns whether a gripper that closes at given joints grips an object.
    """

    def __init__(
        self,
        joints: Joints,
        limits: Limits,
        *,
        something_there: Callable[[Joints], bool],
        gripper_closed: bool = False,
        gripper_s: float = 0.3,
        control_hz: float = 125.0,
        clock: Clock | None = None,
        limiter: Limiter | None = None,
        positions: PositionFile | None = None,
        name: str = "robot",
        thread: ControlThread | None = None,
    ) -> None:
        super().__init__(
            joints, limits, limiter=limiter, control_hz=control_hz, clock=clock, name=name, thread=thread
        )
        self._positions = positions
        self._something_there = something_there
        self._gripper_closed = gripper_closed
        self._gripper_s = gripper_s

    @classmethod
    def from_context(cls, context: RobotContext) -> Self:
        """Return the robot of a cell, where it was when the tool stopped."""
        thread = None
        if context.clock is None:
            thread = context.shared.setdefault(THREAD, ControlThread())
        return cls(
            context.joints if context.positions is None else context.positions.open(),
            context.limits,
            something_there=context.is_between_fingers,
            gripper_closed=context.gripper_closed,
            gripper_s=context.gripper_s,
            control_hz=context.settings.control_hz,
            clock=context.clock,
            limiter=context.limiter,
            positions=context.positions,
            name=context.robot_id,
            thread=thread,
        )

    @runs_in_cycle
    def command(self, setpoint: Setpoint) -> None:
        """Keep the setpoint, at which the joints are."""
        if self._positions is not None:
            self._positions.write(setpoint.positions)

    def measured(self) -> JointState:
        """Return the last setpoint."""
        setpoint = self.setpoint
        return JointState(time.time(), setpoint.positions, setpoint.velocities)

    @runs_in_cycle
    def _act(self) -> Cycles[None]:
        yield self.clock.now_s() + self._gripper_s

    @property
    def gripper_closed(self) -> bool:
        """Return whether the gripper is closed."""
        return self._gripper_closed

    async def close_gripper(self) -> bool:
        """Close the gripper; return True when it grips an object."""
        await self.in_cycles(self._act())
        self._gripper_closed = True
        return self._something_there(self.setpoint.positions)

    async def open_gripper(self) -> None:
        """Open the gripper."""
        await self.in_cycles(self._act())
        self._gripper_closed = False
