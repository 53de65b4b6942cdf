"""The state of the component as the ports show it: its codes, its fields, and the ball."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from handover.runtime.control_cycle import runs_in_cycle
from handover_humanoid.behaviours.throwing import Phase, ThrowingController
from handover_humanoid.behaviours.walking import WalkingController
from handover_humanoid.cycle.gains import gain_fields
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.kinematics import Array
from handover_humanoid.patterns.regions import SIDES

LANDED_M: Final = 0.03
"""A ball that is lower, or below the height of its target, has landed."""
LOST_M: Final = 6.0
SOLVER_BOUNDS_US: Final = (20, 40, 60, 80, 100, 150, 200, 300, 400, 600, 1000, 2000)
PHASES: Final = ("standing", "double", "single")
THROW_PHASES: Final = (Phase.STANDING, Phase.REACHING, Phase.SWINGING, Phase.FOLLOWING, Phase.RETURNING)
REFUSED: Final = 6.0


class Behaviour(IntEnum):
    """The codes of `behaviour` in the ports."""

    WALKING = 0
    ASSISTED_WALKING = 1
    JUGGLING = 2


class Fault(IntEnum):
    """The codes of `fault` in the ports; the page says them in words."""

    NONE = 0
    SENSORS = 1
    SOLVER = 2
    PULLED_HARD = 3
    FALLEN = 4
    THROW_REFUSED = 5
    NOT_OFFERED = 6
    STRETCHED = 7
    RELAXED = 8


class BallPhase(IntEnum):
    """The codes of `ball_phase` in the ports."""

    NONE = 0
    HELD = 1
    FLYING = 2
    LANDED = 3
    LOST = 4


@dataclass
class Ball:
    """The ball as the ports show it, on the ground of the estimate."""

    phase: BallPhase = BallPhase.NONE
    number: float = 0.0
    height_m: float = 0.0

    def __post_init__(self) -> None:
        self.place, self.landed = np.full(3, np.nan), np.full(3, np.nan)
        self.target, self.predicted = np.full(3, np.nan), np.full(3, np.nan)

    @runs_in_cycle
    def follow(self, from_root: Callable[[], Array], rotation: Array, root: Array) -> None:
        """Follow the ball, whose place from the root, at `root` (3,) with `rotation` (3, 3), is measured."""
        if self.phase is BallPhase.NONE:
            return
        before = self.place
        self.place = rotation @ from_root() + root
        if self.phase is not BallPhase.FLYING:
            return
        height_m = max(self.height_m, LANDED_M)
        if before[2] > height_m >= self.place[2]:
            share = (before[2] - height_m) / (before[2] - self.place[2])
            self.landed, self.phase = before + share * (self.place - before), BallPhase.LANDED
        elif self.place[2] < LANDED_M:
            self.landed, self.phase = self.place.copy(), BallPhase.LANDED
        elif float(np.linalg.norm(self.place - root)) > LOST_M:
            self.phase = BallPhase.LOST


def residual_names(walking: WalkingController, throwing: ThrowingController | None) -> list[tuple[int, str]]:
    """Return the levels of all stacks of tasks, each with its number."""
    stacks = [*walking.level_names, *(throwing.level_names if throwing else ())]
    return sorted({(index, name) for stack in stacks for index, name in enumerate(stack)})


def constraint_names(walking: WalkingController, throwing: ThrowingController | None) -> list[str]:
    """Return the constraints of all stacks of tasks."""
    return sorted({*walking.constraint_names, *(throwing.constraint_names if throwing else ())})


def state_fields(
    humanoid: Humanoid, residuals: Sequence[tuple[int, str]], constraints: Sequence[str]
) -> tuple[str, ...]:
    """Return the names of the values that the component writes, in their order."""
    names = ["behaviour", "phase", *(f"support_{side}" for side in SIDES)]
    names += [
        f"{name}.{axis}"
        for name in ("com", "reference", "wanted_zmp", "measured_zmp", "velocity_reference")
        for axis in "xy"
    ]
    names += ["feet.x", "feet.y", "feet.yaw"]
    for side in SIDES:
        names += [f"{side}_foot.force.{axis}" for axis in "xyz"]
        names += [f"{side}_foot.pressure.{axis}" for axis in "xy"]
    for side in SIDES:
        names += [*(f"{side}_hand.force.{axis}" for axis in "xyz"), f"{side}_hand.manipulability"]
    names += [*(f"ball.{axis}" for axis in "xyz"), "ball_phase"]
    names += [f"{name}.{axis}" for name in ("target", "ball_landed", "predicted") for axis in "xyz"]
    names += ["throw_number", "throw_phase", "fault"]
    names += [f"{side}_landing.{axis}" for side in SIDES for axis in ("x", "y", "yaw")]
    names += [f"gain.{name}" for name in gain_fields(humanoid)]
    names += [f"solver_us.{bound}" for bound in (*SOLVER_BOUNDS_US, "inf")]
    names += [f"residual.{index}.{name}" for index, name in residuals]
    names += [f"slack.{name}" for name in constraints]
    names += [f"base.{axis}" for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    return (*names, *(f"joint.{name}" for name in humanoid.joint_names))
