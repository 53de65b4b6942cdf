"""A robot behind ROS 2: its trajectory controller follows the plan of the tool through the ROS bridge.

The bridge maintains a Device of the arm (`jointNames`, `jointPositions`, `jointVelocities`) and executes
three kinds of Tasks: `followTrajectory`, `closeGripper`, `openGripper` (the mapping `arm`). The tool plans as
for its own robots: a straight line in joint space within the limits. A motion starts only from current joint
positions.
"""

import asyncio
import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Self

from fastapi import FastAPI, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from handover.broker import BrokerClient, BrokerError, NotFound
from handover.errors import UsageError
from handover.messages import message
from handover.notifications import NotificationReceiver
from handover.resync import Resync
from handover.telemetry import get_logger
from services.trajectory_tool.drivers import RobotContext
from services.trajectory_tool.joint_trajectory import JointTrajectory
from services.trajectory_tool.metrics import MOTION_SECONDS
from services.trajectory_tool.orders import Ended, Orders
from services.trajectory_tool.robot import Joints, JointState, Pace, Robot, RobotFault, StopCategory
from services.trajectory_tool.trajectory import Course, Limits, Setpoint, duration_s

log = get_logger(__name__)

MAX_AGE_S = 15.0
"""Older joint positions do not count as known."""
JOINTS_TIMEOUT_S = 10.0
STEP_S, MAX_POINTS = 0.1, 200
"""A trajectory has a point every 100 ms, and no more than 200."""
START_TOLERANCE_RAD = 0.02
"""A planned motion starts only from joints this near to its start."""
CHECK_EVERY_S = 0.02
LOWER_PACE = 0.8
"""A motion stops, and can be continued, when its pace is below this fraction of the pace at its start."""
STILL_S, STILL_RAD, STILL_RAD_S = 0.3, 0.003, 0.02
"""An arm is at rest when its joints turn slower, or have turned no further for 0.3 s."""
REST_TIMEOUT_S = 10.0


@dataclass(frozen=True, slots=True)
class _Motion:
    """A running motion: a straight line in joint space."""

    start: Joints
    target: Joints
    planned_s: float

    def remaining_s(self, positions: Joints) -> float:
        left = _distance_rad(positions, self.target) / _distance_rad(self.start, self.target)
        return max(self.planned_s * min(left, 1.0), 0.01)


