"""The velocity of the tool as velocities of the joints: damped least squares.

Near a singularity the damping grows, so that joints stay slow and the tool follows less exactly (Nakamura and
Hanafusa, 1986; damping after Chiaverini, 1997). Velocities beyond a limit are scaled as a whole: the tool
keeps its direction.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SINGULAR_FROM: Final = 0.08
"""Smallest singular value of the Jacobian below which motion is damped."""
MAX_DAMPING: Final = 0.06


def joint_velocities(jacobian: Array, twist: Array, limits: Sequence[float]) -> Array:
    """Return joint velocities for a twist (m/s and rad/s, axes of the base); `jacobian` has 6 rows.

    `limits` are the maximum velocities of the joints.
    """
    u, values, v = np.linalg.svd(jacobian, full_matrices=False)
    smallest = float(values[-1]) if values.size else 0.0
    share = max(0.0, 1.0 - (smallest / SINGULAR_FROM) ** 2)
    damping = share * MAX_DAMPING**2
    gains = values / (values**2 + damping) if damping > 0 else 1 / values
    velocities: Array = v.T @ (gains * (u.T @ twist))
    return scaled(velocities, limits)


def scaled(velocities: Array, limits: Sequence[float]) -> Array:
    """Return the velocities, slowed down together until none exceeds its limit."""
    excess = float(np.max(np.abs(velocities) / np.asarray(limits), initial=1.0))
    return velocities / excess


def in_base(twist: Array, rotation: Any) -> Array:
    """Return a twist in axes of the tool as one in axes of the base; `rotation` is that of the tool."""
    turn = np.asarray(rotation, dtype=float)
    return np.concatenate([turn @ twist[:3], turn @ twist[3:]])
