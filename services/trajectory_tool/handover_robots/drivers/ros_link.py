"""The connection to an arm behind the ROS bridge; it reconnects by itself.

The messages are those of `handover_datamodels.arm_stream`. The control thread calls `follow`, `cancel` and
`velocity`; the event loop sends.
"""

import asyncio
import itertools
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from pydantic import BaseModel, ValidationError
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidURI, WebSocketException

from handover.broker import Credentials
from handover.control.limit_link import exchange
from handover.errors import HandoverError
from handover.messages import text_of
from handover.runtime.retry import Backoff
from handover.telemetry import get_logger
from handover_datamodels.arm_stream import (
    ARM_REPORTS,
    ArmCancel,
    ArmGoal,
    ArmJoints,
    ArmSetup,
    ArmVelocity,
    GoalAccepted,
    GoalEnd,
    TrajectoryPoint,
)
from handover_datamodels.robot_messages import StreamRefusal
from handover_robots.model.faults import RobotFault
from handover_robots.model.joints import Joints, JointState

log = get_logger(__name__)

OPEN_TIMEOUT_S = 5.0
END_TIMEOUT_S = 2.0


class RosLink:
    """The arm of `setup` behind the bridge at `url`; it connects with `credentials`."""

    def __init__(self, url: str, setup: ArmSetup, credentials: Credentials | None = None) -> None:
        self.url = url
        self.setup = setup
        self._credentials = credentials
        self.fault = f"the ROS bridge at {url} has not answered yet"
        """Why there are no joints."""
        self.joints: JointState | None = None
        """The last reported joints."""
        self.reported_s = float("-inf")
        """When they were received, on the monotonic clock."""
        self._accepted = 0
        self._ends: dict[int, GoalEnd] = {}
        self._numbers = itertools.count(1)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._socket: ClientConnection | None = None
        self._connection = 0
        """Counts connections; a goal ends with its connection."""
        self._goal_connection = 0
        self._outgoing: asyncio.Queue[BaseModel] = asyncio.Queue()
        self._task: asyncio.Task[None] | None = None
        self._lock = threading.Lock()

    async def open(self) -> None:
        """Connect in the background."""
        self._loop = asyncio.get_running_loop()
        self._task = asyncio.create_task(self._run())

    async def close(self) -> None:
        """Disconnect after what waits has been sent."""
        if self._task is None:
            return
        with suppress(TimeoutError):
            async with asyncio.timeout(END_TIMEOUT_S):
                if self._socket is not None:
                    await self._outgoing.join()
        self._task.cancel()
        with suppress(asyncio.CancelledError):
            await self._task
        self._task = None

    # Commands; thread-safe

    def follow(self, points: Sequence[TrajectoryPoint]) -> int:
        """Send a goal, and return its number."""
        goal = ArmGoal(id=next(self._numbers), points=tuple(points))
        self._goal_connection = self._connection
        self._send(goal)
        return goal.id

    def is_accepted(self, goal: int) -> bool:
        """Return whether the controller follows a goal, or a later one."""
        return self._accepted >= goal

    def end_of(self, goal: int) -> GoalEnd | None:
        """Return how a goal has ended; None while it has not."""
        with self._lock:
            end = self._ends.get(goal)
        if end is None and self._goal_connection != self._connection:
            return GoalEnd(
                id=goal, succeeded=False, reason=f"the connection to {self.url} was lost", unknown=True
            )
        return end

    def cancel(self) -> None:
        """Cancel the goal."""
        self._send(ArmCancel())

    def velocity(self, values: Joints) -> None:
        """Command a velocity of the joints, or a twist."""
        self._send(ArmVelocity(values=values))

    def _send(self, command: BaseModel) -> None:
        if self._socket is None or self._loop is None:
            raise RobotFault.translated(
                "robot.ros_not_connected", "the arm is not connected: {fault}", fault=self.fault
            )
        self._loop.call_soon_threadsafe(self._outgoing.put_nowait, command)

    # The connection

    async def _run(self) -> None:
        backoff = Backoff()
        while True:
            try:
                headers = {} if self._credentials is None else await self._credentials.headers()
                async with connect(
                    self.url, open_timeout=OPEN_TIMEOUT_S, compression=None, additional_headers=headers
                ) as socket:
                    await self._exchange(socket)
                    backoff.reset()
            except (OSError, TimeoutError, WebSocketException, InvalidURI) as error:
                self.fault = (
                    f"the ROS bridge at {self.url} is unavailable: {str(error) or type(error).__name__}"
                )
            except HandoverError as error:
                self.fault = f"there are no credentials for the ROS bridge: {text_of(error)}"
            self._socket = None
            self._connection += 1
            log.info("arm not connected", url=self.url, reason=self.fault)
            await backoff.wait()

    async def _exchange(self, socket: ClientConnection) -> None:
        await socket.send(self.setup.model_dump_json(by_alias=True))
        while not self._outgoing.empty():
            self._outgoing.get_nowait()
            self._outgoing.task_done()
        self.fault = f"{self.setup.joint_states} has not been received"
        self._socket = socket
        await exchange(socket, self._write(socket), self._take)

    async def _write(self, socket: ClientConnection) -> None:
        while True:
            command = await self._outgoing.get()
            try:
                await socket.send(command.model_dump_json(by_alias=True))
            finally:
                self._outgoing.task_done()

    def _take(self, received: str | bytes) -> None:
        try:
            report = ARM_REPORTS.validate_json(received)
        except ValidationError as error:
            log.warning("report of the ROS bridge not read", error=str(error.errors()[0]["msg"]))
            return
        if isinstance(report, ArmJoints):
            self._take_joints(report)
        elif isinstance(report, GoalAccepted):
            self._accepted = report.id
        elif isinstance(report, GoalEnd):
            with self._lock:
                self._ends = {report.id: report, **dict(itertools.islice(self._ends.items(), 8))}
        elif isinstance(report, StreamRefusal):
            self.fault = f"the ROS bridge refuses: {report.reason}"

    def _take_joints(self, report: ArmJoints) -> None:
        names = self.setup.joint_names
        try:
            positions = in_order(names, report.names, report.positions)
            velocities = in_order(names, report.names, report.velocities) if report.velocities else None
            efforts = in_order(names, report.names, report.efforts) if report.efforts else None
        except RobotFault as fault:
            self.fault = str(fault)
            return
        if velocities is None:
            velocities = self._differences(report.stamp, positions)
        self.joints = JointState(report.stamp, positions, velocities, efforts)
        self.reported_s = time.monotonic()

    def _differences(self, stamp_s: float, positions: Joints) -> Joints:
        """Return the velocities of a driver that reports none."""
        last = self.joints
        if last is None or stamp_s <= last.stamp_s:
            return (0.0,) * len(positions)
        passed_s = stamp_s - last.stamp_s
        return tuple((now - then) / passed_s for now, then in zip(positions, last.positions, strict=True))


def in_order(joint_names: Sequence[str], names: Any, values: Any) -> Joints:
    """Return the values of the joints `joint_names` from values by name. Raises `RobotFault`.

    Drivers report the joints of a gripper, or of a second arm, in the same message, in any order.
    """
    if not isinstance(names, Sequence) or not isinstance(values, Sequence) or len(names) != len(values):
        raise RobotFault.translated(
            "robot.joint_count_differs",
            "{names} joint names and {values} values are reported",
            names=len(names or ()),
            values=len(values or ()),
        )
    by_name = dict(zip(names, values, strict=True))
    missing = [name for name in joint_names if not isinstance(by_name.get(name), int | float)]
    if missing:
        raise RobotFault.translated(
            "robot.joints_missing",
            "{missing} are not reported; the reported joints are {given}",
            missing=", ".join(missing),
            given=", ".join(by_name),
        )
    return tuple(float(by_name[name]) for name in joint_names)
