"""The robot as a component: MuJoCo is one implementation, a driver of a physical robot would be another.

Joint impedance runs below the interface, in the robot:

    torque = stiffness (position - q) + damping (velocity - q') + torque,  within the effort limits

All arrays are allocated once and written in place, so that a control cycle allocates no memory.
"""

from typing import Protocol

import numpy as np

from services.whole_body_control.model.humanoid import Humanoid


class RobotSensors:
    """What a humanoid measures; joints in the order of the model.

    `gyroscope` (3,) in rad/s and `accelerometer` (3,) in m/s² (at rest it shows 9.81 upwards) are those of
    the first inertial sensor, in its frame. `wrenches` has a row for each force-torque sensor, in the order
    of the model: the force in N and the torque in N m that the world exerts on the limb, in the frame of the
    sensor.
    """

    def __init__(self, humanoid: Humanoid) -> None:
        count = len(humanoid.joints)
        self.time_s = 0.0
        self.positions, self.velocities, self.torques = np.zeros(count), np.zeros(count), np.zeros(count)
        self.gyroscope, self.accelerometer = np.zeros(3), np.zeros(3)
        self.wrenches = np.zeros((len(humanoid.sensors.force_torque), 6))

    @property
    def is_finite(self) -> bool:
        """Return whether every value is a finite number."""
        parts = (self.positions, self.velocities, self.gyroscope, self.accelerometer, self.wrenches)
        return all(bool(np.isfinite(part).all()) for part in parts)


class JointCommand:
    """What the joints do; starts with the gains of the model, and with positions that a caller must set."""

    def __init__(self, humanoid: Humanoid) -> None:
        gains = [joint.gains for joint in humanoid.joints]
        self.positions = np.zeros(len(gains))
        self.velocities, self.torques = np.zeros(len(gains)), np.zeros(len(gains))
        self.stiffness = np.array([each.stiffness for each in gains])
        self.damping = np.array([each.damping for each in gains])


class Robot(Protocol):
    """A humanoid that can be measured and commanded, simulated or not."""

    humanoid: Humanoid
    period_s: float

    def read(self, sensors: RobotSensors) -> None:
        """Write the newest measurements into `sensors`."""
        ...

    def write(self, command: JointCommand) -> None:
        """Send a command, which holds until the next one."""
        ...

    def wait(self) -> None:
        """Return when the next period of `period_s` begins."""
        ...
