"""Where a person who holds the hands of the robot wants to go, read from the manipulability of its arms.

After CoSiMA, equation 3: while the manipulability of an arm is at or below a threshold, the centre of mass is
to move along u_L / sigma_L + u_R / sigma_R, the directions in which the arms lose their mobility. To this
equation are added, so that a person can rely on it:

- u points to where the hand was moved from its rest pose; a singular vector has no sign of its own.
  From cycle to cycle it keeps its direction, and reverses only when the hand is clearly on the other side.
- 1 / sigma is damped to sigma / (sigma² + damping²), which is finite for a stretched arm.
- `gain_m2ps` (m²/s) makes a velocity of it; its horizontal part is capped in speed and acceleration.
- Once below the threshold, an arm must exceed it by `hysteresis` (a share) before the robot stops.

`patterns.lead` is another reading of the same arms. What both share is here: the state of an arm, the
intention, and the velocity that follows it within caps.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, Protocol, get_args

import numpy as np

from handover_humanoid.model.kinematics import BASE_VELOCITIES, Array, Kinematics

IntentionName = Literal["lead", "manipulability"]
"""How the intention is read: by `patterns.lead`, or by this module."""
INTENTIONS: Final[tuple[IntentionName, ...]] = get_args(IntentionName)
DEFAULT_INTENTION: Final[IntentionName] = "lead"


@dataclass(frozen=True, slots=True)
class IntentionLimits:
    """The parameters of the module; `threshold` is v_d in m³/rad³, `damping_m` and `deadband_m` are in m."""

    threshold: float
    gain_m2ps: float = 0.01
    damping_m: float = 0.05
    hysteresis: float = 0.15
    deadband_m: float = 0.02
    max_mps: float = 0.12
    max_mps2: float = 0.3

    def __post_init__(self) -> None:
        for name in ("threshold", "gain_m2ps", "damping_m", "max_mps", "max_mps2"):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise ValueError(f"{name} is {value}; it must be above 0 and finite")
        if not (self.hysteresis >= 0 and self.deadband_m >= 0):
            raise ValueError("hysteresis and deadband_m must be 0 or more")


@dataclass(frozen=True, slots=True)
class ArmState:
    """The translational Jacobian (3, joints) of a hand in m/rad, and its place from its rest pose (3,) in m.

    Both are in the heading frame: x ahead, y to the left, z up. So is `lead` (3,) in m, from the rest pose as
    well: where the hand of the person is, who pulls at that of the robot.
    """

    jacobian: Array
    displacement: Array
    lead: Array = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True, slots=True)
class Intention:
    """The reference of the centre of mass (2,) in m/s in the heading frame, and how it came about."""

    velocity: Array
    is_active: bool
    manipulability: Mapping[str, float]
    fault: str = ""


class IntentionReader(Protocol):
    """Reads the intention, cycle by cycle."""

    @property
    def max_mps(self) -> float:
        """The speed that it never exceeds."""
        ...

    def update(self, arms: Mapping[str, ArmState], dt_s: float, max_mps: float | None = None) -> Intention:
        """Return the reference after `dt_s`.

        `max_mps` is a lower cap for this cycle, 0 to stop. Values that are not finite stop the robot as well,
        with the acceleration of the limits, and are named in `fault`.
        """
        ...


class CappedVelocity:
    """A velocity (2,) in m/s that follows a wanted one within a speed and an acceleration."""

    def __init__(self, max_mps: float, max_mps2: float) -> None:
        self.max_mps, self._max_mps2 = max_mps, max_mps2
        self.value = np.zeros(2)

    def follow(self, wanted: Array, dt_s: float, max_mps: float | None = None) -> Array:
        """Return the velocity after `dt_s`; `max_mps` is a lower cap."""
        most = self.max_mps if max_mps is None else min(max(max_mps, 0.0), self.max_mps)
        self.value = self.value + capped(capped(wanted, most) - self.value, self._max_mps2 * dt_s)
        return self.value.copy()


class IntentionReference:
    """Reads the intention from the manipulability. Not thread-safe."""

    def __init__(self, limits: IntentionLimits) -> None:
        self.limits = limits
        self._velocity = CappedVelocity(limits.max_mps, limits.max_mps2)
        self._is_active = False
        self._directions: dict[str, Array] = {}

    @property
    def max_mps(self) -> float:
        """The speed that it never exceeds."""
        return self.limits.max_mps

    def update(self, arms: Mapping[str, ArmState], dt_s: float, max_mps: float | None = None) -> Intention:
        """Return the reference after `dt_s`, as `IntentionReader` says."""
        fault = fault_of(arms)
        if fault:
            self._is_active = False
            self._directions.clear()
            return Intention(self._velocity.follow(np.zeros(2), dt_s), False, {}, fault)
        splits = {name: _weakest(arm.jacobian) for name, arm in arms.items()}
        volumes = {name: volume for name, (_, _, volume) in splits.items()}
        self._switch(min(volumes.values(), default=np.inf))
        wanted = np.zeros(2)
        if self._is_active:
            for name, (axis, sigma, _) in splits.items():
                damped = sigma / (sigma**2 + self.limits.damping_m**2)
                wanted += damped * self._directed(name, axis, arms[name].displacement)[:2]
        velocity = self._velocity.follow(self.limits.gain_m2ps * wanted, dt_s, max_mps)
        return Intention(velocity, self._is_active, volumes)

    def _switch(self, least: float) -> None:
        share = 1 + self.limits.hysteresis if self._is_active else 1.0
        self._is_active = least <= self.limits.threshold * share
        if not self._is_active:
            self._directions.clear()

    def _directed(self, name: str, axis: Array, displacement: Array) -> Array:
        """Return the axis with its sign, or zero while the hand is too near to its rest pose."""
        before = self._directions.get(name)
        towards = float(axis @ displacement)
        if abs(towards) > self.limits.deadband_m:
            directed = axis * np.sign(towards)
        elif before is not None:
            directed = axis if axis @ before >= 0 else -axis
        else:
            return np.zeros(3)
        self._directions[name] = directed
        return np.asarray(directed)


def _weakest(jacobian: Array) -> tuple[Array, float, float]:
    """Return the left singular vector of the smallest singular value, this value, and the product of all."""
    left, values, _ = np.linalg.svd(jacobian, full_matrices=False)
    return np.asarray(left[:, -1]), float(values[-1]), float(np.prod(values))


def manipulability(arm: ArmState) -> float:
    """Return the product of the singular values of an arm's Jacobian, in m³/rad³."""
    return _weakest(arm.jacobian)[2]


