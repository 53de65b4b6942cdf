"""The tasks: poses of frames, centre of mass, momentum, gaze, posture; velocities in axes of the world."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from handover.errors import UsageError
from services.whole_body_control.model.kinematics import BASE_POSITIONS, BASE_VELOCITIES, Array, Kinematics
from services.whole_body_control.tasks.base import Rows, Task

ALL_AXES = (True,) * 6
ROLL_AND_PITCH = (False, False, False, True, True, False)


class PoseTask(Task):
    """A link follows a pose. Axes: x, y, z, then turns about x, y, z; `axes` says which are controlled.

    `target` is a `pinocchio.SE3` in the world, `velocity` (6,) the desired velocity of the link there. A far
    target, also one beyond reach, is approached with `max_mps` and `max_radps`.
    """

    max_mps, max_radps = 1.0, 3.0

    def __init__(
        self,
        label: str,
        link: str,
        target: Any,
        gain: float = 10.0,
        *,
        axes: Sequence[bool] = ALL_AXES,
        velocity: Array | None = None,
    ) -> None:
        super().__init__(label, gain)
        self.link, self.target = link, target
        self.axes = np.array(axes, dtype=bool)
        self.velocity = np.zeros(6) if velocity is None else velocity

    def error(self, kinematics: Kinematics) -> Array:
        """Return the position error in m and the rotation vector to the target in rad."""
        error = _pose_error(kinematics.pose(self.link), self.target)
        return np.asarray(error[self.axes])

    def rows(self, kinematics: Kinematics) -> Rows:
        """Return the rows of the controlled axes."""
        of_error = self.gain * self.error(kinematics)
        is_linear = np.arange(6)[self.axes] < 3
        for rows, limit in ((is_linear, self.max_mps), (~is_linear, self.max_radps)):
            speed = float(np.linalg.norm(of_error[rows]))
            if speed > limit:
                of_error[rows] *= limit / speed
        return Rows(kinematics.jacobian(self.link)[self.axes], self.velocity[self.axes] + of_error)


class PointTask(Task):
    """A point of a link follows `target` (3,) in m, moving with `velocity` (3,) in m/s; turns are free."""

    def __init__(self, label: str, link: str, point: Array, target: Array, gain: float = 10.0) -> None:
        super().__init__(label, gain)
        self.link, self.point = link, np.asarray(point, dtype=np.float64)
        self.target, self.velocity = target, np.zeros(3)

    def error(self, kinematics: Kinematics) -> Array:
        """Return the distance to the target in m."""
        return np.asarray(self.target - kinematics.pose(self.link).act(self.point))

    def rows(self, kinematics: Kinematics) -> Rows:
        """Return the three rows."""
        jacobian, offset = kinematics.jacobian(self.link), kinematics.pose(self.link).rotation @ self.point
        return Rows(
            jacobian[:3] - pin.skew(offset) @ jacobian[3:], self.velocity + self.gain * self.error(kinematics)
        )


class OrientationTask(PoseTask):
    """A link stays upright: roll and pitch are held, the yaw is free, as the waist of CoSiMA."""

    def __init__(self, label: str, link: str, gain: float = 10.0) -> None:
        super().__init__(label, link, pin.SE3.Identity(), gain, axes=ROLL_AND_PITCH)

    def error(self, kinematics: Kinematics) -> Array:
        """Return the shortest turn that brings the z axis of the link upright, about x and y, in rad."""
        up = kinematics.pose(self.link).rotation[:, 2]
        turn = np.cross(up, [0.0, 0.0, 1.0])
        sine = float(np.linalg.norm(turn))
        angle = np.arctan2(sine, up[2])
        scale = angle / sine if sine > 1e-9 else 1.0
        return np.asarray(scale * turn[:2])


class RelativePoseTask(Task):
    """A link follows a pose in the frame of another link."""

    def __init__(self, label: str, link: str, base: str, target: Any, gain: float = 10.0) -> None:
        super().__init__(label, gain)
        self.link, self.base, self.target = link, base, target

    def error(self, kinematics: Kinematics) -> Array:
        """Return the position error in m and the rotation vector in rad, in axes of the world."""
        return _pose_error(kinematics.pose(self.link), kinematics.pose(self.base) * self.target)

    def rows(self, kinematics: Kinematics) -> Rows:
        """Return the six rows of the motion of the link as the base link sees it."""
        of_base = kinematics.jacobian(self.base)
        arm = kinematics.pose(self.link).translation - kinematics.pose(self.base).translation
        carried = of_base.copy()
        carried[:3] -= pin.skew(arm) @ of_base[3:]
        return Rows(kinematics.jacobian(self.link) - carried, self.gain * self.error(kinematics))


class CentreOfMassTask(Task):
    """The centre of mass follows `target` (3,) in m, moving with `velocity` (3,) in m/s."""

    def __init__(self, label: str, target: Array, gain: float = 10.0, velocity: Array | None = None) -> None:
        super().__init__(label, gain)
        self.target = target
        self.velocity = np.zeros(3) if velocity is None else velocity

    def error(self, kinematics: Kinematics) -> Array:
        """Return the distance to the target in m."""
        return np.asarray(self.target - kinematics.centre_of_mass())

    def rows(self, kinematics: Kinematics) -> Rows:
        """Return the three rows."""
        wanted = self.velocity + self.gain * self.error(kinematics)
        return Rows(kinematics.centre_of_mass_jacobian(), wanted)


class AngularMomentumTask(Task):
    """The angular momentum about the centre of mass follows `target` (3,) in kg m²/s; zero: no turning."""

    def __init__(self, label: str, target: Array | None = None) -> None:
        super().__init__(label, 0.0)
        self.target = np.zeros(3) if target is None else target

    def error(self, kinematics: Kinematics) -> Array:  # noqa: ARG002 - a momentum is no position
        """Return zero: the task has no position to return to."""
        return np.zeros(3)

    def rows(self, kinematics: Kinematics) -> Rows:
        """Return the three rows."""
        return Rows(kinematics.momentum_matrix()[3:], self.target)


class GazeTask(Task):
    """The x axis of a link points at `target` (3,) in m."""

    def __init__(self, label: str, link: str, target: Array, gain: float = 5.0) -> None:
        super().__init__(label, gain)
        self.link, self.target = link, target

    def error(self, kinematics: Kinematics) -> Array:
        """Return the shortest turn towards the target as a rotation vector in rad."""
        pose = kinematics.pose(self.link)
        ahead, wanted = pose.rotation[:, 0], self.target - pose.translation
        length = float(np.linalg.norm(wanted))
        if length < 1e-6:
            return np.zeros(3)
        turn = np.cross(ahead, wanted / length)
        sine, cosine = float(np.linalg.norm(turn)), float(ahead @ wanted) / length
        if sine < 1e-9:  # ahead of the link, or exactly behind it, where every way is as short
            return np.zeros(3) if cosine > 0 else np.pi * pose.rotation[:, 2]
        return np.asarray(turn * (np.arctan2(sine, cosine) / sine))

    def rows(self, kinematics: Kinematics) -> Rows:
        """Return the two rows across the line of sight; the turn about it is free."""
        across = kinematics.pose(self.link).rotation[:, 1:].T
        turning = kinematics.jacobian(self.link)[3:]
        return Rows(across @ turning, across @ (self.gain * self.error(kinematics)))


class JointTask(Task):
    """Some joints follow `target`; the posture is the task of all joints (CoSiMA, equation 4)."""

    def __init__(self, label: str, joints: Sequence[int], target: Array, gain: float = 1.0) -> None:
        super().__init__(label, gain)
        self.joints = np.array(joints, dtype=int)
        if len(self.joints) != len(target):
            raise UsageError(
                f'the task "{label}" has {len(self.joints)} joints, and {len(target)} targets for them'
            )
        self.target = np.asarray(target, dtype=np.float64)
        self.velocity = np.zeros(len(target))

    def error(self, kinematics: Kinematics) -> Array:
        """Return target minus position of each joint."""
        return np.asarray(self.target - kinematics.q[BASE_POSITIONS:][self.joints])

    def rows(self, kinematics: Kinematics) -> Rows:
        """Return one row for each joint."""
        jacobian = np.zeros((len(self.joints), kinematics.n_velocities))
        jacobian[np.arange(len(self.joints)), BASE_VELOCITIES + self.joints] = 1.0
        return Rows(jacobian, self.velocity + self.gain * self.error(kinematics))


def posture(kinematics: Kinematics, pose: str, gain: float = 1.0) -> JointTask:
    """Return the task that draws all joints to a named pose."""
    humanoid = kinematics.humanoid
    return JointTask("posture", range(len(humanoid.joints)), np.array(humanoid.pose(pose)), gain)


def _pose_error(actual: Any, target: Any) -> Array:
    turn = pin.log3(target.rotation @ actual.rotation.T)
    return np.concatenate([target.translation - actual.translation, turn])
