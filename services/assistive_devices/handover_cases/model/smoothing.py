"""Proportional-derivative smoothing of a command: it follows without overshoot, and may only fall at once.

A value is pulled to its target by `stiffness * (target - value) - damping * rate`, critically damped:
`damping = 2 * sqrt(stiffness)`. The time constant is `1 / sqrt(stiffness)`. The paper smooths its command and
its limit by a proportional-derivative controller without figures; these are ours.

Invariants, for any targets and steps: a step from a target to another one never overshoots; the value stays
within the targets so far; a value above its target never rises. A test checks them.

Worked example: time constant 0.5 s, at rest at 0, the target becomes 1. The value is 0.26 after 0.5 s, 0.59
after 1 s, 0.91 after 2 s.
"""

import math
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Smoothed:
    """A value, and its rate in units a second."""

    value: float = 0.0
    rate: float = 0.0

    def step(self, target: float, dt_s: float, time_constant_s: float) -> "Smoothed":
        """Return the value `dt_s` later; the exact solution for a constant target, so any step is stable."""
        if dt_s <= 0:
            return self
        if not math.isfinite(target):
            raise ValueError(f"the target is {target}; a command must be a finite number")
        omega = 1 / time_constant_s
        distance, decay = self.value - target, math.exp(-omega * dt_s)
        slope = self.rate + omega * distance
        value = target + (distance + slope * dt_s) * decay
        rate = (self.rate - omega * slope * dt_s) * decay
        is_past = (value - target) * distance < 0 or (distance == 0 and value != target)
        is_away = abs(value - target) > abs(distance)
        if is_past:
            return Smoothed(target, 0.0)
        return Smoothed(self.value, 0.0) if is_away else Smoothed(value, rate)


AT_REST: Final = Smoothed()


def within_rate(
    value: float, target: float, max_rise_per_s: float, max_fall_per_s: float, dt_s: float
) -> float:
    """Return `target`, limited to what its magnitude may rise and fall from `value` in `dt_s`.

    A change of sign passes through 0 at the rate of falling.
    """
    if value == 0 or value * target > 0:
        sign = math.copysign(1.0, target if value == 0 else value)
        magnitude = min(
            max(abs(target), abs(value) - max_fall_per_s * dt_s), abs(value) + max_rise_per_s * dt_s
        )
        return sign * magnitude
    return math.copysign(max(abs(value) - max_fall_per_s * dt_s, 0.0), value)
