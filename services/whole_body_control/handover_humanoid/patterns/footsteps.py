"""Where and when the feet step: a state machine in periods of the pattern generator, without I/O.

    standing -> double -> single -> double -> single -> ... -> double -> standing

The robot begins to step when a velocity is wanted, and stops after the step that brings its feet side by
side. Joints never freeze in single support: a step that began is finished.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from handover.messages import number_text
from handover_humanoid.model.kinematics import Array
from handover_humanoid.patterns.minimum_jerk import moved
from handover_humanoid.patterns.regions import Footprint, Region, Side, turn

OTHER: dict[Side, Side] = {"left": "right", "right": "left"}
LEVEL_M = 1e-3


@dataclass(frozen=True, slots=True)
class StepLimits:
    """What a robot can step. Lengths in m between the soles, times in periods of the pattern generator.

    `width_m` is the distance of the feet side by side, `min_width_m` and `max_width_m` what it may become.
    """

    width_m: float
    min_width_m: float
    max_width_m: float
    max_length_m: float
    max_yaw: float = 0.2
    single: int = 6
    double: int = 2
    min_speed_mps: float = 0.01

    def __post_init__(self) -> None:
        if not 0 < self.min_width_m <= self.width_m <= self.max_width_m:
            raise ValueError(
                f"the width of a step is {number_text(self.min_width_m)} m to "
                f"{number_text(self.max_width_m)} m, and {number_text(self.width_m)} m side by side; the "
                "last must be between the others"
            )
        if self.single < 1 or self.double < 1:
            raise ValueError("single and double support need at least one period each")


@dataclass(frozen=True, slots=True)
class Stance:
    """The feet during one period, and how many periods this phase still has, with this one.

    In single support the foot of `swing` moves from where it stands here to `landing`.
    """

    left: Footprint
    right: Footprint
    phase: Literal["standing", "double", "single"] = "standing"
    remaining: int = 0
    swing: Side = "right"
    landing: Footprint | None = None

    def foot(self, side: Side) -> Footprint:
        """Return the footprint of a side."""
        return self.left if side == "left" else self.right

    @property
    def support(self) -> Footprint:
        """Return the foot that stands while the other one moves."""
        return self.foot(OTHER[self.swing])

    def region(self, sole: Array) -> Region:
        """Return where the ZMP may be."""
        feet = (self.support,) if self.phase == "single" else (self.left, self.right)
        return Region.of(feet, sole)


@dataclass(frozen=True, slots=True)
class Wish:
    """The wanted velocity (2,) in m/s on the ground and the yaw rate in rad/s."""

    velocity: Array
    yaw_rate: float = 0.0


class Footsteps:
    """Places footsteps. Pure: every method returns a new stance."""

    def __init__(self, limits: StepLimits, period_s: float) -> None:
        self.limits = limits
        self._step_s = (limits.single + limits.double) * period_s

    def walked(self, wish: Wish) -> Wish:
        """Return what is walked of a wish that stays: steps shorten it, or it is too small to step.

        The wish is in the frame of the feet. One foot steps outwards and the other follows it, so that the
        speed to a side is the mean of both.
        """
        if not self.is_moving(wish):
            return Wish(np.zeros(2))
        limits, most = self.limits, self.limits.max_length_m
        ahead, aside = (wish.velocity * self._step_s).tolist()
        outer, inner = limits.max_width_m - limits.width_m, limits.width_m - limits.min_width_m
        sideways = (min(abs(aside), outer) + min(abs(aside), inner)) / 2
        yaw = min(max(wish.yaw_rate * self._step_s, -limits.max_yaw), limits.max_yaw)
        step = np.array([min(max(ahead, -most), most), math.copysign(sideways, aside)])
        return Wish(step / self._step_s, yaw / self._step_s)

    def after(self, stance: Stance, wish: Wish) -> Stance:
        """Return the stance of the next period."""
        if stance.phase == "standing":
            return self._begun(stance) if self.is_moving(wish) else stance
        if stance.remaining > 1:  # most periods; `replace` would take three times as long
            return Stance(
                stance.left, stance.right, stance.phase, stance.remaining - 1, stance.swing, stance.landing
            )
        if stance.phase == "single":
            landed = stance.landing or stance.foot(stance.swing)
            feet = {"left": stance.left, "right": stance.right, stance.swing: landed}
            swing = OTHER[stance.swing]
            return Stance(feet["left"], feet["right"], "double", self.limits.double, swing)
        if not self.is_moving(wish) and self._is_level(stance):
            return replace(stance, phase="standing", remaining=0)
        single = replace(stance, phase="single", remaining=self.limits.single)
        return self.placed(single, wish)

    def resumed(self, stance: Stance) -> Stance:
        """Return the stance of a robot that was to stand after this double support, and now walks on.

        Its centre of mass rests between the feet, so that it needs as long as from standing to come over one.
        """
        return self._begun(stance) if stance.phase == "double" and self._is_level(stance) else stance

    def placed(self, stance: Stance, wish: Wish, shift: Array | None = None) -> Stance:
        """Return a stance in single support whose foot lands where the wish and a `shift` (2,) want it.

        The landing is kept within the limits of a step, so feet never cross.
        """
        if stance.phase != "single":
            return stance
        support, limits = stance.support, self.limits
        outwards = 1.0 if stance.swing == "left" else -1.0
        yaw_change = float(np.clip(wish.yaw_rate * self._step_s, -limits.max_yaw, limits.max_yaw))
        ground = wish.velocity * self._step_s + (0.0 if shift is None else shift)
        ahead, aside = turn(support.yaw).T @ ground
        length = float(np.clip(ahead, -limits.max_length_m, limits.max_length_m))
        width = float(np.clip(limits.width_m + outwards * aside, limits.min_width_m, limits.max_width_m))
        x, y = support.to_ground(np.array([[length, outwards * width]]))[0]
        landing = Footprint(stance.swing, float(x), float(y), support.yaw + yaw_change)
        return replace(stance, landing=landing)

    def preview(self, stance: Stance, wish: Wish, count: int) -> Iterator[Stance]:
        """Yield the stances of the next periods, this one first, while the wish stays."""
        for _ in range(count):
            yield stance
            stance = self.after(stance, wish)

    def _begun(self, stance: Stance) -> Stance:
        return replace(stance, phase="double", remaining=2 * self.limits.double)

    def is_moving(self, wish: Wish) -> bool:
        """Return whether a wish is more than to stand."""
        speed = float(np.linalg.norm(wish.velocity))
        return speed > self.limits.min_speed_mps or abs(wish.yaw_rate) * self._step_s > 0.02

    def _is_level(self, stance: Stance) -> bool:
        """Return whether the feet stand side by side."""
        apart = turn(stance.left.yaw).T @ (stance.left.place - stance.right.place)
        width_error = abs(float(apart[1]) - self.limits.width_m)
        is_straight = abs(stance.left.yaw - stance.right.yaw) < LEVEL_M
        return abs(float(apart[0])) < LEVEL_M and width_error < LEVEL_M and is_straight


def swing_position(start: Footprint, landing: Footprint, share: float, height_m: float) -> Array:
    """Return the place (3,) of a sole after a share of its swing, which starts and ends at rest."""
    share = min(max(share, 0.0), 1.0)
    way = moved(share)
    x, y = start.x + way * (landing.x - start.x), start.y + way * (landing.y - start.y)
    return np.array([x, y, 64 * height_m * share**3 * (1 - share) ** 3])
