"""The torques that a motion needs, by inverse dynamics, and the slowest change of its timing that keeps them.

A motion that runs at the fraction `s` of its speed has velocities times s and accelerations times s^2. So the
torque of each joint is

    torque(s) = gravity + s^2 (torque(1) - gravity)

and the largest allowed s follows from each sample in closed form. Gravity alone must stay within the limit:
where it does not, no speed helps. Example: a joint with a limit of 100 Nm that needs 60 Nm against gravity
and 110 Nm at full speed may run at sqrt(40 / 50) = 0.89 of it.

The limits are the `effort` of the joints in the URDF; 0 is no limit. Friction and the inertia of the drives
are not in a URDF and not in the torque.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from handover_robots.model.joint_trajectory import JointTrajectory
from handover_robots.planning.arm import Arm, Array

COARSE_EVERY_S = 0.02
SURE_SHARE = 0.9
"""A motion whose bound at coarse samples is below this share of every limit needs no fine samples."""

RESERVE = 1e-9


@dataclass(frozen=True, slots=True)
class Overload:
    """Gravity alone loads a joint above its limit on the way of a motion."""

    joint: str
    needed: str
    limit: str


class Torques:
    """The inverse dynamics of an arm with a payload at the tip of its tool; not thread-safe."""

    def __init__(self, arm: Arm, payload_kg: float = 0.0) -> None:
        self.names = arm.model.joint_names
        self._is_turning = arm.is_turning
        self._model = arm.pin_model.copy()
        efforts = np.array(self._model.effortLimit)
        self.limits = np.where((efforts > 0) & np.isfinite(efforts), efforts, np.inf)
        """The limit of each joint in Nm or N; infinite without one."""
        self.payload_kg = payload_kg
        self.unchecked = self._why_unchecked()
        """Why torques cannot be checked; None if they can."""
        if payload_kg > 0:
            tip = arm.pin_model.frames[arm.tip]
            load = pin.Inertia(payload_kg, tip.placement.translation, np.zeros((3, 3)))
            self._model.inertias[tip.parentJoint] += load
        self._data = self._model.createData()

    def text(self, joint: int, torque: float) -> str:
        """Return a torque with its unit."""
        return f"{abs(torque):.0f} {'Nm' if self._is_turning[joint] else 'N'}"

    def of(self, joints: Array, velocities: Array, accelerations: Array) -> Array:
        """Return the torque of each joint."""
        torques: Array = pin.rnea(self._model, self._data, joints, velocities, accelerations)
        return torques

    def allowed_speed(self, trajectory: JointTrajectory) -> float | Overload:
        """Return the fraction of its speed, up to 1, at which a motion keeps the limits, or why none does."""
        if self.unchecked is not None or self._is_surely_within(trajectory):
            return 1.0
        # The acceleration is linear between the knots, so its extremes are there.
        times = np.asarray(np.arange(len(trajectory.points) - 2) * trajectory.spacing_s, dtype=np.float64)
        states = [trajectory.derivative(times, order) for order in range(3)]
        full = np.array([self.of(*state) for state in zip(*states, strict=True)])
        still = np.array(
            [pin.computeGeneralizedGravity(self._model, self._data, state) for state in states[0]]
        )
        shares = np.abs(still) / self.limits
        if shares.max() > 1.0:
            sample, joint = (int(index) for index in np.unravel_index(shares.argmax(), shares.shape))
            needed = self.text(joint, still[sample, joint])
            return Overload(self.names[joint], needed, self.text(joint, self.limits[joint]))
        moving = full - still
        room = self.limits - np.where(moving > 0, still, -still)
        squared = float((room / np.maximum(np.abs(moving), RESERVE)).min())
        return float(np.sqrt(squared)) * (1 - RESERVE) if squared < 1 else 1.0

    def _why_unchecked(self) -> str | None:
        inertias = self._model.inertias
        massless = [name for number, name in enumerate(self.names, 1) if not inertias[number].mass > 0]
        if massless:
            return f"the URDF has no inertia for what {', '.join(massless)} moves"
        if not np.isfinite(self.limits).any():
            return "the URDF has no limit of effort for any joint"
        return None

    def _is_surely_within(self, trajectory: JointTrajectory) -> bool:
        """Return whether a bound is below the limits: each acceleration at its maximum, with any sign."""
        count = max(int(np.ceil(trajectory.duration_s / COARSE_EVERY_S)), 1)
        times = np.linspace(0.0, trajectory.duration_s, count + 1)
        joints, velocities = (trajectory.derivative(times, order) for order in (0, 1))
        strongest = np.abs(np.diff(trajectory.points, 2, axis=0)).max(axis=0) / trajectory.spacing_s**2
        none = np.zeros(len(strongest))
        bounds = []
        for place, velocity in zip(joints, velocities, strict=True):
            inertia = np.abs(np.triu(pin.crba(self._model, self._data, place)))
            moving = inertia @ strongest + (inertia.T @ strongest - inertia.diagonal() * strongest)
            bounds.append(np.abs(self.of(place, velocity, none)) + moving)
        return bool((np.array(bounds) <= SURE_SHARE * self.limits).all())
