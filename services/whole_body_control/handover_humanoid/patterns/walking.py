"""The pattern generator: footsteps and the motion of the centre of mass, one period at a time.

Each period the footsteps of the horizon are placed for the present wish, and the motion is planned above
them. A foot in the air lands where the wish and the capture point want it, until `LOCKED` periods before. A
robot that a person holds by the hands needs this: pulls to the side add up over some steps, and the sole of
one foot is too narrow for the stabiliser.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from handover_humanoid.model.kinematics import Array
from handover_humanoid.patterns.footsteps import Footsteps, Stance, StepLimits, Wish
from handover_humanoid.patterns.pendulum import PendulumState
from handover_humanoid.patterns.regions import Footprint, Region, Side, turn
from handover_humanoid.patterns.zmp_control import ZmpControl, ZmpPlan

LOCKED = 2
TOLERATED_M = 0.01
"""An error of the capture point that the stabiliser makes up for within a sole."""
TOLERATED_AT_END_M = np.array([0.04, TOLERATED_M])
"""The same ahead and aside while the robot is to stop: feet that follow a steady pull are never level. To the
side it stays as it is, since soles are narrow."""


@dataclass(frozen=True, slots=True)
class Pattern:
    """What the feet and the centre of mass do in the next period; `region` is where the ZMP may be in it.

    `landings` has the next landing of each foot, as planned for the present wish; none for a foot that stays.
    """

    stance: Stance
    plan: ZmpPlan
    region: Region
    landings: Mapping[Side, Footprint]


class WalkingPattern:
    """Generates the pattern from a stance at rest. Not thread-safe.

    `sole` are the corners (n, 2) of a sole in the frame of the foot.
    """

    def __init__(self, control: ZmpControl, limits: StepLimits, sole: Array, stance: Stance) -> None:
        self._control, self._sole = control, sole
        self._footsteps = Footsteps(limits, control.period_s)
        self.stance, self._was_moving = stance, False
        centre = (stance.left.place + stance.right.place) / 2
        com = centre + sole.mean(axis=0)
        self.state = PendulumState(com, np.zeros(2), com.copy())

    def step(self, wish: Wish, error: Array | None = None) -> Pattern:
        """Plan one period ahead. Raises `Unplannable`.

        `error` (2,) in m is how far the measured capture point is from that of the plan. By what exceeds
        the tolerated a foot in the air lands farther, within the limits of a step.
        """
        is_moving = self._footsteps.is_moving(wish)
        if is_moving and not self._was_moving:
            self.stance = self._footsteps.resumed(self.stance)
        self._was_moving = is_moving
        if self.stance.phase == "single" and self.stance.remaining > LOCKED:
            beyond = None if error is None else self._beyond(wish, error)
            self.stance = self._footsteps.placed(self.stance, wish, beyond)
        stances = list(self._footsteps.preview(self.stance, wish, self._control.samples + 1))
        regions = self._regions(stances)
        plan = self._control.plan(self.state, regions[1:], wish.velocity)
        pattern = Pattern(self.stance, plan, regions[0], _next_landings(stances))
        self.stance, self.state = stances[1], plan.states[1]
        return pattern

    def _beyond(self, wish: Wish, error: Array) -> Array:
        """Return by what an error exceeds the tolerated."""
        if self._footsteps.is_moving(wish):
            return np.asarray(error - np.clip(error, -TOLERATED_M, TOLERATED_M))
        heading = turn(self.stance.support.yaw)
        own = heading.T @ error
        return np.asarray(heading @ (own - np.clip(own, -TOLERATED_AT_END_M, TOLERATED_AT_END_M)))

    def _regions(self, stances: Sequence[Stance]) -> list[Region]:
        """Return the region of this period, and the one of each sample: where both its periods allow it."""
        by_feet: dict[tuple[Footprint, ...], Region] = {}
        regions = []
        for index, stance in enumerate(stances):
            before = stances[max(index - 1, 0)]
            smaller = before if before.phase == "single" else stance
            feet = (smaller.support,) if smaller.phase == "single" else (smaller.left, smaller.right)
            if feet not in by_feet:
                by_feet[feet] = Region.of(feet, self._sole)
            regions.append(by_feet[feet])
        return regions


def _next_landings(stances: Sequence[Stance]) -> dict[Side, Footprint]:
    landings: dict[Side, Footprint] = {}
    for stance in stances:
        if stance.phase == "single" and stance.landing is not None:
            landings.setdefault(stance.swing, stance.landing)
    return landings
