"""The watchdog of a driver: what the joints do while no new command comes.

It runs in the process of the driver, so that it acts when the process of the control cycle stalls or ends.
Commands older than `COMMAND_TIMEOUT_S` are not followed: the joints hold the last one, at rest. A robot that
tips over then is no longer held but damped, so that it falls softly, and stays so until it is started again.

Joints are held by impedance where the robot has this mode, else by their drives (`position`), else by torques
that are computed here. Joints that were commanded in positions are held there. Drives that accept positions
only cannot be damped: they are commanded to where they are.
"""

from collections.abc import Collection
from enum import IntEnum

import numpy as np

from handover.runtime.control_cycle import runs_in_cycle
from handover_humanoid.components.modes import ModeConversion
from handover_humanoid.components.robot import JointCommand, RobotSensors
from handover_humanoid.model.humanoid import Humanoid, JointMode

COMMAND_TIMEOUT_S = 0.05
FALLING_RAD, FALLING_S = 0.5, 0.1
"""A robot falls when its accelerometer is tilted by more than the first for the second."""
DAMPING_FACTOR = 3.0
"""Of the damping of the model, for joints without stiffness."""


HOLDING_MODES = (JointMode.IMPEDANCE, JointMode.POSITION, JointMode.TORQUE)
SOFT_MODES = (JointMode.IMPEDANCE, JointMode.TORQUE)


class Safety(IntEnum):
    """What the joints do: follow commands, hold the last one, or turn freely against their damping."""

    FOLLOWING = 0
    HOLDING = 1
    DAMPED = 2


class Watchdog:
    """Chooses the command of each period of a driver. Allocates nothing; not thread-safe.

    `modes` are those of the robot.
    """

    def __init__(self, humanoid: Humanoid, period_s: float, modes: Collection[JointMode]) -> None:
        self.state, self.stalls = Safety.HOLDING, 0
        """`stalls` counts how often commands stopped coming."""
        self._held = JointCommand(humanoid)
        self._stiffness, self._damping = self._held.stiffness.copy(), self._held.damping.copy()
        self._conversions = {mode: ModeConversion(humanoid, mode) for mode in HOLDING_MODES if mode in modes}
        self._mode = next(iter(self._conversions))
        self._upwards, self._tilted_s, self._period_s = np.zeros(3), 0.0, period_s

    @runs_in_cycle
    def choose(self, command: JointCommand, age_s: float, sensors: RobotSensors) -> JointCommand | None:
        """Return what to send: the newest command of an age in s, or a safe one.

        None means to send nothing: the robot has not been measured yet, or not for torques.
        """
        if not self._upwards.any():
            if not sensors.is_finite:
                return None
            self._upwards[:] = sensors.accelerometer
            self._held.positions[:] = sensors.positions
        if self.state is Safety.DAMPED:
            return self._safe(sensors)
        if age_s <= COMMAND_TIMEOUT_S and np.isfinite(command.positions).all():
            self.state, self._tilted_s = Safety.FOLLOWING, 0.0
            return command
        if self.state is Safety.FOLLOWING:
            self.stalls += 1
            self._hold(command)
        self.state = Safety.HOLDING
        self._watch(sensors)
        return self._safe(sensors)

    @runs_in_cycle
    def _safe(self, sensors: RobotSensors) -> JointCommand | None:
        held, conversion = self._held, self._conversions[self._mode]
        follows = self._mode is JointMode.POSITION and self.state is Safety.DAMPED
        if follows:
            if not sensors.is_finite:
                return None
            held.positions[:] = sensors.positions
        chosen = conversion.convert(held, sensors)
        return chosen if np.isfinite(chosen.torques).all() else None

    @runs_in_cycle
    def _hold(self, command: JointCommand) -> None:
        held = self._held
        held.positions[:] = command.positions
        is_soft = command.mode is JointMode.IMPEDANCE
        held.stiffness[:] = command.stiffness if is_soft else self._stiffness
        held.damping[:] = command.damping if is_soft else self._damping
        is_servo = command.mode is JointMode.POSITION
        self._mode = JointMode.POSITION if is_servo else next(iter(self._conversions))
        # The last torques answer a moment of a motion; held, they may push the robot over.
        held.velocities[:], held.torques[:] = 0.0, 0.0

    @runs_in_cycle
    def _watch(self, sensors: RobotSensors) -> None:
        """Damp the joints of a robot that tips over."""
        strength = np.sqrt(sensors.accelerometer.dot(sensors.accelerometer))
        upright = np.sqrt(self._upwards.dot(self._upwards))
        is_tilted = sensors.accelerometer.dot(self._upwards) < np.cos(FALLING_RAD) * strength * upright
        self._tilted_s = self._tilted_s + self._period_s if is_tilted else 0.0
        if self._tilted_s >= FALLING_S:
            self.state = Safety.DAMPED
            self._mode = next((mode for mode in SOFT_MODES if mode in self._conversions), self._mode)
            held = self._held
            held.stiffness[:] = 0.0
            held.damping *= DAMPING_FACTOR