class RosOptions(BaseModel):
    """The settings of the driver: the Device of the arm that the bridge moves."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    arm: str = Field("arm-1", pattern=r"^[A-Za-z0-9_.:-]+$")


class RosRobot(Robot):
    """The arm with the Device `arm` of its options; the stored joints are used until the first report."""

    def __init__(self, context: RobotContext, broker: BrokerClient) -> None:
        settings, joints, robot = context.settings, context.joints, context.robot_id
        self.arm = settings.entity_id("Device", context.read_options(RosOptions).arm)
        self._joint_names = context.model.joint_names
        self._limits: Limits = context.limits
        self._broker = broker
        self._notify_path = f"/notifications/{robot}/arm"
        self._notify_url = f"{settings.service_url}{self._notify_path}"
        self._subscription_id = settings.entity_id("Subscription", f"{robot}-arm")
        self._receiver = NotificationReceiver(f"trajectory-tool-{robot}-arm", settings, broker)
        self._orders = Orders(robot, self.arm, settings, broker)
        self._state = JointState(time.time(), joints, (0.0,) * len(joints))
        self._stamp = ""
        self._reported_s: float | None = None
        self._gripper_closed = context.gripper_closed
        self._gripper_s = context.gripper_s
        self._resync = Resync(self._try_reconcile, settings.reconcile_s)
        self._resync_task: asyncio.Task[None] | None = None
        self._ready = asyncio.Event()
        self._in_motion = asyncio.Lock()
        self._stop_requested = False
        self._motion: _Motion | None = None
        self._fault = f"the ROS bridge has not reported {self.arm} yet"

    @classmethod
    def from_context(cls, context: RobotContext) -> Self:
        """Return the robot of a cell; raise `UsageError` without a broker."""
        if context.broker is None:
            raise UsageError("a robot behind ROS is reached through the broker; start it with one")
        return cls(context, context.broker)

    def mount(self, app: FastAPI) -> None:
        """Add the route for notifications about the arm and orders."""

        @app.post(self._notify_path, status_code=204, tags=["notifications"])
        async def notify(request: Request) -> Response:
            """Read changed joints from the broker, and check changed orders."""
            for notified in await self._receiver.receive(request):
                if notified.get("id") == self.arm:
                    await self._read_joints()
                else:
                    self._orders.wake()
            return Response(status_code=204)

    async def __aenter__(self) -> Self:
        self._receiver.require_key()
        self._resync_task = asyncio.create_task(self._resync.run())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._resync_task is not None:
            self._resync_task.cancel()
            with suppress(asyncio.CancelledError):
                await self._resync_task

    def state(self) -> JointState:
        """Return the last reported joints."""
        return self._state

    def remaining_s(self) -> float:
        """Return the remaining time of the motion from the present joints; 0 at rest.

        It is constant while the joints do not move, and so is the progress of the Task.
        """
        return 0.0 if self._motion is None else self._motion.remaining_s(self._state.positions)

    def estimate_s(self, start: Joints, target: Joints, speed: float) -> float:
        """Return the duration of a motion from rest to rest."""
        return duration_s(start, target, self._limits.slowed(speed))

    async def move(self, target: Joints, speed: float, pace: Pace) -> bool:
        """Have the arm follow a trajectory to `target`; see `Robot.move`."""
        start = await self._current_joints()
        cruise = self._limits.slowed(speed)
        course = Course(start, target, cruise, self._limits, began_s=0.0)
        return await self._execute(start, target, course.at, course.remaining_s(0.0), pace)

    async def follow(self, trajectory: JointTrajectory, pace: Pace) -> bool:
        """Have the arm follow a planned trajectory; see `Robot.follow`."""
        start = await self._current_joints()
        away_rad = max(abs(a - b) for a, b in zip(start, trajectory.start, strict=True))
        if away_rad > START_TOLERANCE_RAD:
            raise RobotFault(
                message(
                    "robot.moved_since_planned",
                    "{arm} has moved by {angle} rad since the motion was planned; send the Task again",
                    arm=self.arm,
                    angle=f"{away_rad:.3f}",
                )
            )
        return await self._execute(start, trajectory.target, trajectory.at, trajectory.duration_s, pace)

    async def _execute(
        self,
        start: Joints,
        target: Joints,
        at: Callable[[float], Setpoint],
        planned_s: float,
        pace: Pace,
    ) -> bool:
        """Follow a motion at the pace of its start; a much lower pace on the way stops it."""
        if self._in_motion.locked():
            raise RobotFault(
                message(
                    "robot.in_motion",
                    "the robot is in motion; wait for its end or stop it before another motion",
                )
            )
        if planned_s == 0.0 or start == target:
            return True
        async with self._in_motion:
            self._stop_requested = False
            rate = min(pace(), 1.0)
            if not rate > 0:
                return False
            motion = _Motion(start, target, planned_s / rate)
            return await self._follow(motion, at_rate(at, rate), pace, rate)

    async def _follow(
        self, motion: _Motion, at: Callable[[float], Setpoint], pace: Pace, rate: float
    ) -> bool:
        order = await self._orders.give(
            "followTrajectory",
            jointNames=list(self._joint_names),
            points=points(at, motion.planned_s),
            durationS=motion.planned_s,
        )
        began_s = time.monotonic()
        self._motion = motion
        try:

            def may_go() -> bool:
                return not self._stop_requested and pace() > LOWER_PACE * rate

            ended = await self._supervise(order, may_go, 2 * motion.planned_s + 10)
            if not ended.completed and not ended.cancelled:
                raise RobotFault(
                    message(
                        "robot.trajectory_not_followed",
                        "{arm} did not follow the trajectory: {reason}",
                        arm=self.arm,
                        reason=ended.reason,
                    )
                )
            await self._rest()
        except asyncio.CancelledError:
            await asyncio.shield(self._orders.cancel(order))
            raise
        finally:
            self._motion = None
            MOTION_SECONDS.inc(time.monotonic() - began_s)
        return ended.completed

    async def stop(self, category: StopCategory) -> None:
        """Cancel the goal of the arm, and return at rest; see `Robot.stop`. ROS cannot remove the power."""
        self._stop_requested = True
        async with self._in_motion:
            pass
        if category == 1:
            raise RobotFault(
                message(
                    "robot.driver_has_no_power",
                    "{arm} has been stopped, and its power cannot be removed through ROS; switch it off at "
                    "its controller",
                    arm=self.arm,
                )
            )

    async def close_gripper(self) -> bool:
        """Close the gripper; return True when an object stopped it."""
        ended = await self._grip("closeGripper")
        self._gripper_closed = True
        stalled = ended.outputs.get("stalled") is True
        if not ended.completed and not stalled:
            raise RobotFault(
                message(
                    "robot.gripper_did_not_close",
                    "the gripper of {arm} did not close: {reason}",
                    arm=self.arm,
                    reason=ended.reason,
                )
            )
        return stalled

    async def open_gripper(self) -> None:
        """Open the gripper."""
        ended = await self._grip("openGripper")
        if not ended.completed:
            raise RobotFault(
                message(
                    "robot.gripper_did_not_open",
                    "the gripper of {arm} did not open: {reason}",
                    arm=self.arm,
                    reason=ended.reason,
                )
            )
        self._gripper_closed = False

    @property
    def gripper_closed(self) -> bool:
        """Return whether the last command closed the gripper."""
        return self._gripper_closed

    async def _grip(self, operation: str) -> Ended:
        await self._current_joints()
        order = await self._orders.give(operation)
        return await self._orders.end_of(order, self._gripper_s + 20)

    async def _supervise(self, order: str, may_go: Callable[[], bool], within_s: float) -> Ended:
        """Wait for the end of a motion, and cancel it once it may not continue."""
        end = asyncio.ensure_future(self._orders.end_of(order, within_s))
        stopping = False
        began_s = time.monotonic()
        try:
            while not end.done():
                silent_s = time.monotonic() - max(began_s, self._reported_s or began_s)
                if silent_s > MAX_AGE_S:
                    await self._orders.cancel(order)
                    await asyncio.wait({end}, timeout=REST_TIMEOUT_S)
                    raise RobotFault(
                        f"the joints of {self.arm} have not been reported for {silent_s:.0f} s while it "
                        "should move, and its goal was cancelled; check the arm, its driver and the ROS "
                        "bridge"
                    )
                await asyncio.wait({end}, timeout=CHECK_EVERY_S if not stopping else 1.0)
                if not stopping and not end.done() and not may_go():
                    stopping = True
                    await self._orders.cancel(order)
            return end.result()
        finally:
            end.cancel()

    async def _rest(self) -> None:
        """Wait until the reported joints are at rest. Raises `RobotFault`."""
        before, since_s = self._state, time.monotonic()
        deadline_s = since_s + REST_TIMEOUT_S
        while time.monotonic() < deadline_s:
            await asyncio.sleep(CHECK_EVERY_S)
            now = self._state
            if now is not before and max(map(abs, now.velocities)) < STILL_RAD_S:
                return
            if _distance_rad(now.positions, before.positions) > STILL_RAD:
                before, since_s = now, time.monotonic()
            elif time.monotonic() - since_s >= STILL_S:
                return
        raise RobotFault(
            message(
                "robot.not_at_rest",
                "{arm} was stopped and is not at rest; check it",
                arm=self.arm,
            )
        )

    async def _current_joints(self) -> Joints:
        """Return the current joints from the broker. Raises `RobotFault` when they are unknown."""
        with suppress(TimeoutError):
            async with asyncio.timeout(JOINTS_TIMEOUT_S):
                await self._ready.wait()
                while True:
                    if await self._look() and self._is_fresh():
                        return self._state.positions
                    await asyncio.sleep(0.2)
        raise RobotFault(
            message(
                "robot.joints_unknown",
                "the joints of {arm} are unknown: {fault}; start its driver, and the "
                "ROS bridge with a mapping that reports them (handover bridge check arm)",
                arm=self.arm,
                fault=self._fault,
            )
        )

    def _is_fresh(self) -> bool:
        fresh = self._reported_s is not None and time.monotonic() - self._reported_s < MAX_AGE_S
        if not fresh and self._reported_s is not None:
            self._fault = f"the last report is {time.monotonic() - self._reported_s:.0f} s old"
        return fresh

    # Reports about the arm

    async def _try_reconcile(self) -> bool:
        """Ensure the subscriptions, end old orders and read the arm."""
        try:
            await self._broker.ensure_subscription(self._subscription())
            await self._broker.ensure_subscription(self._orders.subscription(self._endpoint()))
            if not self._ready.is_set():
                await self._orders.end_old()
                self._ready.set()
            return await self._look()
        except RobotFault as fault:
            self._fault = str(fault)
            return False
        except BrokerError as error:
            self._fault = f"the broker is unavailable: {error}"
            log.warning("arm not read", arm=self.arm, error=str(error))
            return False

    async def _look(self) -> bool:
        try:
            self._take(await self._broker.retrieve(self.arm))
        except NotFound:
            self._fault = "the broker has no such Device"
        except BrokerError as error:
            self._fault = f"the broker is unavailable: {error}"
            return False
        return True

    async def _read_joints(self) -> None:
        """Read the arm from the broker; one query serves all notifications that arrive meanwhile."""
        try:
            for entity in await self._receiver.read("Device", [self.arm]):
                self._take(entity)
        except BrokerError as error:
            log.warning("arm not read", arm=self.arm, error=str(error))
            self._resync.request()

    def _take(self, entity: Mapping[str, Any]) -> None:
        """Apply the joints that the bridge has written; older ones are ignored."""
        positions = _value(entity, "jointPositions")
        names = _value(entity, "jointNames")
        stamp = str(entity.get("jointPositions", {}).get("observedAt", ""))
        if stamp <= self._stamp:
            return
        try:
            reported = in_order(self._joint_names, names, positions)
            velocities = _value(entity, "jointVelocities")
            turning = in_order(self._joint_names, names, velocities) if velocities else (0.0,) * len(reported)
        except RobotFault as fault:
            self._fault = str(fault)
            return
        if self._stamp:  # the positions of the first read may be old
            self._reported_s = time.monotonic()
        self._stamp = stamp
        self._state = JointState(time.time(), reported, turning)

    def _subscription(self) -> dict[str, Any]:
        return {
            "id": self._subscription_id,
            "type": "Subscription",
            "description": f"The joints of {self.arm}",
            "entities": [{"id": self.arm, "type": "Device"}],
            "watchedAttributes": ["jointPositions"],
            "notification": {
                "attributes": ["jointNames", "jointPositions", "jointVelocities"],
                "endpoint": self._endpoint(),
            },
        }

    def _endpoint(self) -> dict[str, Any]:
        return self._receiver.endpoint(self._notify_url)


def at_rate(at: Callable[[float], Setpoint], rate: float) -> Callable[[float], Setpoint]:
    """Return the same motion with its time at `rate`."""

    def slowed(time_s: float) -> Setpoint:
        setpoint = at(time_s * rate)
        return Setpoint(
            setpoint.positions,
            tuple(rate * value for value in setpoint.velocities),
            tuple(rate**2 * value for value in setpoint.accelerations),
        )

    return slowed


def points(at: Callable[[float], Setpoint], whole_s: float) -> list[dict[str, Any]]:
    """Return the points of a trajectory for a controller; the last one, after `whole_s`, is at rest.

    Each has `positions` in rad, `velocities` in rad/s, `accelerations` in rad/s^2 and `time_from_start`.
    """
    count = min(max(math.ceil(whole_s / STEP_S), 1), MAX_POINTS)
    points = []
    for number in range(1, count + 1):
        at_s = whole_s * number / count
        setpoint = at(at_s)
        points.append(
            {
                "positions": [round(value, 6) for value in setpoint.positions],
                "velocities": [round(value, 6) for value in setpoint.velocities],
                "accelerations": [round(value, 6) for value in setpoint.accelerations],
                "time_from_start": {"sec": int(at_s), "nanosec": int(at_s % 1 * 1e9)},
            }
        )
    return points


def in_order(joint_names: Sequence[str], names: Any, values: Any) -> Joints:
    """Return the values of the joints `joint_names` from values by name. Raises `RobotFault`.

    Drivers report the joints of a gripper, or of a second arm, in the same message, in any order.
    """
    if not isinstance(names, Sequence) or not isinstance(values, Sequence) or len(names) != len(values):
        raise RobotFault(
            message(
                "robot.joint_count_differs",
                "{names} joint names and {values} values are reported",
                names=len(names or ()),
                values=len(values or ()),
            )
        )
    by_name = dict(zip(names, values, strict=True))
    missing = [name for name in joint_names if not isinstance(by_name.get(name), int | float)]
    if missing:
        raise RobotFault(
            message(
                "robot.joints_missing",
                "{missing} are not reported; the reported joints are {given}",
                missing=", ".join(missing),
                given=", ".join(by_name),
            )
        )
    return tuple(float(by_name[name]) for name in joint_names)


def _value(entity: Mapping[str, Any], attribute: str) -> Any:
    found = entity.get(attribute)
    return found.get("value") if isinstance(found, Mapping) else None


def _distance_rad(some: Joints, others: Joints) -> float:
    return max(abs(first - second) for first, second in zip(some, others, strict=True))
