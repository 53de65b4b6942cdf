"""Throws: the state of the arm at the release, found from ballistics, and the motion through it.

For a place where the ball should land and a time of flight T, the release velocity follows from the place of
the hand; the arm's Jacobian J gives the joint velocities q' = J+ v. Place and T are chosen so that the joint
that uses most of its velocity limit uses least of it, with room for swing and follow-through within the
limits of position, and so that the arm touches nothing. The motion is one bell of minimum jerk for all
joints, whose peak is the release: there the acceleration is zero, so that an early or late release changes
the velocity least.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import minimize

from handover.errors import UsageError
from handover.messages import number_text
from handover_humanoid.model.humanoid import Grip
from handover_humanoid.model.kinematics import BASE_POSITIONS, BASE_VELOCITIES, Array, Kinematics
from handover_humanoid.patterns.ballistics import release_velocity
from handover_humanoid.patterns.minimum_jerk import moved, moved_integral
from handover_humanoid.tasks.self_collision import SelfCollision

MIN_FLIGHT_S, MAX_FLIGHT_S = 0.2, 0.8
MIN_DISTANCE_M = 0.3
MIN_AHEAD_M, MIN_RELEASE_HEIGHT_M = 0.05, 0.3
"""The ball is released in front of the body, and above the legs."""
LIMIT_MARGIN_RAD = 0.05
ROUNDS: Final = 60
CONTORTION_WEIGHTS: Final = (0.002, 0.02, 0.1)
"""Costs of an arm far from its first guess, in shares of a limit per rad²; the next where an arm touches."""
CHECKED, CLEARANCE_M = 6, 0.001
REACH_TRIALS: Final = 16


class OutOfReach(UsageError):
    """The robot cannot throw there; `nearest` (3,) is the nearest place on the way that it can reach."""

    def __init__(self, message: str, nearest: Array | None) -> None:
        super().__init__(message)
        self.nearest = nearest


@dataclass(frozen=True, slots=True)
class ThrowLimits:
    """What a throw may use: shares of the velocity limits of joints, and durations."""

    speed_share: float = 0.95
    wrist_share: float = 0.3
    """Joints whose effort limit is below `weak_nm` are used less: they accelerate the ball badly."""
    weak_nm: float = 10.0
    durations_s: tuple[float, ...] = (0.56, 0.44, 0.36, 0.24)
    """Of swing and of follow-through, the preferred first: short ones turn the feet on the ground."""


@dataclass(frozen=True, slots=True)
class PlannedThrow:
    """A throw of one arm, in its joints (n,): at the release they are at `release`, moving with `velocity`.

    `start` and `end` are where the arm is at rest. `position` and `ball_velocity` (3,) are those of the ball
    at the release, `landing` (3,) is the target, `usage` the largest share of a velocity limit.
    """

    grip: Grip
    landing: Array
    flight_s: float
    release: Array
    velocity: Array
    position: Array
    ball_velocity: Array
    usage: float
    swing_s: float
    follow_s: float

    @property
    def start(self) -> Array:
        """Return the joints at rest before the swing."""
        return np.asarray(self.release - self.velocity * self.swing_s / 2)

    @property
    def end(self) -> Array:
        """Return the joints at rest after the follow-through."""
        return np.asarray(self.release + self.velocity * self.follow_s / 2)

    @property
    def duration_s(self) -> float:
        """Return the time from rest to rest."""
        return self.swing_s + self.follow_s

    def joints(self, time_s: float) -> tuple[Array, Array]:
        """Return the positions and velocities of the arm `time_s` after the start of the swing."""
        if time_s <= self.swing_s:
            share = max(time_s, 0.0) / self.swing_s
            way = self.velocity * (moved_integral(share) * self.swing_s)
            return self.start + way, self.velocity * moved(share)
        share = max(self.duration_s - time_s, 0.0) / self.follow_s
        way = self.velocity * (moved_integral(share) * self.follow_s)
        return self.end - way, self.velocity * moved(share)


class ThrowPlanner:
    """Plans throws of one hand from a configuration `q` in which the robot stands. Not thread-safe."""

    def __init__(
        self, kinematics: Kinematics, q: Array, grip: Grip, limits: ThrowLimits | None = None
    ) -> None:
        self._kinematics, self._q, self.grip = kinematics, q.copy(), grip
        self.limits = limits or ThrowLimits()
        humanoid = kinematics.humanoid
        self._arm = np.array(humanoid.indices(grip.arm))
        joints = [humanoid.joints[index] for index in self._arm]
        self._lower = np.array([joint.lower for joint in joints]) + LIMIT_MARGIN_RAD
        self._upper = np.array([joint.upper for joint in joints]) - LIMIT_MARGIN_RAD
        self._fastest = np.array([joint.max_velocity for joint in joints])
        self._collision = SelfCollision(kinematics)
        weak = np.array([joint.max_effort < self.limits.weak_nm for joint in joints])
        self._weights = self._fastest * np.where(weak, self.limits.wrist_share, 1.0)
        self._middle = np.clip(q[BASE_POSITIONS + self._arm], self._lower, self._upper)

    def plan(self, landing: Array, flight_s: float | None = None) -> PlannedThrow:
        """Return a throw that lands at `landing` (3,) in m, in the frame of `q`.

        The time of flight is chosen, or is `flight_s`: a longer one makes a higher arc. Raises `OutOfReach`
        with the nearest place on the line from the body that can be reached.
        """
        target = np.asarray(landing, dtype=np.float64)
        if target.shape != (3,) or not np.isfinite(target).all():
            raise UsageError(
                f"the place where the ball lands is {landing}; it must be three finite numbers in m"
            )
        if target[0] - self._q[0] < MIN_DISTANCE_M:
            raise UsageError(
                f"the place where the ball lands is {target[0] - self._q[0]:.2f} m in front of the robot; "
                f"it must be {MIN_DISTANCE_M} m or more in front"
            )
        if flight_s is not None and not MIN_FLIGHT_S <= flight_s <= MAX_FLIGHT_S:
            raise UsageError(
                f"a flight of {number_text(flight_s)} s is not offered; choose one from {MIN_FLIGHT_S} to "
                f"{MAX_FLIGHT_S} s"
            )
        throw = self._best(target, flight_s)
        if throw is not None and throw.usage <= self.limits.speed_share:
            return throw
        nearest = self._nearest(target, flight_s)
        where = ", ".join(f"{value:.2f}" for value in target)
        if nearest is None:
            raise OutOfReach(
                f"the {self.grip.name} cannot throw to ({where}) m, nor nearer on that line", None
            )
        there = ", ".join(f"{value:.2f}" for value in nearest)
        reason = (
            "no arm position allows it" if throw is None else f"it needs {throw.usage:.1%} of a joint speed"
        )
        allowed = self.limits.speed_share
        raise OutOfReach(
            f"the {self.grip.name} cannot throw to ({where}) m: {reason}, and {allowed:.1%} is allowed; "
            f"the farthest place on that line is ({there}) m",
            nearest,
        )

    def _nearest(self, target: Array, flight_s: float | None) -> Array | None:
        """Return the farthest reachable place on the line from the place above the feet to the target."""
        base = np.array([self._q[0], self._q[1], target[2]])
        least = MIN_DISTANCE_M / max(float(np.linalg.norm(target - base)), MIN_DISTANCE_M)
        for share in np.linspace(1.0, least, REACH_TRIALS):
            place = base + share * (target - base)
            throw = self._best(place, flight_s, CONTORTION_WEIGHTS[1:2])
            if throw is not None and throw.usage <= self.limits.speed_share:
                return np.asarray(place)
        return None

    def _best(
        self, target: Array, flight_s: float | None, weights: Sequence[float] = CONTORTION_WEIGHTS
    ) -> PlannedThrow | None:
        """Return the throw with the smallest use of the velocity limits whose arm touches nothing."""
        for weight in weights:
            throws = [
                throw
                for first in self._first_guesses()
                if (released := self._improved(target, flight_s, first, weight)) is not None
                and (throw := self._gentlest(released)) is not None
            ]
            if throws:
                return min(throws, key=lambda throw: throw.usage)
        return None

    def _gentlest(self, throw: PlannedThrow) -> PlannedThrow | None:
        """Return the throw with the longest swing and follow-through in which the arm touches nothing."""
        for swing_s in self.limits.durations_s:
            slower = replace(throw, swing_s=swing_s)
            if self._is_within(slower.start) and self._is_clear(slower, 0.0, swing_s):
                throw = slower
                break
        else:
            return None
        for follow_s in self.limits.durations_s:
            slower = replace(throw, follow_s=follow_s)
            if self._is_within(slower.end) and self._is_clear(slower, throw.swing_s, slower.duration_s):
                return slower
        return None

    def _is_within(self, joints: Array) -> bool:
        return bool((joints >= self._lower - 1e-3).all() and (joints <= self._upper + 1e-3).all())

    def _is_clear(self, throw: PlannedThrow, start_s: float, end_s: float) -> bool:
        """Return whether the arm touches nothing of the robot in a part of its way."""
        q = self._q
        for time_s in np.linspace(start_s, end_s, CHECKED):
            q[BASE_POSITIONS + self._arm] = throw.joints(float(time_s))[0]
            self._kinematics.update(q)
            if self._collision.smallest_m(self._kinematics) < CLEARANCE_M:
                return False
        return True

    def _first_guesses(self) -> list[Array]:
        """Return arm positions to start from: below the shoulder and above it, turned as the pose has it."""
        below, above = self._middle.copy(), self._middle.copy()
        above[0] -= 1.7
        return [np.clip(bound, self._lower, self._upper) for bound in (below, above)]

    def _improved(
        self, target: Array, flight_s: float | None, first: Array, weight: float
    ) -> PlannedThrow | None:
        flight = flight_s or 0.4
        bounds = [*zip(self._lower, self._upper, strict=True)]
        bounds.append((flight, flight) if flight_s else (MIN_FLIGHT_S, MAX_FLIGHT_S))
        optimum = minimize(
            lambda x: self._cost(x, target) + weight * np.sum((x[:-1] - first) ** 2),
            np.append(first, flight),
            method="SLSQP",
            bounds=bounds,
            constraints=[{"type": "ineq", "fun": lambda x: self._room(x, target)}],
            options={"maxiter": ROUNDS, "ftol": 1e-5},
        )
        if not np.isfinite(optimum.x).all() or self._room(optimum.x, target).min() < -1e-3:
            return None
        position, ball_velocity, velocity = self._release(optimum.x, target)
        shortest = min(self.limits.durations_s)
        return PlannedThrow(
            self.grip,
            target,
            float(optimum.x[-1]),
            optimum.x[:-1],
            velocity,
            position,
            ball_velocity,
            float(np.max(np.abs(velocity) / self._fastest)),
            shortest,
            shortest,
        )

    def _cost(self, x: Array, target: Array) -> float:
        """Return a smooth largest share of the velocity limits."""
        shares = self._release(x, target)[2] / self._fastest
        return float(np.sum(shares**4) ** 0.25)

    def _room(self, x: Array, target: Array) -> Array:
        """Return what must not be negative: room to the limits at rest, and the place of the release."""
        position, _, velocity = self._release(x, target)
        half = velocity * min(self.limits.durations_s) / 2
        start, end = x[:-1] - half, x[:-1] + half
        ahead = position[0] - self._q[0] - MIN_AHEAD_M
        return np.concatenate(
            [
                np.minimum(start, end) - self._lower,
                self._upper - np.maximum(start, end),
                [ahead, position[2] - MIN_RELEASE_HEIGHT_M],
            ]
        )

    def _release(self, x: Array, target: Array) -> tuple[Array, Array, Array]:
        """Return place and velocity of the ball, and velocities of the arm, at a release `x` = (arm, T)."""
        q = self._q
        q[BASE_POSITIONS + self._arm] = x[:-1]
        position, jacobian = self._kinematics.point(q, self.grip.link, np.array(self.grip.point))
        ball_velocity = release_velocity(position, target, float(x[-1]))
        of_arm = jacobian[:, BASE_VELOCITIES + self._arm] * self._weights
        needed = np.linalg.solve(of_arm @ of_arm.T + 1e-6 * np.eye(3), ball_velocity)
        return position, ball_velocity, self._weights * (of_arm.T @ needed)
