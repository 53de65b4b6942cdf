"""The robot as a component: MuJoCo is one implementation, a driver of a physical robot would be another.

Joint impedance runs below the interface, in the robot:

    torque = stiffness (position - q) + damping (velocity - q') + torque,  within the effort limits

That is the mode `impedance`. Drives that accept positions or torques only get the same command converted
(`components.modes`). All arrays are allocated once and written in place, so that a control cycle allocates
no memory.
"""

import math
from typing import Protocol

import numpy as np

from handover.messages import number_text
from handover.runtime.control_cycle import runs_in_cycle
from handover_humanoid.model.humanoid import Grip, Humanoid, JointMode
from handover_humanoid.model.kinematics import Array


class RobotSensors:
    """What a humanoid measures; joints in the order of the model.

    `gyroscope` (3,) in rad/s and `accelerometer` (3,) in m/s² (at rest it shows 9.81 upwards) are those of
    the first inertial sensor, in its frame. `wrenches` has a row for each force-torque sensor, in the order
    of the model: the force in N and the torque in N m that the world exerts on the limb, in the frame of the
    sensor.
    """

    def __init__(self, humanoid: Humanoid) -> None:
        count, sensors = len(humanoid.joints), len(humanoid.sensors.force_torque)
        self.time_s = 0.0
        self.torques = np.zeros(count)
        self._needed = np.zeros(2 * count + 6 + 6 * sensors)
        """What a controller cannot do without: all but the torques, which are parts of it."""
        self.positions, self.velocities = self._needed[:count], self._needed[count : 2 * count]
        self.gyroscope, self.accelerometer, wrenches = np.split(self._needed[2 * count :], [3, 6])
        self.wrenches = wrenches.reshape(sensors, 6)
        self._zeros = np.zeros(len(self._needed))

    @property
    def is_finite(self) -> bool:
        """Return whether every value but the torques is a finite number."""
        return math.isfinite(self._needed.dot(self._zeros))  # 0 times infinity is not a number


NOT_FINITE = "a sensor has a value that is not finite; the last command holds"
"""What a controller says that holds the last command."""


class JointCommand:
    """What the joints do; starts with the gains of the model, and with positions that a caller must set.

    In the mode `position` only the positions count, in `torque` only the torques. `is_led` says that a person
    who holds the hands leads the motion.
    """

    def __init__(self, humanoid: Humanoid) -> None:
        self.mode, self.is_led = JointMode.IMPEDANCE, False
        gains = [joint.gains for joint in humanoid.joints]
        self.positions = np.zeros(len(gains))
        self.velocities, self.torques = np.zeros(len(gains)), np.zeros(len(gains))
        self.stiffness = np.array([gain.stiffness for gain in gains])
        self.damping = np.array([gain.damping for gain in gains])


class Interpolation:
    """Spreads the commands of a controller over the shorter periods of the robot.

    A controller commands where the joints are at the end of its period, and their velocity until then. Each
    call of `next` moves `command` one period of the robot further; after the last it stays there.
    """

    def __init__(self, humanoid: Humanoid, start: Array, control_s: float, period_s: float) -> None:
        self.steps = round(control_s / period_s)
        if self.steps < 1 or abs(self.steps * period_s - control_s) > 1e-9:
            raise ValueError(
                f"the period of a controller is {number_text(control_s)} s; it must be a multiple of that of "
                f"the robot, {number_text(period_s)} s"
            )
        self.command = JointCommand(humanoid)
        self.command.positions[:] = start
        self._end = self.command.positions.copy()
        self._period_s, self._left = period_s, 0

    @property
    def is_due(self) -> bool:
        """Return whether the controller is to compute the next command."""
        return self._left == 0

    @runs_in_cycle
    def start(self, wanted: JointCommand) -> None:
        """Accept a command of the controller."""
        command = self.command
        self._end[:], command.velocities[:] = wanted.positions, wanted.velocities
        command.torques[:] = wanted.torques
        command.stiffness[:], command.damping[:] = wanted.stiffness, wanted.damping
        command.is_led = wanted.is_led
        self._left = self.steps

    @runs_in_cycle
    def rest(self) -> None:
        """Stay at the end of the last command for a period of the controller."""
        self.command.velocities[:] = 0.0
        self._left = self.steps

    @runs_in_cycle
    def next(self) -> JointCommand:
        """Return the command of the next period of the robot."""
        self._left = max(self._left - 1, 0)
        np.multiply(self.command.velocities, -self._left * self._period_s, out=self.command.positions)
        self.command.positions += self._end
        return self.command


class Robot(Protocol):
    """A humanoid that can be measured and commanded, simulated or not."""

    humanoid: Humanoid
    period_s: float
    modes: tuple[JointMode, ...]
    """The modes of commands that it follows."""
    is_simulated: bool
    """Whether nobody can be hurt: only then it may be led by the hands of a person."""
    delay_s: float
    """How long ago the newest measurements were made, as far as the link to the robot shows it."""

    @runs_in_cycle
    def read(self, sensors: RobotSensors) -> None:
        """Write the newest measurements into `sensors`."""
        ...

    @runs_in_cycle
    def write(self, command: JointCommand) -> None:
        """Send a command, which holds until the next one.

        Raises `ValueError` for values that are not finite, and for a mode that is none of `modes`.
        """
        ...

    def wait(self) -> None:
        """Return when the next period of `period_s` begins."""
        ...

    def close(self) -> None:
        """Leave the robot; a driver lets it hold."""
        ...


class World(Protocol):
    """What a simulation offers beside the joints: a ball, and people who hold the hands of the robot.

    Places and forces (3,) are in the frame of the root link, so that the robot's own estimate moves them to
    the ground. A robot without it neither juggles nor feels people.
    """

    def hold(self, grip: Grip) -> None:
        """Put the ball into a hand, at rest in it."""
        ...

    def release(self) -> None:
        """Open the hand that holds the ball."""
        ...

    def ball_from_root(self) -> Array:
        """Return where the ball is, in m."""
        ...

    def pull(self, link: str, force: Array) -> None:
        """Pull at a link with a force in N until the next call."""
        ...
