"""An arm of the graph behind a stream: goals and velocities to its controllers, its joints back.

The messages are those of `handover_datamodels.arm_stream`. A goal takes the place of the one before: a joint
trajectory controller does that without a stop. The watchdog commands a velocity of 0 when no command has
come for its time. The end of the stream cancels the goal and commands a velocity of 0, so the arm of a tool
that was killed comes to rest. A goal that the controller accepts too late is cancelled at once.
"""

import asyncio
import math
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Self

from pydantic import BaseModel

from handover.runtime.background_tasks import BackgroundTasks
from handover.telemetry import get_logger
from handover_datamodels.arm_stream import (
    JOINT_VELOCITIES,
    TRAJECTORY_ACTION,
    ArmCancel,
    ArmGoal,
    ArmJoints,
    ArmSetup,
    ArmVelocity,
    GoalAccepted,
    GoalEnd,
    TrajectoryPoint,
    VelocityOutput,
)
from handover_ros.errors import GraphError, OutcomeUnknown
from handover_ros.graph.port import (
    ActionClient,
    Goal,
    GoalStatus,
    Message,
    Publisher,
    Received,
    RosGraph,
    Subscription,
)
from handover_ros.graph.qos import SENSOR_DATA
from handover_ros.metrics import ARM_WATCHDOG

log = get_logger(__name__)

JOINT_STATE = "sensor_msgs/msg/JointState"
DISCOVERY_TIMEOUT_S = 5.0
MIN_REPORT_PERIOD_S = 0.004
CANCEL_POLL_S = 0.02

Send = Callable[[BaseModel], None]


class ArmStream:
    """One arm; an asynchronous context manager. `send` is called on the event loop with each report.

    Raises `GraphError` on entry for names that ROS does not permit.
    """

    def __init__(self, graph: RosGraph, setup: ArmSetup, send: Send) -> None:
        self.setup = setup
        self._graph = graph
        self._send = send
        self._subscription: Subscription | None = None
        self._actions: ActionClient | None = None
        self._velocity: _VelocityTopic | None = None
        self._goal: Goal | None = None
        self._wanted: ArmGoal | ArmCancel | None = None
        """What is sent next; a newer one takes the place of one that waits."""
        self._has_wanted = asyncio.Event()
        self._latest: Received | None = None
        self._has_joints = asyncio.Event()
        self._tasks = BackgroundTasks(f"arm {setup.trajectory_action}")

    async def __aenter__(self) -> Self:
        graph, setup = self._graph, self.setup
        try:
            self._subscription = await graph.subscribe(
                setup.joint_states, JOINT_STATE, self._receive, SENSOR_DATA
            )
            self._actions = await graph.action_client(setup.trajectory_action, TRAJECTORY_ACTION)
            if setup.velocity is not None:
                topic = await graph.publisher(setup.velocity.topic, setup.velocity.type)
                self._velocity = _VelocityTopic(topic, setup.velocity, len(setup.joint_names))
        except BaseException:
            await self._close()
            raise
        await self._tasks.__aenter__()
        self._tasks.start(self._report)
        self._tasks.start(self._command)
        if self._velocity is not None:
            self._tasks.start(self._velocity.watch)
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._velocity is not None:
            self._velocity.stop()
        await self._tasks.__aexit__()
        await self._cancel()
        await self._close()

    def take(self, command: ArmGoal | ArmCancel | ArmVelocity) -> None:
        """Carry out a command. Raises `ValueError` for one that does not fit the setup."""
        if isinstance(command, ArmVelocity):
            if self._velocity is None:
                raise ValueError("velocities need the velocity topic of the setup")
            self._velocity.command(command.values)
            return
        if isinstance(command, ArmGoal):
            _check(command, len(self.setup.joint_names))
        self._wanted = command
        self._has_wanted.set()

    async def _close(self) -> None:
        if self._subscription is not None:
            await self._subscription.close()
        if self._actions is not None:
            await self._actions.close()
        if self._velocity is not None:
            await self._velocity.topic.close()

    # Goals

    async def _command(self) -> None:
        while True:
            await self._has_wanted.wait()
            self._has_wanted.clear()
            wanted, self._wanted = self._wanted, None
            if isinstance(wanted, ArmGoal):
                await self._unless_cancelled(asyncio.create_task(self._send_goal(wanted)))
            elif wanted is not None:
                await self._cancel()

    async def _unless_cancelled(self, sending: asyncio.Task[None]) -> None:
        """Wait until a goal is accepted or refused; give it up, which cancels it, when the tool cancels."""
        try:
            while not sending.done() and not isinstance(self._wanted, ArmCancel):
                await asyncio.wait([sending], timeout=CANCEL_POLL_S)
        finally:
            sending.cancel()
            await asyncio.wait([sending])

    async def _send_goal(self, goal: ArmGoal) -> None:
        assert self._actions is not None  # noqa: S101 - set on entry
        trajectory = {
            "joint_names": list(self.setup.joint_names),
            "points": [_point(point) for point in goal.points],
        }
        try:
            accepted = await self._actions.send_goal(
                {"trajectory": trajectory}, timeout_s=DISCOVERY_TIMEOUT_S
            )
        except GraphError as error:
            self._send(_fault(goal.id, error))
            return
        self._goal = accepted
        self._send(GoalAccepted(id=goal.id))
        self._tasks.start(self._await_end, goal.id, accepted)

    async def _await_end(self, number: int, goal: Goal) -> None:
        try:
            ended = await goal.result()
        except GraphError as error:
            self._send(_fault(number, error))
            return
        succeeded = ended.status is GoalStatus.SUCCEEDED
        reason = "" if succeeded else str(ended.result.get("error_string") or ended.status.name.lower())
        self._send(GoalEnd(id=number, succeeded=succeeded, reason=reason))

    async def _cancel(self) -> None:
        goal, self._goal = self._goal, None
        if goal is not None and not goal.status.is_over:
            with suppress(GraphError):
                await goal.cancel()

    # Joints

    def _receive(self, received: Received) -> None:
        self._latest = received
        self._has_joints.set()

    async def _report(self) -> None:
        while True:
            await self._has_joints.wait()
            self._has_joints.clear()
            received = self._latest
            if received is not None:
                try:
                    self._send(_joints(received.message))
                except (GraphError, ValueError) as error:
                    log.warning("joint states not read", topic=received.topic, error=str(error))
            await asyncio.sleep(MIN_REPORT_PERIOD_S)


