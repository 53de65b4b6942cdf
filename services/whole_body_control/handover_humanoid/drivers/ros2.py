"""The driver `ros2`: a humanoid in a ROS graph, by the ROS bridge (`handover_datamodels.humanoid_stream`).

    robot:
      kind: driver
      driver: ros2
      realtime: true
      options:
        imu: /imu
        wrenches: {l_leg_ft: /left_foot/wrench, r_leg_ft: /right_foot/wrench}   # by sensor of the model
        modes: [position, torque]                 # what its controllers accept

A thread keeps the connection. `read` returns the newest state, and values that are not finite when it is too
old: the controller then stops, and the watchdog of the driver holds. `write` keeps the newest command, which
is sent `command_hz` times a second, joint impedance as positions, velocities and efforts together.

The time of the sensors is that of the robot's clock. `delay_s` is how long ago a state was measured: half of
the round trip of commands that the bridge echoes and how long the state waited in the bridge, or by how much
it came later than the fastest one, by the robot's clock. What the fastest takes within the graph is not seen.
Whether a state is too old does not depend on that clock, which may be slower than ours (a simulation); but a
state counts only if its stamp is newer than that of the last one, or the clock was set back.
"""

import asyncio
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Annotated, Final, Self

import numpy as np
from pydantic import Field, FiniteFloat, ValidationError, model_validator
from websockets.asyncio.client import ClientConnection

from handover.control.limit_link import exchange, keep_connected
from handover.errors import UsageError
from handover.formats.validation import ClosedModel
from handover.runtime.control_cycle import runs_in_cycle
from handover.security.service_access import ServiceAccess
from handover.telemetry import get_logger
from handover_datamodels.humanoid_stream import (
    HUMANOID_REPORTS,
    HumanoidCommand,
    HumanoidGains,
    HumanoidSetup,
    HumanoidState,
)
from handover_humanoid.components.modes import require_mode
from handover_humanoid.components.robot import JointCommand, RobotSensors
from handover_humanoid.drivers import DriverContext
from handover_humanoid.model.humanoid import Humanoid, JointMode
from handover_humanoid.model.kinematics import Array
from handover_humanoid.settings import WholeBodySettings
from handover_humanoid.simulation.body_model import STEP_S

log = get_logger(__name__)

SENSOR_TIMEOUT_S: Final = 0.05
CLOSE_TIMEOUT_S: Final = 5.0
USUAL_HZ, TORQUE_HZ, MIN_TORQUE_HZ = 100.0, 500.0, 250.0
"""COMAN in simulation falls with torques that are computed from sensors 12 ms old if they are sent 100
times a second, and with 20 ms if they are sent 500 times; joint impedance and positions bear more."""
MIN_RATE: Final = 0.05
"""The slowest clock of a robot that is believed."""
RESTARTED_S: Final = 1.0
"""A clock that is set back by so much is that of a robot that has started again."""


class Ros2Options(ClosedModel):
    """The settings of the driver: the topics of the robot, and what its controllers accept."""

    joint_states: str = "/joint_states"
    imu: str = "/imu"
    wrenches: dict[str, str] = Field(default_factory=dict)
    joint_commands: str = "/joint_commands"
    gains: str | None = None
    modes: Annotated[tuple[JointMode, ...], Field(min_length=1)] = (JointMode.IMPEDANCE,)
    command_hz: FiniteFloat | None = Field(None, ge=10, le=500)
    """By default `USUAL_HZ`, with torques `TORQUE_HZ`."""
    watchdog_s: FiniteFloat = Field(0.2, gt=0, le=2)

    @model_validator(mode="after")
    def _torques_are_sent_often(self) -> Self:
        if JointMode.TORQUE in self.modes and self.hz < MIN_TORQUE_HZ:
            raise ValueError(
                f"command_hz is {self.hz:g}; the mode torque needs {MIN_TORQUE_HZ:g} at least, since a "
                "torque that is held longer makes the robot fall over a link of milliseconds; raise it, or "
                "leave torque out of modes"
            )
        return self

    @property
    def hz(self) -> float:
        """How often a command is sent."""
        return self.command_hz or (TORQUE_HZ if JointMode.TORQUE in self.modes else USUAL_HZ)


