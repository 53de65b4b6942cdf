"""The linear inverted pendulum: the centre of mass at a constant height above the zero moment point (ZMP).

x'' = omega² (x - p) with omega² = g / height (Kajita 2003). Between samples the ZMP p moves in a straight
line, so it stays in a convex region that has both of its ends. The capture point x + x' / omega is where the
ZMP must be for the robot to come to rest (Pratt 2006). Axes are horizontal, units are m and s.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from handover.messages import number_text
from handover_humanoid.model.kinematics import GRAVITY_MPS2, Array


@dataclass(frozen=True, slots=True)
class PendulumState:
    """Centre of mass, its velocity, and the ZMP; each (2,)."""

    com: Array
    velocity: Array
    zmp: Array


@dataclass(frozen=True)
class Pendulum:
    """A pendulum of constant height."""

    height_m: float

    def __post_init__(self) -> None:
        if not 0.05 <= self.height_m <= 3.0:
            raise ValueError(
                f"the centre of mass is {number_text(self.height_m)} m high; a humanoid has 0.05 m to 3 m"
            )

    @cached_property
    def omega(self) -> float:
        """Return the rate of the pendulum in 1/s."""
        return float(np.sqrt(GRAVITY_MPS2 / self.height_m))

    def transition(self, dt_s: float) -> tuple[Array, Array]:
        """Return A (3, 3) and b (3,) for one axis: (x, x', p) after `dt_s` is A (x, x', p) + b p'."""
        w = self.omega
        cosh, sinh = math.cosh(w * dt_s), math.sinh(w * dt_s)
        a = np.array([[cosh, sinh / w, 1 - cosh], [w * sinh, cosh, -w * sinh], [0.0, 0.0, 1.0]])
        return a, np.array([dt_s - sinh / w, 1 - cosh, dt_s])

    def advance(self, state: PendulumState, zmp_velocity: Array, dt_s: float) -> PendulumState:
        """Return the state after `dt_s` with a constant velocity of the ZMP."""
        w = self.omega
        cosh, sinh = math.cosh(w * dt_s), math.sinh(w * dt_s)
        above = state.com - state.zmp
        return PendulumState(
            state.zmp + cosh * above + (sinh / w) * state.velocity + (dt_s - sinh / w) * zmp_velocity,
            w * sinh * above + cosh * state.velocity + (1 - cosh) * zmp_velocity,
            state.zmp + dt_s * zmp_velocity,
        )

    def capture_point(self, state: PendulumState) -> Array:
        """Return the capture point (2,)."""
        return np.asarray(state.com + state.velocity / self.omega)
