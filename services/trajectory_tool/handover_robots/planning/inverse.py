"""Inverse kinematics: joint positions with the tip of the tool at a pose.

A closed form is used where the robot model has one. Otherwise it is Levenberg-Marquardt with the damping of
Sugihara ("Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt method", IEEE T-RO 27(5),
2011), from the given joints first, and then from random ones. Steps are clipped to the position limits.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.linalg import LinAlgError

from handover_robots.model.poses import Pose
from handover_robots.planning.arm import Arm, Array, pose_of, se3_of

POSITION_TOLERANCE_M = 1e-6
ORIENTATION_TOLERANCE_RAD = 1e-5
MAX_ITERATIONS = 40
MAX_RESTARTS = 100
RESTARTS_FOR_SEVERAL = 12
SAME_JOINTS_RAD = 1e-3
BIAS = 1e-4
"""Damping at the solution: it keeps steps finite in singularities."""

STALLED = 0.98
"""A restart follows when an iteration reduces the squared error by less, twice."""

Accept = Callable[[Array], bool]


@dataclass(frozen=True, slots=True)
class NearestPose:
    """The nearest to an unreachable pose that was found, and how far it is away."""

    pose: Pose
    joints: Array
    distance_m: float
    angle_rad: float


INSET_RAD = 0.005
"""Iterations end this far within the limits: a timed curve between such joints may swing a little beyond."""


class Inverse:
    """Inverse kinematics of an arm; deterministic for a seed. Not thread-safe."""

    def __init__(self, arm: Arm, seed: int = 0) -> None:
        self.arm = arm
        self._random = np.random.default_rng(seed)
        closed_form = arm.model.solutions
        self._closed_form = closed_form
        self._low = np.maximum(arm.lower, np.where(arm.is_turning, -math.pi, arm.lower))
        self._high = np.minimum(arm.upper, np.where(arm.is_turning, math.pi, arm.upper))

    def solve(self, pose: Pose, near: Array, accept: Accept | None = None) -> Array | None:
        """Return joints with the tip at `pose`, those near `near` first; None if none are found."""
        if self._closed_form is not None:
            solutions = self._all(pose, near)
            solutions.sort(key=lambda joints: _effort(joints, near))
            return next((solution for solution in solutions if accept is None or accept(solution)), None)
        return next(self._numeric(se3_of(pose), near, accept, MAX_RESTARTS), None)

    def several(self, pose: Pose, near: Array, count: int, accept: Accept | None = None) -> list[Array]:
        """Return up to `count` distinct solutions, the nearest first; full turns make distinct ones."""
        solutions: list[Array] = []
        if self._closed_form is not None:
            solutions = self._all(pose, near)
        else:
            for joints in self._numeric(se3_of(pose), near, accept, RESTARTS_FOR_SEVERAL):
                if all(np.abs(joints - other).max() > SAME_JOINTS_RAD for other in solutions):
                    solutions.append(joints)
                if len(solutions) >= count:
                    break
            solutions = solutions or [
                solution for solution in [self.solve(pose, near, accept)] if solution is not None
            ]
        spread = [turned for joints in solutions for turned in self.arm.equivalents(joints)]
        spread.sort(key=lambda joints: _effort(joints, near))
        accepted = []
        for joints in spread:
            if accept is None or accept(joints):
                accepted.append(joints)
                if len(accepted) >= count:
                    break
        return accepted

    def nearest(self, pose: Pose, near: Array) -> NearestPose:
        """Return the nearest pose that is found for one out of reach; the position counts most."""
        target = se3_of(pose)
        weights = np.array([1.0, 1.0, 1.0, 0.05, 0.05, 0.05])
        best: tuple[float, Array] | None = None
        for start in (near, *(self._sample() for _ in range(8))):
            joints, error = self._approach(target, start, weights, 3 * MAX_ITERATIONS)
            if best is None or error < best[0]:
                best = (error, joints)
        assert best is not None  # noqa: S101 - the loop runs
        reached = self.arm.tool(best[1])
        turn = float(np.linalg.norm(pin.log3(reached.rotation.T @ target.rotation)))
        away = float(np.linalg.norm(reached.translation - target.translation))
        return NearestPose(pose_of(reached), best[1], away, turn)

    def _all(self, pose: Pose, near: Array) -> list[Array]:
        """Return the solutions of the closed form, each turned as near to `near` as the limits allow."""
        assert self._closed_form is not None  # noqa: S101 - callers checked
        solutions = self._closed_form(self.arm.model.flange_for(pose), tuple(near.tolist()))
        turned = (self.arm.nearest_equivalent(np.array(joints), near) for joints in solutions)
        return [joints for joints in turned if joints is not None]

    def _numeric(self, target: Any, near: Array, accept: Accept | None, restarts: int) -> Iterator[Array]:
        start = np.clip(near, self.arm.lower, self.arm.upper)
        for _ in range(restarts):
            joints = self.converge(target, start)
            if joints is not None and (accept is None or accept(joints)):
                yield joints
            start = self._sample()

    def _sample(self) -> Array:
        return np.asarray(self._random.uniform(self._low, self._high))

    def converge(self, target: Any, start: Array) -> Array | None:
        """Return the joints with the tip at a `pinocchio.SE3` that iterations from `start` lead to."""
        arm, data, model = self.arm, self.arm.data, self.arm.pin_model
        lower, upper, tip = arm.lower + INSET_RAD, arm.upper - INSET_RAD, arm.tip
        identity = np.eye(6)
        joints, before, stalls = start, math.inf, 0
        for _ in range(MAX_ITERATIONS):
            pin.computeJointJacobians(model, data, joints)
            error = pin.log6(pin.updateFramePlacement(model, data, tip).actInv(target)).vector
            jacobian = pin.getFrameJacobian(model, data, tip, pin.ReferenceFrame.LOCAL)
            squared = float(error @ error)
            if squared < POSITION_TOLERANCE_M**2 or (
                float(error[:3] @ error[:3]) < POSITION_TOLERANCE_M**2
                and float(error[3:] @ error[3:]) < ORIENTATION_TOLERANCE_RAD**2
            ):
                return joints if arm.is_within(joints) else None
            if squared > STALLED * before:
                stalls += 1
                if stalls > 2:
                    return None
            before = squared
            damped = jacobian @ jacobian.T + (0.05 * squared + BIAS * min(squared, 1.0) + 1e-12) * identity
            try:
                step = jacobian.T @ np.linalg.solve(damped, error)
            except LinAlgError:
                return None
            joints = np.minimum(np.maximum(joints + step, lower), upper)
        return None

    def _approach(self, target: Any, start: Array, weights: Array, iterations: int) -> tuple[Array, float]:
        """Return the joints with the least weighted error, and that error."""
        arm, data, model = self.arm, self.arm.data, self.arm.pin_model
        joints = np.clip(start, arm.lower, arm.upper)
        least, best, damping = math.inf, joints, 1e-2
        for _ in range(iterations):
            pin.computeJointJacobians(model, data, joints)
            reached = pin.updateFramePlacement(model, data, arm.tip)
            jacobian = pin.getFrameJacobian(model, data, arm.tip, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            turn = reached.rotation @ pin.log3(reached.rotation.T @ target.rotation)
            error = np.concatenate([target.translation - reached.translation, turn]) * weights
            squared = float(error @ error)
            if squared < least:
                least, best, damping = squared, joints, damping / 2
            else:
                damping *= 3
                joints = best
                if damping > 1e4:
                    break
            weighted = jacobian * weights[:, None]
            damped = weighted @ weighted.T + (damping + 1e-9) * np.eye(6)
            step = weighted.T @ np.linalg.solve(damped, error)
            joints = np.clip(joints + step, arm.lower, arm.upper)
        return best, math.sqrt(least)


def _effort(joints: Array, near: Array) -> tuple[float, float]:
    ways = np.abs(joints - near)
    return (round(float(ways.max()), 9), float(ways.sum()))
