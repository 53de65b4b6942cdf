"""The tasks: poses of frames, centre of mass, momentum, gaze, posture; velocities in axes of the world."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from handover.errors import UsageError
from handover_humanoid.model.kinematics import (
    BASE_POSITIONS,
    BASE_VELOCITIES,
    Array,
    Kinematics,
    rotation_vector,
)
from handover_humanoid.tasks.base import Task

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
        self.link = link
        self.target = target
        self.axes = np.array(axes, dtype=bool)
        self._rows = _contiguous(np.flatnonzero(self.axes))
        self._linear = int(self.axes[:3].sum())
        self._size = int(self.axes.sum())
        self.velocity = np.zeros(6) if velocity is None else velocity

    @property
    def target(self) -> Any:
        """The pose to follow, a `pinocchio.SE3`."""
        return self._target

    @target.setter
    def target(self, pose: Any) -> None:
        self._target, self._place, self._orientation = pose, pose.translation, pose.rotation

    @property
    def size(self) -> int:
        """The number of controlled axes."""
        return self._size

    def error(self, kinematics: Kinematics) -> Array:
        """Return the position error in m and the rotation vector to the target in rad."""
        away = self._place - kinematics.translation(self.link)
        if self._linear == self._size:
            return np.asarray(away[self._rows])
        turn = rotation_vector(kinematics.rotation(self.link), self._orientation)
        return np.asarray(np.concatenate([away, turn])[self._rows])

    def write(self, kinematics: Kinematics, jacobian: Array, velocity: Array) -> None:
        """Write the rows of the controlled axes."""
        kinematics.write_jacobian(self.link, jacobian, self._rows)
        np.multiply(self.error(kinematics), self.gain, out=velocity)
        _limit(velocity[: self._linear], self.max_mps)
        _limit(velocity[self._linear :], self.max_radps)
        velocity += self.velocity[self._rows]


class PointTask(Task):
    """A point of a link follows `target` (3,) in m, moving with `velocity` (3,) in m/s; turns are free."""

    def __init__(self, label: str, link: str, point: Array, target: Array, gain: float = 10.0) -> None:
        super().__init__(label, gain)
        self.link, self.point = link, np.asarray(point, dtype=np.float64)
        self.target, self.velocity = target, np.zeros(3)

    def error(self, kinematics: Kinematics) -> Array:
        """Return the distance to the target in m."""
        return np.asarray(self.target - kinematics.pose(self.link).act(self.point))

    @property
    def size(self) -> int:
        """The number of rows."""
        return 3

    def write(self, kinematics: Kinematics, jacobian: Array, velocity: Array) -> None:
        """Write the three rows."""
        full, offset = kinematics.jacobian(self.link), kinematics.pose(self.link).rotation @ self.point
        np.subtract(full[:3], pin.skew(offset) @ full[3:], out=jacobian)
        np.multiply(self.error(kinematics), self.gain, out=velocity)
        velocity += self.velocity


class OrientationTask(PoseTask):
    """A link stays upright: roll and pitch are held, the yaw is free, as the waist of CoSiMA."""

    def __init__(self, label: str, link: str, gain: float = 10.0) -> None:
        super().__init__(label, link, pin.SE3.Identity(), gain, axes=ROLL_AND_PITCH)

    def error(self, kinematics: Kinematics) -> Array:
        """Return the shortest turn that brings the z axis of the link upright, about x and y, in rad."""
        x, y, z = kinematics.rotation(self.link)[:, 2].tolist()
        sine = math.hypot(x, y)
        scale = math.atan2(sine, z) / sine if sine > 1e-9 else 1.0
        return np.array([scale * y, -scale * x])


class RelativePoseTask(Task):
    """A link follows a pose in the frame of another link."""

    def __init__(self, label: str, link: str, base: str, target: Any, gain: float = 10.0) -> None:
        super().__init__(label, gain)
        self.link, self.base, self.target = link, base, target

    def error(self, kinematics: Kinematics) -> Array:
        """Return the position error in m and the rotation vector in rad, in axes of the world."""
        target = kinematics.pose(self.base) * self.target
        turn = rotation_vector(kinematics.rotation(self.link), target.rotation)
        return np.concatenate([target.translation - kinematics.translation(self.link), turn])

    @property
    def size(self) -> int:
        """The number of rows."""
        return 6

    def write(self, kinematics: Kinematics, jacobian: Array, velocity: Array) -> None:
        """Write the six rows of the motion of the link as the base link sees it."""
        of_base = kinematics.jacobian(self.base)
        arm = kinematics.pose(self.link).translation - kinematics.pose(self.base).translation
        kinematics.write_jacobian(self.link, jacobian)
        jacobian -= of_base
        jacobian[:3] += pin.skew(arm) @ of_base[3:]
        np.multiply(self.error(kinematics), self.gain, out=velocity)


class CentreOfMassTask(Task):
    """The centre of mass follows `target` (3,) in m, moving with `velocity` (3,) in m/s."""

    def __init__(self, label: str, target: Array, gain: float = 10.0, velocity: Array | None = None) -> None:
        super().__init__(label, gain)
        self.target = target
        self.velocity = np.zeros(3) if velocity is None else velocity

    def error(self, kinematics: Kinematics) -> Array:
        """Return the distance to the target in m."""
        return np.asarray(self.target - kinematics.centre_of_mass())

    @property
    def size(self) -> int:
        """The number of rows."""
        return 3

    def write(self, kinematics: Kinematics, jacobian: Array, velocity: Array) -> None:
        """Write the three rows."""
        kinematics.write_centre_of_mass_jacobian(jacobian)
        np.multiply(self.error(kinematics), self.gain, out=velocity)
        velocity += self.velocity


class _MomentumTask(Task):
    """A momentum follows `target` (3,): it has no place to return to, so there is no error and no gain."""

    def __init__(self, label: str, target: Array | None = None) -> None:
        super().__init__(label, 0.0)
        self.target = np.zeros(3) if target is None else target

    def error(self, kinematics: Kinematics) -> Array:  # noqa: ARG002 - a momentum is no position
        """Return zero."""
        return np.zeros(3)

    @property
    def size(self) -> int:
        """The number of rows."""
        return 3


class LinearMomentumTask(_MomentumTask):
    """The linear momentum, mass times velocity of the centre of mass, follows `target` (3,) in kg m/s.

    Against `CentreOfMassTask`, zero brings the body to rest wherever it is.
    """

    def write(self, kinematics: Kinematics, jacobian: Array, velocity: Array) -> None:
        """Write the three rows."""
        kinematics.write_centre_of_mass_jacobian(jacobian)
        jacobian *= kinematics.total_mass_kg
        velocity[:] = self.target


class AngularMomentumTask(_MomentumTask):
    """The angular momentum about the centre of mass follows `target` (3,) in kg m²/s; zero: no turning."""

    def write(self, kinematics: Kinematics, jacobian: Array, velocity: Array) -> None:
        """Write the three rows."""
        jacobian[:] = kinematics.momentum_matrix()[3:]
        velocity[:] = self.target


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

    @property
    def size(self) -> int:
        """The number of rows."""
        return 2

    def write(self, kinematics: Kinematics, jacobian: Array, velocity: Array) -> None:
        """Write the two rows across the line of sight; the turn about it is free."""
        across = kinematics.pose(self.link).rotation[:, 1:].T
        jacobian[:] = across @ kinematics.jacobian(self.link)[3:]
        velocity[:] = across @ (self.gain * self.error(kinematics))


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
        self._constant = np.zeros((len(self.joints), 0))

    def error(self, kinematics: Kinematics) -> Array:
        """Return target minus position of each joint."""
        return np.asarray(self.target - kinematics.q[BASE_POSITIONS:][self.joints])

    @property
    def size(self) -> int:
        """The number of joints."""
        return len(self.joints)

    def write(self, kinematics: Kinematics, jacobian: Array, velocity: Array) -> None:
        """Write one row for each joint."""
        if self._constant.shape != jacobian.shape:
            self._constant = np.zeros(jacobian.shape)
            self._constant[range(len(self.joints)), BASE_VELOCITIES + self.joints] = 1.0
        np.copyto(jacobian, self._constant)
        np.multiply(self.error(kinematics), self.gain, out=velocity)
        velocity += self.velocity


def posture(kinematics: Kinematics, pose: str, gain: float = 1.0) -> JointTask:
    """Return the task that draws all joints to a named pose."""
    humanoid = kinematics.humanoid
    return JointTask("posture", range(len(humanoid.joints)), np.array(humanoid.pose(pose)), gain)


def _limit(vector: Array, most: float) -> None:
    """Shorten a vector to a length."""
    length = math.hypot(*vector.tolist())
    if length > most:
        vector *= most / length


def _contiguous(rows: Any) -> Any:
    """Return row numbers as a slice where they follow each other, since numpy copies nothing then."""
    if len(rows) and rows[-1] - rows[0] + 1 == len(rows):
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows
