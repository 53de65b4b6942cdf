"""A driver in thirty lines: each control cycle gives a setpoint to the controller of an arm."""

import time

from handover_robots.driver_base.context import RobotContext
from handover_robots.driver_base.cyclic_robot import CyclicRobot
from handover_robots.model.joints import JointState
from handover_robots.model.trajectory import Setpoint
from rail_robot.controller import Controller


class SteadyRobot(CyclicRobot):
    """An arm behind a `Controller`; `context` has the model, the limits and the stored state."""

    def __init__(self, context: RobotContext) -> None:
        super().__init__(context.joints, context.limits, limiter=context.limiter, clock=context.clock)
        self.controller = Controller(context.joints, is_closed=context.gripper_closed)
        self._is_between_fingers = context.is_between_fingers

    def command(self, setpoint: Setpoint) -> None:
        self.controller.go_to(setpoint.positions, setpoint.velocities)

    def measured(self) -> JointState:
        return JointState(time.time(), *self.controller.joints)

    async def close_gripper(self) -> bool:
        self.controller.is_closed = True
        return self._is_between_fingers(self.state().positions)

    async def open_gripper(self) -> None:
        self.controller.is_closed = False

    @property
    def gripper_closed(self) -> bool:
        return self.controller.is_closed