class LinkDelay:
    """How long ago a measurement was made, by stamps of the robot's clock and echoes. Times in s.

    A message is late by how much longer its way was than that of the fastest one. The clock of the robot may
    run at another rate than ours, as that of a simulation that is slower than real time does; then each way
    seems longer than the last. So the fastest of each `WINDOW_S` is kept, and the slope between two of them
    is the rate: a delay that grows steadily over several windows is taken for a slow clock.
    """

    WINDOW_S: Final = 1.0

    def __init__(self) -> None:
        self.round_trip_s = 0.0
        self._slope = 0.0
        """By how much a way seems longer per second."""
        self._fastest: tuple[float, float] | None = None
        """When the fastest of the last whole window was received, and its way; so for those below."""
        self._newest: tuple[float, float] | None = None
        self._begun_s = 0.0

    def echo(self, round_trip_s: float) -> None:
        """Accept the time that a command and its echo took on the way."""
        self.round_trip_s = max(round_trip_s, 0.0)

    def of(self, stamp_s: float, received_s: float, waited_s: float) -> tuple[float, float]:
        """Return the age at its receipt of a state with this stamp, which waited in the bridge.

        First by the link alone, then with the stamp.
        """
        way_s = received_s - stamp_s  # and how far the clocks are apart
        if self._newest is None:
            self._newest, self._begun_s = (received_s, way_s), received_s
        elif received_s - self._begun_s > self.WINDOW_S:
            passed_s = np.inf if self._fastest is None else self._newest[0] - self._fastest[0]
            if self._fastest is not None and passed_s > self.WINDOW_S / 2:
                self._slope = (self._newest[1] - self._fastest[1]) / passed_s
            if passed_s > self.WINDOW_S / 2:  # two that are nearer to each other do not show the rate
                self._fastest = self._newest
            self._newest, self._begun_s = (received_s, way_s), received_s
        elif way_s - self._expected(self._newest, received_s) < 0:
            self._newest = (received_s, way_s)
        pairs = [pair for pair in (self._fastest, self._newest) if pair is not None]
        late_s = way_s - min(self._expected(pair, received_s) for pair in pairs)
        late_s /= max(1.0 - self._slope, MIN_RATE)  # while it was late, the clock of the robot went on slowly
        of_link_s = self.round_trip_s / 2 + waited_s
        return of_link_s, max(of_link_s, late_s)

    def _expected(self, fastest: tuple[float, float], now_s: float) -> float:
        """Return the way of a fastest message now."""
        return fastest[1] + self._slope * (now_s - fastest[0])


