"""Torques and forces that people and things exert on the robot, apart from those of its own motion.

What a joint has to give without any contact is the inverse dynamics of the measured motion; the rest is
external. A walking robot accelerates its arms by some newtons, so that accelerations count: they are the
differences of the estimated velocities, of joints and base, smoothed with the time constant `SMOOTHING_S`.
The torques are smoothed alike, so that both belong to the same moment.

The dry friction of its joints can hide a force at a hand from the torques of an arm. A force-torque sensor in
the arm shows the force, less what moves the limb beyond the sensor.
"""

import math
from collections.abc import Sequence

import numpy as np

from handover_humanoid.balance.contact_forces import UPWARDS
from handover_humanoid.balance.estimation import StateEstimator
from handover_humanoid.components.robot import RobotSensors
from handover_humanoid.model.kinematics import BASE_VELOCITIES, Array

SMOOTHING_S = 0.06


class ExternalTorques:
    """Follows the estimate of an estimator, whose kinematics it uses. Not thread-safe.

    `hands` are links whose forces are wanted as well.
    """

    def __init__(self, estimator: StateEstimator, period_s: float, hands: Sequence[str] = ()) -> None:
        self._estimator, self._period_s = estimator, period_s
        self._share = 1.0 - math.exp(-period_s / SMOOTHING_S)
        kinematics = estimator.kinematics
        self._damping = kinematics.joint_damping()
        self._drive_inertia = kinematics.humanoid.drive_inertia
        self._still = np.zeros(kinematics.n_velocities)
        self._velocity = self._still.copy()
        self.torques = np.zeros(len(kinematics.humanoid.joints))
        """By joint, in N m; a foot on the ground counts as well. NaN after a measurement that was none."""
        self._smooth = self.torques.copy()
        sensed = {hand: kinematics.force_sensor(hand) for hand in hands}
        self._sensors = {hand: sensor for hand, sensor in sensed.items() if sensor is not None}
        self.forces = {hand: np.zeros(3) for hand in self._sensors}
        """By hand with a sensor between it and the body: (3,) in N on the ground; NaN as above."""
        self._smooth_forces = {hand: np.zeros(3) for hand in self._sensors}
        self._is_new = True

    def restart(self) -> None:
        """Forget the past, after a time without `update`."""
        self._is_new = True

    def update(self, sensors: RobotSensors) -> None:
        """Compute `torques` and `forces` from the sensors that the estimator has used last; call it every
        period."""
        v = self._estimator.v
        if self._is_new:
            self._velocity[:] = v
        kinematics = self._estimator.kinematics
        acceleration = self._share / self._period_s * (v - self._velocity)
        self._velocity += self._share * (v - self._velocity)
        even = kinematics.inverse_dynamics(v, self._still, UPWARDS)
        even_forces = self._needed_forces()
        inertial = kinematics.inverse_dynamics(v, acceleration, UPWARDS) - even
        inertial += self._drive_inertia * acceleration
        joints = slice(BASE_VELOCITIES, None)
        now = even[joints] + self._damping * v[joints] - sensors.torques
        self._smooth = self._smoothed(self._smooth, now)
        self.torques = self._smooth + inertial[joints]
        for hand, force in self._needed_forces().items():
            link, _, row = self._sensors[hand]
            measured = kinematics.pose(link).rotation @ sensors.wrenches[row, :3]
            before, needed = self._smooth_forces[hand], even_forces[hand]
            self._smooth_forces[hand] = self._smoothed(before, needed + measured)
            self.forces[hand] = self._smooth_forces[hand] + force - needed
        self._is_new = False

    def _smoothed(self, before: Array, now: Array) -> Array:
        is_known = not self._is_new and bool(np.isfinite(before).all())
        return before + self._share * (now - before) if is_known else now

    def _needed_forces(self) -> dict[str, Array]:
        """Return what the limbs beyond the sensors need for the motion of the last inverse dynamics."""
        kinematics = self._estimator.kinematics
        return {hand: kinematics.force_through(joint_id) for hand, (_, joint_id, _) in self._sensors.items()}
