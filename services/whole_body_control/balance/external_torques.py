"""Torques that people and things exert on the joints, from joint torques and the motion of the whole body.

What a joint has to give without any contact is the inverse dynamics of the measured motion; the rest is
external. A walking robot accelerates its arms by some newtons, so that accelerations count: they are the
differences of the estimated velocities, of joints and base, smoothed with the time constant `SMOOTHING_S`.
The torques are smoothed alike, so that both belong to the same moment.
"""

import math

import numpy as np

from services.whole_body_control.balance.contact_forces import UPWARDS
from services.whole_body_control.balance.estimation import StateEstimator
from services.whole_body_control.components.robot import RobotSensors
from services.whole_body_control.model.kinematics import BASE_VELOCITIES

SMOOTHING_S = 0.06


class ExternalTorques:
    """Follows the estimate of an estimator, whose kinematics it uses. Not thread-safe."""

    def __init__(self, estimator: StateEstimator, period_s: float) -> None:
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
        self._is_new = True

    def restart(self) -> None:
        """Forget the past, after a time without `update`."""
        self._is_new = True

    def update(self, sensors: RobotSensors) -> None:
        """Compute `torques` from the sensors that the estimator has used last; call it every period."""
        v = self._estimator.v
        if self._is_new:
            self._velocity[:] = v
        kinematics = self._estimator.kinematics
        acceleration = self._share / self._period_s * (v - self._velocity)
        self._velocity += self._share * (v - self._velocity)
        even = kinematics.inverse_dynamics(v, self._still, UPWARDS)
        inertial = kinematics.inverse_dynamics(v, acceleration, UPWARDS) - even
        inertial += self._drive_inertia * acceleration
        joints = slice(BASE_VELOCITIES, None)
        now = even[joints] + self._damping * v[joints] - sensors.torques
        is_known = not self._is_new and bool(np.isfinite(self._smooth).all())
        self._smooth = self._smooth + self._share * (now - self._smooth) if is_known else now
        self._is_new = False
        self.torques = self._smooth + inertial[joints]
