"""A simulated robot: kinematic, its joints follow the trajectory 125 times a second.

The control cycles run in a separate thread, so that HTTP requests do not delay them.
"""

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from typing import Self, TypeVar

from handover.messages import message
from services.trajectory_tool.drivers import Clock, RobotContext
from services.trajectory_tool.joint_trajectory import JointTrajectory
from services.trajectory_tool.metrics import MOTION_SECONDS, OVERRUNS
from services.trajectory_tool.planned_course import PlannedCourse
from services.trajectory_tool.robot import Joints, JointState, Robot, RobotFault
from services.trajectory_tool.trajectory import Course, Limits, Setpoint, duration_s

T = TypeVar("T")


class SimulatedRobot(Robot):
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
    ) -> None:
        self._limits = limits
        self._something_there = something_there
        self._gripper_closed = gripper_closed
        self._gripper_s = gripper_s
        self._cycle_s = 1.0 / control_hz
        self._clock = clock or Clock()
        self._setpoint = Setpoint.at_rest(joints)
        self._course: Course | PlannedCourse | None = None
        self._switched_off = Event()
        self._control = ThreadPoolExecutor(max_workers=1, thread_name_prefix="robot-control")

    @classmethod
    def from_context(cls, context: RobotContext) -> Self:
        """Return the robot of a cell."""
        return cls(
            context.joints,
            context.limits,
            something_there=context.is_between_fingers,
            gripper_closed=context.gripper_closed,
            gripper_s=context.gripper_s,
            control_hz=context.settings.control_hz,
            clock=context.clock,
        )

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self._switched_off.set()
        await asyncio.to_thread(self._control.shutdown)

    def state(self) -> JointState:
        """Return the present joints."""
        setpoint = self._setpoint
        return JointState(time.time(), setpoint.positions, setpoint.velocities)

    def remaining_s(self) -> float:
        """Return the remaining time of the motion."""
        course = self._course
        return 0.0 if course is None else course.remaining_s(self._clock.now_s())

    def estimate_s(self, start: Joints, target: Joints, speed: float) -> float:
        """Return the duration of a motion from rest to rest."""
        return duration_s(start, target, self._limits.slowed(speed))

    @property
    def gripper_closed(self) -> bool:
        """Return whether the gripper is closed."""
        return self._gripper_closed

    async def move(self, target: Joints, speed: float, may_go: Callable[[], bool]) -> bool:
        """Move to `target`; return False if it stopped on the way because of `may_go`."""
        cruise = self._limits.slowed(speed)

        def course(began_s: float) -> Course:
            return Course(self._setpoint.positions, target, cruise, self._limits, began_s)

        return await self._run(course, may_go)

    async def follow(self, trajectory: JointTrajectory, may_go: Callable[[], bool]) -> bool:
        """Follow a trajectory; return False if it stopped on the way because of `may_go`."""
        return await self._run(lambda began_s: PlannedCourse(trajectory, self._limits, began_s), may_go)

    async def _run(
        self, course: Callable[[float], Course | PlannedCourse], may_go: Callable[[], bool]
    ) -> bool:
        given_up = Event()

        def unhindered() -> bool:
            return may_go() and not given_up.is_set() and not self._switched_off.is_set()

        return await self._in_control(lambda: self._drive(course, unhindered), given_up.set)

    async def close_gripper(self) -> bool:
        """Close the gripper; return True when it grips an object."""
        await self._in_control(lambda: self._clock.wait_s(self._gripper_s))
        self._gripper_closed = True
        return self._something_there(self._setpoint.positions)

    async def open_gripper(self) -> None:
        """Open the gripper."""
        await self._in_control(lambda: self._clock.wait_s(self._gripper_s))
        self._gripper_closed = False

    async def _in_control(self, work: Callable[[], T], give_up: Callable[[], None] | None = None) -> T:
        """Run `work` in the control thread; a cancelled caller waits until the robot is at rest."""
        if self._switched_off.is_set():
            raise RobotFault(
                message(
                    "robot.switched_off",
                    "the robot is switched off; start the trajectory tool again",
                )
            )
        doing = asyncio.get_running_loop().run_in_executor(self._control, work)
        try:
            return await asyncio.shield(doing)
        except asyncio.CancelledError:
            if give_up is not None:
                give_up()
            await asyncio.wait([doing])
            raise

    def _drive(self, make: Callable[[float], Course | PlannedCourse], may_go: Callable[[], bool]) -> bool:
        began_s = now_s = self._clock.now_s()
        self._course = course = make(began_s)
        due_s = began_s
        try:
            while True:
                self._setpoint = course.at(now_s, may_go=may_go())
                if course.is_over(now_s):
                    return not course.stopping
                due_s = self._next_cycle(due_s)
                self._clock.wait_s(max(due_s - self._clock.now_s(), 0.0))
                now_s = self._clock.now_s()
        finally:
            self._course = None
            MOTION_SECONDS.inc(self._clock.now_s() - began_s)

    def _next_cycle(self, due_s: float) -> float:
        """Return when the next cycle is due; late cycles are counted and skipped."""
        due_s += self._cycle_s
        missed = int((self._clock.now_s() - due_s) / self._cycle_s)
        if missed > 0:
            OVERRUNS.inc(missed)
            due_s += missed * self._cycle_s
        return due_s
