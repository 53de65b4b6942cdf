"""A robot in a process of its own, behind two ports: what it measures, and the commands for it.

The driver writes `sensors` and reads `command`, the control cycle the other way round. Neither waits for the
other: the watchdog of the driver answers commands that are too old, and the cycle gets no numbers from
measurements that are.
"""

from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from handover.errors import UsageError
from handover.runtime.control_cycle import runs_in_cycle
from handover_humanoid.components.robot import JointCommand, Robot, RobotSensors
from handover_humanoid.cycle.ports import PortReader, PortWriter
from handover_humanoid.cycle.watchdog import Safety, Watchdog
from handover_humanoid.model.humanoid import Humanoid, JointMode
from handover_humanoid.model.kinematics import Array

SENSORS, COMMAND = "sensors", "command"
SENSOR_TIMEOUT_S = 0.05
MODES = tuple(JointMode)
"""The codes of modes in the port of the commands are their places here."""
LED_REFUSED = (
    "the hands of a person lead the motion, and this robot is not simulated: a fall would hurt the person. "
    "Choose another behaviour; assisted walking is for simulated robots only"
)
REFUSED_S = 1.0
"""An older command is refused no longer: it has ended."""
_OFFERS = "mode."
_STATUS = ("time_s", "safety", "stalls", "delay_s")
_HEAD = 2
"""The values of a command before its joints."""


def sensor_fields(humanoid: Humanoid, modes: Collection[JointMode]) -> tuple[str, ...]:
    """Return the names of the values of the port of the sensors, among them the modes that the robot has."""
    joints = [
        f"{kind}.{name}" for kind in ("position", "velocity", "torque") for name in humanoid.joint_names
    ]
    inertial = [f"{kind}.{axis}" for kind in ("gyroscope", "accelerometer") for axis in "xyz"]
    axes = ("fx", "fy", "fz", "tx", "ty", "tz")
    wrenches = [f"wrench.{name}.{axis}" for name in humanoid.sensors.force_torque for axis in axes]
    offers = [_OFFERS + mode for mode in MODES if mode in modes]
    return (*_STATUS, *offers, *joints, *inertial, *wrenches)


def command_fields(humanoid: Humanoid) -> tuple[str, ...]:
    """Return the names of the values of the port of the commands."""
    kinds = ("position", "velocity", "torque", "stiffness", "damping")
    return ("mode", "is_led", *(f"{kind}.{name}" for kind in kinds for name in humanoid.joint_names))


class PortRobot:
    """The robot as the control cycle sees it. Raises `UsageError` if no driver has made its ports."""

    is_simulated = False
    """The driver knows; here no world is simulated."""

    def __init__(self, humanoid: Humanoid, folder: Path, period_s: float) -> None:
        self.humanoid, self.period_s = humanoid, period_s
        self._sensors = PortReader(folder / SENSORS)
        self.modes = tuple(mode for mode in MODES if _OFFERS + mode in self._sensors.names)
        self._first = len(_STATUS) + len(self.modes)
        if self._sensors.names != sensor_fields(humanoid, self.modes):
            raise UsageError(f"the port {folder / SENSORS} is not of a driver of {humanoid.name}")
        self._command = PortWriter(folder / COMMAND, command_fields(humanoid))
        self.delay_s = np.nan
        self._values = np.zeros(len(self._command.names))

    @runs_in_cycle
    def read(self, sensors: RobotSensors) -> None:
        """Write the newest measurements into `sensors`; NaN where the driver sends none."""
        port = self._sensors
        is_new = port.read() and port.age_s() < SENSOR_TIMEOUT_S
        self.delay_s = float(port.values[3]) + port.age_s()
        sensors.time_s, end = float(port.values[0]), self._first
        for part in _parts(sensors):
            part[:] = port.values[end : end + len(part)] if is_new else np.nan
            end += len(part)

    @runs_in_cycle
    def write(self, command: JointCommand) -> None:
        """Publish a command."""
        _pack(command, self._values)
        if not np.isfinite(self._values).all():
            raise ValueError("the command has a value that is not finite; the driver keeps the last one")
        self._command.write(self._values)

    def wait(self) -> None:
        """Return at once: the cycle is paced by its own clock."""

    def close(self) -> None:
        """Let another process command the robot."""
        self._command.close()


class Driver:
    """A robot behind its ports; `cycle` is one period of it. Raises `UsageError` if another one runs.

    Commands that the robot must not follow count as none, and `refusal` says why: those of a mode that it
    does not have, and those of a person who leads by the hands where the robot is not simulated.
    """

    def __init__(self, robot: Robot, folder: Path) -> None:
        self.robot, self.refusal = robot, ""
        humanoid = robot.humanoid
        self.watchdog = Watchdog(humanoid, robot.period_s, robot.modes)
        self._port = PortWriter(folder / SENSORS, sensor_fields(humanoid, robot.modes))
        self._first = len(_STATUS) + len(robot.modes)
        self._refusals = {
            mode: f'{humanoid.name} has no mode "{mode}" of joints; set another mode of "walking"'
            for mode in MODES
            if mode not in robot.modes
        }
        if not (folder / COMMAND).exists():
            PortWriter(folder / COMMAND, command_fields(humanoid)).close()
        self._commands = PortReader(folder / COMMAND)
        self._sensors, self._command = RobotSensors(humanoid), JointCommand(humanoid)
        self._values = np.zeros(len(self._port.names))

    @runs_in_cycle
    def cycle(self) -> Safety:
        """Measure, publish, send the newest command or a safe one, and wait for the next period."""
        self.robot.read(self._sensors)
        self._publish()
        if self._commands.read():
            _unpack(self._commands.values, self._command)
        age_s = self._commands.age_s()
        self.refusal = self._refused() if age_s < REFUSED_S else ""
        if self.refusal:
            age_s = np.inf
        chosen = self.watchdog.choose(self._command, age_s, self._sensors)
        if chosen is not None:
            self.robot.write(chosen)
        self.robot.wait()
        return self.watchdog.state

    def _refused(self) -> str:
        if self._command.is_led and not self.robot.is_simulated:
            return LED_REFUSED
        return self._refusals.get(self._command.mode, "")

    @runs_in_cycle
    def _publish(self) -> None:
        values, end = self._values, self._first
        values[len(_STATUS) : end] = 1.0
        values[0], values[1], values[2] = self._sensors.time_s, self.watchdog.state, self.watchdog.stalls
        values[3] = self.robot.delay_s
        for part in _parts(self._sensors):
            values[end : end + len(part)] = part
            end += len(part)
        self._port.write(values)


def _parts(sensors: RobotSensors) -> Iterator[Array]:
    yield from (sensors.positions, sensors.velocities, sensors.torques)
    yield from (sensors.gyroscope, sensors.accelerometer, sensors.wrenches.reshape(-1))


def _of(command: JointCommand) -> tuple[Array, ...]:
    return command.positions, command.velocities, command.torques, command.stiffness, command.damping


def _pack(command: JointCommand, values: Array) -> None:
    count = len(command.positions)
    values[0], values[1] = MODES.index(command.mode), command.is_led
    for index, part in enumerate(_of(command)):
        values[_HEAD + index * count : _HEAD + (index + 1) * count] = part


def _unpack(values: Array, command: JointCommand) -> None:
    count = len(command.positions)
    mode = values[0]
    if not 0 <= mode < len(MODES):  # no command yet, or none of ours
        return
    command.mode, command.is_led = MODES[int(mode)], values[1] != 0
    for index, part in enumerate(_of(command)):
        part[:] = values[_HEAD + index * count : _HEAD + (index + 1) * count]
