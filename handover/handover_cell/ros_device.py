"""`handover bridge device`: a robot of the ROS graph as a device of a gateway or an edge.

A file says which fields of topics are its values, which services and actions its commands call, and on which
topic it takes velocities:

    values:
      battery: {topic: /battery_state, type: sensor_msgs/msg/BatteryState, field: percentage}
      elbow: {topic: /joint_states, type: sensor_msgs/msg/JointState, field: position, joint: elbow}
    commands:
      dock: {service: /dock, type: std_srvs/srv/Trigger, timeoutS: 30}
      spin: {action: /spin, type: nav2_msgs/action/Spin, progress: fraction}
    drive: {topic: /cmd_vel}
    driveJoints: {topic: /velocity_controller/commands, joints: [shoulder, elbow]}
    periodS: 1.0

The newest value of each topic is sent once a period. A person who drives moves the base by a Twist, and
joints by velocities in the order of the file, as a group controller of ros2_control takes them. When one is
no longer valid, or the connection has ended, zero is published.
"""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat
from pydantic.alias_generators import to_camel

from handover.telemetry import get_logger
from handover_devices.device_client import DeviceClient, Run
from handover_ros.graph.goals import result_text
from handover_ros.graph.port import ActionClient, GoalStatus, Publisher, Received, RosGraph

log = get_logger(__name__)

