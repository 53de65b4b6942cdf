"""A humanoid of the graph behind a stream: commands to its joints, its joints and sensors back.

The messages are those of `handover_datamodels.humanoid_stream`. Each joint state becomes a report with the
newest values of the inertial and the force-torque sensors. The watchdog commands the last positions at rest
when no command has come for its time; so does the end of the stream.
"""

import asyncio
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final, Self

from pydantic import BaseModel

from handover.runtime.background_tasks import BackgroundTasks
from handover.telemetry import get_logger
from handover_datamodels.humanoid_stream import (
    HumanoidCommand,
    HumanoidGains,
    HumanoidProblem,
    HumanoidSetup,
    HumanoidState,
)
from handover_ros.errors import GraphError
from handover_ros.graph.port import Message, Publisher, Received, RosGraph, Subscription
from handover_ros.graph.qos import SENSOR_DATA
from handover_ros.metrics import HUMANOID_WATCHDOG

log = get_logger(__name__)

JOINT_STATE: Final = "sensor_msgs/msg/JointState"
IMU: Final = "sensor_msgs/msg/Imu"
WRENCH: Final = "geometry_msgs/msg/WrenchStamped"
ARRAY: Final = "std_msgs/msg/Float64MultiArray"
PROBLEM_EVERY_S: Final = 1.0

Send = Callable[[BaseModel], None]