class Ros2Robot:
    """The robot of a graph. Thread-safe towards its own thread only; `close` ends that."""

    is_simulated = False

    def __init__(self, humanoid: Humanoid, options: Ros2Options, settings: WholeBodySettings) -> None:
        for mode in options.modes:
            require_mode(mode, humanoid.modes, f"the model {humanoid.name}")
        self.humanoid, self.options, self.period_s = humanoid, options, STEP_S
        self.modes = tuple(mode for mode in JointMode if mode in options.modes)
        self.fault = f"the ROS bridge at {settings.humanoid_bridge} has not answered yet"
        """Why there are no measurements."""
        self._url, self._ca_files = settings.humanoid_bridge, settings.ca_files
        self._access = ServiceAccess(settings, "whole-body-control")
        self._setup = HumanoidSetup(
            joint_names=humanoid.joint_names,
            joint_states=options.joint_states,
            imu=options.imu,
            wrenches=_topics(humanoid, options.wrenches),
            joint_commands=options.joint_commands,
            gains=options.gains,
            watchdog_s=options.watchdog_s,
        )
        self._delay = LinkDelay()
        self._state: tuple[HumanoidState, float, tuple[float, float]] | None = None
        """The newest state, when it was received, and how old it was then, without and with its stamp."""
        count = len(humanoid.joints)
        self._lock = threading.Lock()
        self._command: tuple[JointMode, Array] | None = None
        self._values = np.zeros((5, count))
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._serve, name="humanoid link", daemon=True)
        self._thread.start()

    @property
    def delay_s(self) -> float:
        """How long ago the newest state was measured; infinite before the first."""
        if self._state is None:
            return np.inf
        _, received_s, (_, age_s) = self._state
        return time.monotonic() - received_s + age_s

    @property
    def fresh(self) -> HumanoidState | None:
        """The newest state; None if it is too old, or before the first."""
        if self._state is None:
            return None
        state, received_s, (age_s, _) = self._state
        return state if time.monotonic() - received_s + age_s <= SENSOR_TIMEOUT_S else None

    @runs_in_cycle
    def read(self, sensors: RobotSensors) -> None:
        """Write the newest measurements; NaN where they are too old, or missing."""
        measured = self.fresh
        if measured is None:
            for part in (sensors.positions, sensors.velocities, sensors.gyroscope, sensors.accelerometer):
                part[:] = np.nan
            sensors.wrenches[:] = np.nan
            return
        sensors.time_s = measured.stamp
        sensors.positions[:], sensors.velocities[:] = measured.positions, measured.velocities
        sensors.torques[:] = measured.efforts or np.nan
        sensors.gyroscope[:], sensors.accelerometer[:] = measured.gyroscope, measured.accelerometer
        sensors.wrenches[:] = measured.wrenches

    @runs_in_cycle
    def write(self, command: JointCommand) -> None:
        """Keep a command, to be sent. Raises `ValueError`; see `Robot.write`."""
        if command.mode not in self.modes:
            raise ValueError(f'{self.humanoid.name} has no mode "{command.mode}" of joints')
        rows = (command.positions, command.velocities, command.torques, command.stiffness, command.damping)
        with self._lock:
            for row, values in zip(self._values, rows, strict=True):
                row[:] = values
            if not np.isfinite(self._values).all():
                self._command = None
                raise ValueError("the command has a value that is not finite; nothing is sent")
            self._command = (command.mode, self._values)

    def wait(self) -> None:
        """Return at once: the process of the driver is paced by its own clock."""

    def close(self) -> None:
        """End the connection; the bridge then holds the joints."""
        self._loop.call_soon_threadsafe(lambda: [task.cancel() for task in asyncio.all_tasks(self._loop)])
        self._thread.join(CLOSE_TIMEOUT_S)

    # The connection, in its thread

    def _serve(self) -> None:
        asyncio.set_event_loop(self._loop)
        with suppress(asyncio.CancelledError):
            self._loop.run_until_complete(self._run())
        self._access.close()
        self._loop.close()

    async def _run(self) -> None:
        await keep_connected(
            self._url,
            self._exchange,
            headers=self._access.headers,
            ca_files=self._ca_files,
            on_problem=self._say,
            peer=f"the ROS bridge at {self._url}",
        )

    async def _exchange(self, socket: ClientConnection) -> None:
        await socket.send(self._setup.model_dump_json(by_alias=True))
        self._say(f"{self._setup.joint_states} has not been received")
        await exchange(socket, self._send(socket), self._take)

    async def _send(self, socket: ClientConnection) -> None:
        """Send the newest command in each period, and the gains when they have changed."""
        due_s, gains = time.monotonic(), np.zeros((2, len(self.humanoid.joints)))
        while True:
            due_s = max(due_s + 1.0 / self.options.hz, time.monotonic())
            with self._lock:
                kept, self._command = self._command, None
                values = None if kept is None else kept[1].tolist()
            if kept is not None and values is not None:
                if kept[0] is JointMode.IMPEDANCE and self.options.gains and (gains != values[3:]).any():
                    gains[:] = values[3:]
                    message = HumanoidGains(stiffness=values[3], damping=values[4])
                    await socket.send(message.model_dump_json(by_alias=True))
                await socket.send(_message(kept[0], values).model_dump_json(by_alias=True))
            await asyncio.sleep(due_s - time.monotonic())

    def _take(self, received: str | bytes) -> None:
        try:
            report = HUMANOID_REPORTS.validate_json(received)
        except ValidationError as error:
            log.warning("report of the ROS bridge not read", error=str(error.errors()[0]["msg"]))
            return
        if not isinstance(report, HumanoidState):
            self._say(f"the ROS bridge: {report.reason}")
            return
        count = len(self.humanoid.joints)
        lengths = {len(report.positions), len(report.velocities), len(report.efforts) or count}
        if lengths != {count} or len(report.wrenches) != len(self._setup.wrenches):
            self._say(f"the ROS bridge sends states that are not of {self.humanoid.name}")
            return
        if self._state is not None and 0 <= self._state[0].stamp - report.stamp < RESTARTED_S:
            return  # of an older message that came later
        now_s = time.monotonic()
        if report.echo_s is not None:
            self._delay.echo(now_s - report.echo_s - report.held_s)
        self._state = (report, now_s, self._delay.of(report.stamp, now_s, report.age_s))
        self.fault = ""

    def _say(self, fault: str) -> None:
        if fault != self.fault:
            log.warning("no measurements of the humanoid", reason=fault)
        self.fault = fault


def _message(mode: JointMode, values: list[list[float]]) -> HumanoidCommand:
    positions, velocities, torques = values[:3]
    now_s = time.monotonic()
    if mode is JointMode.POSITION:
        return HumanoidCommand(sent_s=now_s, positions=tuple(positions))
    if mode is JointMode.TORQUE:
        return HumanoidCommand(sent_s=now_s, efforts=tuple(torques))
    return HumanoidCommand(
        sent_s=now_s, positions=tuple(positions), velocities=tuple(velocities), efforts=tuple(torques)
    )


def _topics(humanoid: Humanoid, wrenches: Mapping[str, str]) -> tuple[str, ...]:
    """Return the topics of the force-torque sensors in their order. Raises `UsageError`."""
    sensors = humanoid.sensors.force_torque
    unknown, missing = sorted(wrenches.keys() - sensors.keys()), sorted(sensors.keys() - wrenches.keys())
    if unknown or missing:
        wrong = (
            f'has no force-torque sensor "{unknown[0]}"' if unknown else f'needs a topic for "{missing[0]}"'
        )
        raise UsageError(
            f"{humanoid.name} {wrong}; the option wrenches has a topic for each of: {', '.join(sensors)}"
        )
    return tuple(wrenches[name] for name in sensors)


def make_robot(context: DriverContext) -> Ros2Robot:
    """Return the robot. Raises `UsageError` for options that do not fit the model."""
    return Ros2Robot(context.humanoid, context.read_options(Ros2Options), WholeBodySettings.load())