JOINT_VELOCITIES: Final = "std_msgs/msg/Float64MultiArray"
TWIST: Final = "geometry_msgs/msg/Twist"
CHECK_S: Final = 0.1
"""How often an action looks whether its command was cancelled."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", alias_generator=to_camel, populate_by_name=True)


class TopicValue(_Part):
    """A field of a topic; with `joint` the element at the place of that name in the field `name`."""

    topic: str
    type: str
    field: str
    joint: str | None = None

    def of(self, message: Mapping[str, Any]) -> float | None:
        """Return the value in a message; None if it has none."""
        value = _field(message, self.field)
        if self.joint is not None:
            names = list(message["name"])
            if self.joint not in names or len(value) <= names.index(self.joint):
                return None
            value = value[names.index(self.joint)]
        return float(value)


class ServiceCommand(_Part):
    """A service that a command calls, with the parameters of the command as request."""

    service: str
    type: str
    timeout_s: FiniteFloat = Field(10.0, gt=0)


class ActionCommand(_Part):
    """An action that a command executes, with the parameters of the command as goal.

    `progress` is a field of the feedback, from 0 to 1.
    """

    action: str
    type: str
    timeout_s: FiniteFloat = Field(3600.0, gt=0)
    progress: str | None = None


class DriveTopic(_Part):
    """A topic of geometry_msgs/Twist that moves the base."""

    topic: str


class JointsTopic(_Part):
    """A topic of std_msgs/Float64MultiArray that takes velocities of these joints, in rad/s or m/s."""

    topic: str
    joints: tuple[str, ...] = Field(min_length=1)


class RosDeviceFile(_Part):
    """What of a ROS graph makes the device."""

    values: dict[str, TopicValue] = Field(default_factory=dict)
    commands: dict[str, ServiceCommand | ActionCommand] = Field(default_factory=dict)
    drive: DriveTopic | None = None
    drive_joints: JointsTopic | None = None
    period_s: FiniteFloat = Field(1.0, ge=0.02)


class RosDevice:
    """Sends values, and carries out commands and velocities; run `run` until cancelled."""

    def __init__(self, graph: RosGraph, client: DeviceClient, file: RosDeviceFile) -> None:
        self._graph, self._client, self._file = graph, client, file
        self._latest: dict[str, Received] = {}
        self._loop = asyncio.get_running_loop()

    async def run(self) -> None:
        """Stay connected until cancelled, or until the gateway refuses the device."""
        for topic, type_name in {(source.topic, source.type) for source in self._file.values.values()}:

            def received(message: Received, topic: str = topic) -> None:
                self._latest[topic] = message

            await self._graph.subscribe(topic, type_name, received)
        for name, command in self._file.commands.items():
            if isinstance(command, ActionCommand):
                client = await self._graph.action_client(command.action, command.type)
                self._client.command(name)(self._acting(command, client))
            else:
                self._client.command(name)(self._calling(command))
        if self._file.drive is not None or self._file.drive_joints is not None:
            await self._follow_velocities(self._file.drive, self._file.drive_joints)
        self._client.start()
        try:
            while self._client.refused is None:
                await asyncio.sleep(self._file.period_s)
                await self._send_values()
        finally:
            await asyncio.to_thread(self._client.stop)

    async def _send_values(self) -> None:
        latest, self._latest = self._latest, {}
        for topic, received in latest.items():
            values = {}
            for name, source in self._file.values.items():
                if source.topic == topic:
                    try:
                        value = source.of(received.message)
                    except (KeyError, IndexError, TypeError, ValueError) as error:
                        log.warning("no value in a message", value=name, topic=topic, error=repr(error))
                        continue
                    if value is not None:
                        values[name] = value
            if values:
                try:
                    await asyncio.to_thread(self._client.send, values, received.received_at_s)
                except ValueError as error:  # NaN is how ROS says that a value is not known
                    log.warning("values not sent", topic=topic, error=str(error))

    def _calling(self, command: ServiceCommand) -> Any:
        def call(parameters: Mapping[str, Any], _: Run) -> Mapping[str, Any]:
            calling = self._graph.call(command.service, command.type, dict(parameters), command.timeout_s)
            response = asyncio.run_coroutine_threadsafe(calling, self._loop).result()
            if response.get("success") is False:
                raise RuntimeError(response.get("message") or "the service reports no success")
            return _scalars(response)

        return call

    def _acting(self, command: ActionCommand, client: ActionClient) -> Any:
        def act(parameters: Mapping[str, Any], run: Run) -> Mapping[str, Any]:
            acting = self._act(command, client, dict(parameters), run)
            return asyncio.run_coroutine_threadsafe(acting, self._loop).result()

        return act

    async def _act(
        self, command: ActionCommand, client: ActionClient, goal: dict[str, Any], run: Run
    ) -> Mapping[str, Any]:
        """Execute a goal until its end; cancel it with the command, or after the timeout."""

        def report(feedback: Mapping[str, Any]) -> None:
            if command.progress is not None:
                done = float(_field(feedback, command.progress))
                self._loop.run_in_executor(None, run.progress, done)

        sent = await client.send_goal(goal, on_feedback=report)
        ending = asyncio.ensure_future(sent.result())
        ends_s = self._loop.time() + command.timeout_s
        is_cancelled = False
        while not ending.done():
            await asyncio.wait({ending}, timeout=CHECK_S)
            is_late = self._loop.time() >= ends_s
            if not is_cancelled and (run.is_cancelled or is_late):
                is_cancelled = await sent.cancel()
        ended = ending.result()
        if ended.status is not GoalStatus.SUCCEEDED:
            said = result_text(ended.result)
            state = f"the action {command.action} has ended as {ended.status.name.lower()}"
            raise RuntimeError(f"{state}: {said}" if said else state)
        return _scalars(ended.result)

    async def _follow_velocities(self, base: DriveTopic | None, joints: JointsTopic | None) -> None:
        publishers: list[Callable[[Mapping[str, Any]], None]] = []
        if base is not None:
            publishers.append(partial(_publish_base, await self._graph.publisher(base.topic, TWIST)))
        if joints is not None:
            publisher = await self._graph.publisher(joints.topic, JOINT_VELOCITIES)
            publishers.append(partial(_publish_joints, publisher, joints.joints))

        @self._client.drive
        def follow(motion: Mapping[str, Any] | None) -> None:
            for publish in publishers:  # a part that is not named stands
                self._loop.call_soon_threadsafe(publish, motion or {})


def _field(message: Mapping[str, Any], path: str) -> Any:
    value: Any = message
    for part in path.split("."):
        value = value[part]
    return value


def _scalars(message: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in message.items() if isinstance(value, str | int | float)}


def _publish_joints(publisher: Publisher, joints: Sequence[str], motion: Mapping[str, Any]) -> None:
    positions = motion.get("joints") or {}
    publisher.publish({"data": [float(positions.get(name, 0.0)) for name in joints]})


def _publish_base(publisher: Publisher, motion: Mapping[str, Any]) -> None:
    x, y, rz = motion.get("base") or (0.0, 0.0, 0.0)
    publisher.publish({"linear": {"x": x, "y": y, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": rz}})