class HumanoidStream:
    """One humanoid; an asynchronous context manager. `send` is called on the event loop with each report.

    Raises `GraphError` on entry for names that ROS does not permit.
    """

    def __init__(self, graph: RosGraph, setup: HumanoidSetup, send: Send) -> None:
        self.setup = setup
        self._graph, self._send = graph, send
        self._subscriptions: list[Subscription] = []
        self._publisher: Publisher | None = None
        self._gains: Publisher | None = None
        self._parts: dict[str, Received] = {}
        """The newest message of each topic of a sensor."""
        self._last: HumanoidCommand | None = None
        self._commanded_s, self._problem_s = 0.0, 0.0
        self._wakes = asyncio.Event()
        self._order: tuple[tuple[str, ...], list[int]] = ((), [])
        self._tasks = BackgroundTasks(f"humanoid {setup.joint_commands}")

    async def __aenter__(self) -> Self:
        graph, setup = self._graph, self.setup
        try:
            sensors = [(setup.imu, IMU), *((topic, WRENCH) for topic in setup.wrenches)]
            for topic, kind in sensors:
                self._subscriptions.append(await graph.subscribe(topic, kind, self._keep(topic), SENSOR_DATA))
            self._subscriptions.append(
                await graph.subscribe(setup.joint_states, JOINT_STATE, self._receive, SENSOR_DATA)
            )
            self._publisher = await graph.publisher(setup.joint_commands, JOINT_STATE)
            if setup.gains is not None:
                self._gains = await graph.publisher(setup.gains, ARRAY)
        except BaseException:
            await self._close()
            raise
        await self._tasks.__aenter__()
        self._tasks.start(self._watch)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__()
        self._hold("the stream has ended")
        await self._close()

    def take(self, command: HumanoidCommand | HumanoidGains) -> None:
        """Carry out a command. Raises `ValueError` for one that does not fit the setup."""
        count = len(self.setup.joint_names)
        if isinstance(command, HumanoidGains):
            if self._gains is None:
                raise ValueError("gains need the topic of gains in the setup")
            _check(count, command.stiffness, command.damping)
            self._gains.publish({"data": [*command.stiffness, *command.damping]})
            return
        parts = [values for values in (command.positions, command.velocities, command.efforts) if values]
        if not command.positions and not command.efforts:
            raise ValueError("a command has positions, efforts, or both")
        _check(count, *parts)
        self._last, self._commanded_s = command, time.monotonic()
        self._publish(command)
        self._wakes.set()

    async def _close(self) -> None:
        for endpoint in (*self._subscriptions, self._publisher, self._gains):
            if endpoint is not None:
                await endpoint.close()

    # Commands

    def _publish(self, command: HumanoidCommand) -> None:
        if self._publisher is None:
            return
        now_ns = time.time_ns()
        self._publisher.publish(
            {
                "header": {"stamp": {"sec": now_ns // 10**9, "nanosec": now_ns % 10**9}},
                "name": list(self.setup.joint_names),
                "position": list(command.positions),
                "velocity": list(command.velocities),
                "effort": list(command.efforts),
            }
        )

    def _hold(self, why: str) -> None:
        """Command the last positions at rest, once."""
        last, self._last = self._last, None
        if last is None:
            return
        HUMANOID_WATCHDOG.inc()
        log.warning("humanoid held", topic=self.setup.joint_commands, reason=why)
        if last.positions:
            at_rest = HumanoidCommand(
                sent_s=last.sent_s,
                positions=last.positions,
                velocities=(0.0,) * len(last.velocities),
                efforts=(0.0,) * len(last.efforts),
            )
            with suppress(GraphError):
                self._publish(at_rest)

    async def _watch(self) -> None:
        """Hold the joints when commands cease."""
        while True:
            await self._wakes.wait()
            self._wakes.clear()
            while self._last is not None:
                silent_s = time.monotonic() - self._commanded_s
                if silent_s >= self.setup.watchdog_s:
                    self._hold(f"no command for {silent_s:.2f} s")
                    break
                await asyncio.sleep(self.setup.watchdog_s - silent_s)

    # Sensors

    def _keep(self, topic: str) -> Callable[[Received], None]:
        def keep(received: Received) -> None:
            self._parts[topic] = received

        return keep

    def _receive(self, received: Received) -> None:
        """Report a joint state with the newest of the other sensors, or what is missing."""
        missing = [topic for topic in (self.setup.imu, *self.setup.wrenches) if topic not in self._parts]
        if missing:
            self._report_problem(f"nothing has been received on {', '.join(missing)}")
            return
        try:
            self._send(self._state(received))
        except (GraphError, ValueError, KeyError) as error:
            self._report_problem(str(error))

    def _report_problem(self, reason: str) -> None:
        now_s = time.monotonic()
        if now_s - self._problem_s >= PROBLEM_EVERY_S:
            self._problem_s = now_s
            self._send(HumanoidProblem(reason=reason))

    def _state(self, received: Received) -> HumanoidState:
        joints = received.message
        imu = self._parts[self.setup.imu]
        wrenches = [self._parts[topic] for topic in self.setup.wrenches]
        now_s = time.time()
        oldest_s = min(wrench.received_at_s for wrench in (received, imu, *wrenches))
        order = self._places(joints["name"])
        stamp = joints["header"]["stamp"]
        last = self._last
        return HumanoidState(
            stamp=stamp["sec"] + stamp["nanosec"] / 1e9,
            positions=_ordered(joints["position"], order, "positions"),
            velocities=_ordered(joints["velocity"], order, "velocities"),
            efforts=_ordered(joints["effort"], order, "efforts") if len(joints["effort"]) else (),
            gyroscope=_vector(imu.message["angular_velocity"]),
            accelerometer=_vector(imu.message["linear_acceleration"]),
            wrenches=tuple(_wrench(wrench.message) for wrench in wrenches),
            age_s=max(now_s - oldest_s, 0.0),
            echo_s=None if last is None else last.sent_s,
            held_s=0.0 if last is None else time.monotonic() - self._commanded_s,
        )

    def _places(self, reported: Sequence[str]) -> list[int]:
        """Return where each of our joints stands in a report. Raises `ValueError` for one that is missing."""
        names = tuple(reported)
        if names != self._order[0]:
            by_name = {name: index for index, name in enumerate(names)}
            missing = [name for name in self.setup.joint_names if name not in by_name]
            if missing:
                raise ValueError(
                    f"{self.setup.joint_states} does not report the joints {', '.join(missing)}; it reports: "
                    f"{', '.join(names)}"
                )
            self._order = (names, [by_name[name] for name in self.setup.joint_names])
        return self._order[1]


def _check(count: int, *parts: Sequence[float]) -> None:
    wrong = next((len(part) for part in parts if len(part) != count), None)
    if wrong is not None:
        raise ValueError(f"{wrong} values for {count} joints")


def _ordered(values: Any, order: list[int], what: str) -> tuple[float, ...]:
    if len(values) <= max(order):
        raise ValueError(f"the joint states have {len(values)} {what}; the robot has to report all")
    return tuple(float(values[index]) for index in order)


def _vector(message: Message) -> tuple[float, float, float]:
    return float(message["x"]), float(message["y"]), float(message["z"])


def _wrench(message: Message) -> tuple[float, float, float, float, float, float]:
    wrench = message["wrench"]
    return *_vector(wrench["force"]), *_vector(wrench["torque"])
