"""A constraint on the way of the tool: how far it may tilt."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from handover_robots.model.poses import Vector
from handover_robots.planning.arm import Arm, Array


@dataclass(frozen=True, slots=True)
class Tilt:
    """A path constraint: an axis of the tool stays within an angle of a direction of the base."""

    axis: Vector = (0.0, 0.0, 1.0)
    direction: Vector = (0.0, 0.0, -1.0)
    max_angle_rad: float = 0.2

    def check(self, arm: Arm) -> Callable[[Array, Array], bool]:
        """Return what says whether a line between two joint positions keeps the tilt."""
        axis, direction = (
            np.array(vector) / np.linalg.norm(vector) for vector in (self.axis, self.direction)
        )
        least = math.cos(self.max_angle_rad)

        def is_allowed(start: Array, end: Array) -> bool:
            steps = max(int(np.abs(end - start).sum() / 0.1), 1)
            shares = np.linspace(0.0, 1.0, steps + 1)[:, None]
            return all(
                float(direction @ (arm.tool(joints).rotation @ axis)) >= least
                for joints in start + shares * (end - start)
            )

        return is_allowed

    def is_kept(self, arm: Arm, samples: Array) -> bool:
        """Return whether rounded corners keep the tilt; lines of the path are checked before."""
        is_allowed = self.check(arm)
        return all(is_allowed(start, end) for start, end in pairwise(samples[::4]))