class _VelocityTopic:
    """A topic for velocities with a watchdog."""

    def __init__(self, topic: Publisher, output: VelocityOutput, joints: int) -> None:
        self.topic = topic
        self._output = output
        self._zeros = (0.0,) * (joints if output.type == JOINT_VELOCITIES else 6)
        self._last = self._zeros
        self._commanded_s = -math.inf
        self._wakes = asyncio.Event()

    def command(self, values: tuple[float, ...]) -> None:
        """Publish a velocity. Raises `ValueError` for another number of values."""
        if len(values) != len(self._zeros):
            raise ValueError(f"{len(values)} velocities, and {self.topic.topic} takes {len(self._zeros)}")
        self._last, self._commanded_s = values, time.monotonic()
        self._publish(values)
        self._wakes.set()

    def stop(self) -> None:
        """Publish a velocity of 0, unless that was the last one."""
        if any(self._last):
            self._last = self._zeros
            with suppress(GraphError):
                self._publish(self._zeros)

    async def watch(self) -> None:
        """Stop the joints when commands cease."""
        while True:
            await self._wakes.wait()
            self._wakes.clear()
            while any(self._last):
                silent_s = time.monotonic() - self._commanded_s
                if silent_s >= self._output.watchdog_s:
                    ARM_WATCHDOG.inc()
                    log.warning("velocity commands ceased", topic=self.topic.topic, silent_s=silent_s)
                    self.stop()
                    break
                await asyncio.sleep(self._output.watchdog_s - silent_s)

    def _publish(self, values: tuple[float, ...]) -> None:
        if self._output.type == JOINT_VELOCITIES:
            self.topic.publish({"data": list(values)})
            return
        now_ns = time.time_ns()
        linear, angular = (dict(zip("xyz", part, strict=True)) for part in (values[:3], values[3:]))
        stamp = {"sec": now_ns // 10**9, "nanosec": now_ns % 10**9}
        header = {"stamp": stamp, "frame_id": self._output.frame}
        self.topic.publish({"header": header, "twist": {"linear": linear, "angular": angular}})


def _check(goal: ArmGoal, joints: int) -> None:
    before_s = -1.0
    for point in goal.points:
        if {len(point.positions), len(point.velocities), len(point.accelerations)} != {joints}:
            raise ValueError(f"each point of a goal has {joints} positions, velocities and accelerations")
        if point.time_s <= before_s:
            raise ValueError("the times of the points of a goal increase")
        before_s = point.time_s
    if any(goal.points[-1].velocities):
        raise ValueError("the last point of a goal is at rest")


def _fault(number: int, error: GraphError) -> GoalEnd:
    unknown = isinstance(error, OutcomeUnknown)
    return GoalEnd(id=number, succeeded=False, reason=str(error), unknown=unknown)


def _point(point: TrajectoryPoint) -> Message:
    whole_s = int(point.time_s)
    return {
        "positions": list(point.positions),
        "velocities": list(point.velocities),
        "accelerations": list(point.accelerations),
        "time_from_start": {"sec": whole_s, "nanosec": int((point.time_s - whole_s) * 1e9)},
    }


def _joints(message: Message) -> ArmJoints:
    """Return the joints of a JointState. Raises `ValueError` for values that are not finite."""
    stamp = message["header"]["stamp"]
    result: dict[str, Any] = {
        part: tuple(map(float, message[key]))
        for part, key in (("positions", "position"), ("velocities", "velocity"), ("efforts", "effort"))
    }
    if not all(map(math.isfinite, (*result["positions"], *result["velocities"]))):
        raise ValueError("positions or velocities that are not finite")
    if not all(map(math.isfinite, result["efforts"])):
        result["efforts"] = ()
    return ArmJoints(stamp=stamp["sec"] + stamp["nanosec"] / 1e9, names=tuple(message["name"]), **result)
