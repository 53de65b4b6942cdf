"""A robot in a process of its own, behind two ports: what it measures, and the commands for it.

The driver writes `sensors` and reads `command`, the control cycle the other way round. Neither waits for the
other: the watchdog of the driver answers commands that are too old, and the cycle gets no numbers from
measurements that are.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from handover.errors import UsageError
from services.whole_body_control.components.robot import JointCommand, Robot, RobotSensors
from services.whole_body_control.cycle.ports import PortReader, PortWriter
from services.whole_body_control.cycle.watchdog import Safety, Watchdog
from services.whole_body_control.model.humanoid import Humanoid
from services.whole_body_control.model.kinematics import Array

SENSORS, COMMAND = "sensors", "command"
SENSOR_TIMEOUT_S = 0.05


def sensor_fields(humanoid: Humanoid) -> tuple[str, ...]:
    """Return the names of the values of the port of the sensors."""
    joints = [
        f"{kind}.{name}" for kind in ("position", "velocity", "torque") for name in humanoid.joint_names
    ]
    inertial = [f"{kind}.{axis}" for kind in ("gyroscope", "accelerometer") for axis in "xyz"]
    axes = ("fx", "fy", "fz", "tx", "ty", "tz")
    wrenches = [f"wrench.{name}.{axis}" for name in humanoid.sensors.force_torque for axis in axes]
    return ("time_s", "safety", "stalls", *joints, *inertial, *wrenches)


def command_fields(humanoid: Humanoid) -> tuple[str, ...]:
    """Return the names of the values of the port of the commands."""
    kinds = ("position", "velocity", "torque", "stiffness", "damping")
    return tuple(f"{kind}.{name}" for kind in kinds for name in humanoid.joint_names)


class PortRobot:
    """The robot as the control cycle sees it. Raises `UsageError` if no driver has made its ports."""

    def __init__(self, humanoid: Humanoid, folder: Path, period_s: float) -> None:
        self.humanoid, self.period_s = humanoid, period_s
        self._sensors = PortReader(folder / SENSORS)
        if self._sensors.names != sensor_fields(humanoid):
            raise UsageError(f"the port {folder / SENSORS} is not of a driver of {humanoid.name}")
        self._command = PortWriter(folder / COMMAND, command_fields(humanoid))
        self._values = np.zeros(len(self._command.names))

    def read(self, sensors: RobotSensors) -> None:
        """Write the newest measurements into `sensors`; NaN where the driver sends none."""
        port = self._sensors
        is_new = port.read() and port.age_s() < SENSOR_TIMEOUT_S
        sensors.time_s, end = float(port.values[0]), 3
        for part in _parts(sensors):
            part[:] = port.values[end : end + len(part)] if is_new else np.nan
            end += len(part)

    def write(self, command: JointCommand) -> None:
        """Publish a command."""
        _pack(command, self._values)
        if not np.isfinite(self._values).all():
            raise ValueError("the command has a value that is not finite; the driver keeps the last one")
        self._command.write(self._values)

    def wait(self) -> None:
        """Return at once: the cycle is paced by its own clock."""


class Driver:
    """A robot behind its ports; `cycle` is one period of it. Raises `UsageError` if another one runs."""

    def __init__(self, robot: Robot, folder: Path) -> None:
        self.robot = robot
        humanoid = robot.humanoid
        self.watchdog = Watchdog(humanoid, robot.period_s)
        self._port = PortWriter(folder / SENSORS, sensor_fields(humanoid))
        if not (folder / COMMAND).exists():
            PortWriter(folder / COMMAND, command_fields(humanoid)).close()
        self._commands = PortReader(folder / COMMAND)
        self._sensors, self._command = RobotSensors(humanoid), JointCommand(humanoid)
        self._values = np.zeros(len(self._port.names))

    def cycle(self) -> Safety:
        """Measure, publish, send the newest command or a safe one, and wait for the next period."""
        self.robot.read(self._sensors)
        self._publish()
        if self._commands.read():
            _unpack(self._commands.values, self._command)
        self.robot.write(self.watchdog.choose(self._command, self._commands.age_s(), self._sensors))
        self.robot.wait()
        return self.watchdog.state

    def _publish(self) -> None:
        values, end = self._values, 3
        values[0], values[1], values[2] = self._sensors.time_s, self.watchdog.state, self.watchdog.stalls
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
    for index, part in enumerate(_of(command)):
        values[index * count : (index + 1) * count] = part


def _unpack(values: Array, command: JointCommand) -> None:
    count = len(command.positions)
    for index, part in enumerate(_of(command)):
        part[:] = values[index * count : (index + 1) * count]