def capped(vector: Array, longest: float) -> Array:
    """Return a vector, shortened to a length if it is longer."""
    length = float(np.linalg.norm(vector))
    return vector if length <= longest else vector * (longest / length)


def fault_of(arms: Mapping[str, ArmState]) -> str:
    """Return which arms have a value that is not finite, or nothing."""
    broken = sorted(name for name, arm in arms.items() if not _is_finite(arm))
    return f"no valid measurement of: {', '.join(broken)}" if broken else ""


def _is_finite(arm: ArmState) -> bool:
    return all(bool(np.isfinite(part).all()) for part in (arm.jacobian, arm.displacement, arm.lead))


def hand_place(kinematics: Kinematics, hand: str) -> Array:
    """Return where a link is from the root of the robot, in the heading frame (3,)."""
    root = kinematics.pose(kinematics.humanoid.root)
    offset = kinematics.pose(hand).translation - root.translation
    return np.asarray(_heading(root.rotation).T @ offset)


def arm_state(kinematics: Kinematics, chain: str, hand: str, rest: Array) -> ArmState:
    """Return the state of an arm: the joints of `chain` move `hand`, whose `hand_place` at rest is `rest`.

    Its lead is left at 0; it needs forces.
    """
    joints = BASE_VELOCITIES + np.array(kinematics.humanoid.indices(chain))
    rotation = _heading(kinematics.pose(kinematics.humanoid.root).rotation)
    jacobian = rotation.T @ kinematics.jacobian(hand)[:3, joints]
    return ArmState(jacobian, hand_place(kinematics, hand) - rest)


def _heading(rotation: Array) -> Array:
    """Return the yaw of a rotation, as a rotation."""
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    return np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
