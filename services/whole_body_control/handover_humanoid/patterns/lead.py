"""Where a person who holds the hands of the robot wants to go, read from where the hands of the person are.

Equation 3 of CoSiMA (`patterns.intention`) reads the direction from the axes of the arms. Compliant arms that
are drawn to a pose have to be stretched until it notices anything, and the axis in which an arm is weak is
that of its geometry, not that of the pull. This reading, an addition of ours, uses what the paper has as
well, joint positions and joint torques:

- The torques of an arm beyond those that carry its weight are `J^T force`; so the force at the hand is the
  least-squares solution, damped by `FORCE_DAMPING`.
- A hand that holds softly, as a spring, is `displacement + force / stiffness` from where the hand of the
  robot rests: the lead.
- The lead is measured from the feet, not from the body of the robot, which sways with each step. With the
  wrong stiffness the sway would still read as a lead; so `HoldStiffness` follows that of the person.
- The mean lead of the hands that are held is smoothed over `smoothing_s`, and changes by `max_lead_mps` at
  most, so that the shock of a foot that lands hardly counts. Beyond `start_m` the robot moves along it,
  until it falls below `stop_m`. Feet that do not cross are slow to the side: the velocity is
  shortened until its part to the side is within `max_left_mps`, which keeps its direction.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from handover.messages import number_text
from handover_humanoid.model.kinematics import Array
from handover_humanoid.patterns.intention import (
    ArmState,
    CappedVelocity,
    Intention,
    capped,
    fault_of,
    manipulability,
)

FORCE_DAMPING = 1e-4
"""Added to `J J^T` in m²/rad², so that a stretched arm gives a finite force."""


@dataclass(frozen=True, slots=True)
class LeadLimits:
    """The parameters of the module; `gain_ps` (1/s) makes a velocity of a lead."""

    gain_ps: float = 0.65
    start_m: float = 0.1
    stop_m: float = 0.05
    smoothing_s: float = 0.16
    max_lead_mps: float = 0.8
    max_mps: float = 0.12
    max_left_mps: float = 0.06
    max_mps2: float = 0.5

    def __post_init__(self) -> None:
        for name in (
            "gain_ps",
            "stop_m",
            "smoothing_s",
            "max_lead_mps",
            "max_mps",
            "max_left_mps",
            "max_mps2",
        ):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise ValueError(f"{name} is {value}; it must be above 0 and finite")
        if not self.stop_m <= self.start_m < np.inf:
            raise ValueError(
                f"start_m is {number_text(self.start_m)}; it must be at least stop_m, "
                f"{number_text(self.stop_m)}"
            )


class LeadReference:
    """Reads the intention from the lead of the hands. Not thread-safe."""

    def __init__(self, limits: LeadLimits | None = None) -> None:
        self.limits = limits or LeadLimits()
        self._velocity = CappedVelocity(self.limits.max_mps, self.limits.max_mps2)
        self._lead = np.zeros(2)
        self._is_active = False

    @property
    def max_mps(self) -> float:
        """The speed that it never exceeds."""
        return self.limits.max_mps

    def update(self, arms: Mapping[str, ArmState], dt_s: float, max_mps: float | None = None) -> Intention:
        """Return the reference after `dt_s`, as `IntentionReader` says."""
        fault = fault_of(arms)
        if fault or not arms:
            self._lead[:] = 0.0
            self._is_active = False
            return Intention(self._velocity.follow(np.zeros(2), dt_s), False, {}, fault)
        lead = np.mean([arm.lead[:2] for arm in arms.values()], axis=0)
        change = min(dt_s / self.limits.smoothing_s, 1.0) * (lead - self._lead)
        self._lead += capped(change, self.limits.max_lead_mps * dt_s)
        length = float(np.linalg.norm(self._lead))
        self._is_active = length > (self.limits.stop_m if self._is_active else self.limits.start_m)
        wanted = self.limits.gain_ps * self._lead if self._is_active else np.zeros(2)
        aside = abs(float(wanted[1]))
        if aside > self.limits.max_left_mps:
            wanted = wanted * (self.limits.max_left_mps / aside)
        volumes = {name: manipulability(arm) for name, arm in arms.items()}
        return Intention(self._velocity.follow(wanted, dt_s, max_mps), self._is_active, volumes)


def hand_force(jacobian: Array, torques: Array) -> Array:
    """Return the force (3,) in N that makes these torques (joints,) in an arm with this Jacobian (3,
    joints)."""
    return np.asarray(np.linalg.solve(jacobian @ jacobian.T + FORCE_DAMPING * np.eye(3), jacobian @ torques))


class HoldStiffness:
    """The stiffness of the arms of a person who holds the hands, in N/m.

    The hands of the robot sway with its steps, those of the person do not. So while the person wants the
    same, the force changes against the place of the hand by the stiffness: it is the regression of force on
    place, both without their slow changes (`SLOW_S`), over `MEMORY_S`. Samples in which the place of the
    person's hand itself changed by more than `STEADY_M` do not count, nor those that sway by less than
    `MIN_SWAY_M`. It begins with `DEFAULT_NPM`, which counts as a sway with the variance `PRIOR_M2`. A person
    sways along a little, which makes their arms seem softer than they are.
    """

    DEFAULT_NPM, MIN_NPM, MAX_NPM = 30.0, 15.0, 80.0
    SLOW_S, MEMORY_S, STEADY_M, MIN_SWAY_M, PRIOR_M2 = 0.2, 4.0, 0.025, 0.005, 4e-5

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Forget the person."""
        self.npm = self.DEFAULT_NPM
        self._slow: tuple[Array, Array] | None = None
        self._squares, self._products = self.PRIOR_M2, self.PRIOR_M2 * self.DEFAULT_NPM

    def update(self, place: Array, force: Array, dt_s: float) -> float:
        """Return the stiffness, with the mean place (2,) in m of the hands and the mean force (2,) in N at
        them."""
        if not (np.isfinite(place).all() and np.isfinite(force).all()):
            return self.npm
        if self._slow is None:
            self._slow = (place.copy(), force.copy())
        slow_place, slow_force = self._slow
        moved, pulled = place - slow_place, force - slow_force
        slow_place += dt_s / self.SLOW_S * moved
        slow_force += dt_s / self.SLOW_S * pulled
        person = moved + pulled / self.npm
        sway = float(moved @ moved)
        if float(person @ person) < self.STEADY_M**2 and sway > self.MIN_SWAY_M**2:
            share = dt_s / self.MEMORY_S
            self._squares += share * (sway - self._squares)
            self._products += share * (-float(pulled @ moved) - self._products)
            self.npm = min(max(self._products / self._squares, self.MIN_NPM), self.MAX_NPM)
        return self.npm
