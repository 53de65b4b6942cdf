"""Commands of joint impedance in the mode that the drives of a robot accept.

Controllers compute joint impedance (`JointCommand`). Drives may accept less:

- `position`: a drive with the stiffness K and damping D of its own makes the torque K (p - q) - D q'. So that
  it has the wanted torque on the reference, its deflection is added:
  p = position + (torque + D velocity) / K.
  The stiffness of the command is lost; the joints are as stiff as the drives.
- `torque`: the impedance is computed here from the measured joints, in each period of the robot, within the
  effort limits. A joint whose sensor has no valid value keeps its last torque while others have one: if all
  joints kept theirs, the robot would sink.
"""

from collections.abc import Callable, Collection

import numpy as np

from handover.errors import UsageError
from handover_humanoid.components.robot import JointCommand, RobotSensors
from handover_humanoid.model.humanoid import Humanoid, JointMode
from handover_humanoid.model.kinematics import Array


def require_mode(mode: JointMode, offered: Collection[JointMode], thing: str) -> None:
    """Raise `UsageError` if `thing` (a model, a driver) does not have the mode."""
    if mode not in offered:
        there = ", ".join(joint_mode for joint_mode in JointMode if joint_mode in offered) or "none"
        raise UsageError(
            f'{thing} does not have the mode "{mode}" of joints; it has: {there}. Choose one of them'
        )


class ModeConversion:
    """Converts commands of joint impedance to a mode. Allocates nothing after it is made; not thread-safe.

    Raises `UsageError` for a mode that the model does not have.
    """

    def __init__(self, humanoid: Humanoid, mode: JointMode) -> None:
        require_mode(mode, humanoid.modes, f"the model {humanoid.name}")
        self.mode = mode
        self._converted = JointCommand(humanoid)
        self._converted.mode = mode
        self._work = np.zeros(len(humanoid.joints))
        self._known = np.full((2, len(humanoid.joints)), np.nan)
        """Positions and velocities as they were measured last."""
        self._is_valid = np.zeros(len(humanoid.joints), dtype=np.bool_)
        self._max_efforts = np.array([joint.max_effort for joint in humanoid.joints])
        self._min_efforts = -self._max_efforts
        converters: dict[JointMode, Callable[[JointCommand, RobotSensors], JointCommand]] = {
            JointMode.POSITION: self._to_positions,
            JointMode.IMPEDANCE: lambda command, _: command,
            JointMode.TORQUE: self._to_torques,
        }
        self.convert = converters[mode]
        """Return a command of joint impedance in this mode; it is valid until the next call."""
        if mode is JointMode.POSITION:
            servo = [joint.servo or joint.gains for joint in humanoid.joints]
            self._converted.stiffness[:] = [gains.stiffness for gains in servo]
            self._converted.damping[:] = [gains.damping for gains in servo]
        elif mode is JointMode.TORQUE:
            self._converted.stiffness[:] = self._converted.damping[:] = 0.0

    @property
    def needs_sensors(self) -> bool:
        """Whether each command needs the joints as they are now."""
        return self.mode is JointMode.TORQUE

    def _to_positions(self, command: JointCommand, _: RobotSensors) -> JointCommand:
        converted = self._converted
        np.multiply(converted.damping, command.velocities, out=converted.positions)
        converted.positions += command.torques
        converted.positions /= converted.stiffness
        converted.positions += command.positions
        converted.is_led = command.is_led
        return converted

    def _to_torques(self, command: JointCommand, sensors: RobotSensors) -> JointCommand:
        converted, torques = self._converted, self._converted.torques
        positions = self._last_valid(sensors.positions, self._known[0])
        velocities = self._last_valid(sensors.velocities, self._known[1])
        np.subtract(command.positions, positions, out=torques)
        torques *= command.stiffness
        np.subtract(command.velocities, velocities, out=self._work)
        self._work *= command.damping
        torques += self._work
        torques += command.torques
        np.clip(torques, self._min_efforts, self._max_efforts, out=torques)
        converted.positions[:], converted.is_led = positions, command.is_led
        return converted

    def _last_valid(self, measured: Array, last_valid: Array) -> Array:
        """Return what was measured, with the last valid value where a joint has none; NaN if none has."""
        np.isfinite(measured, out=self._is_valid)
        if not self._is_valid.any():
            return measured
        np.copyto(last_valid, measured, where=self._is_valid)
        return last_valid
