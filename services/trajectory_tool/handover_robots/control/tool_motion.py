"""The velocity of the tool as velocities of the joints: damped least squares.

Near a singularity the damping grows, so that joints stay slow and the tool follows less exactly (Nakamura and
Hanafusa, 1986; damping after Chiaverini, 1997). Velocities beyond a limit are scaled as a whole: the tool
keeps its direction.
"""

import math
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
    undamped = _undamped(jacobian, twist)
    if undamped is not None:
        return scaled(undamped, limits)
    u, values, v = np.linalg.svd(jacobian, full_matrices=False)
    smallest = float(values[-1]) if values.size else 0.0
    share = max(0.0, 1.0 - (smallest / SINGULAR_FROM) ** 2)
    damping = share * MAX_DAMPING**2
    gains = values / (values**2 + damping) if damping > 0 else 1 / values
    velocities: Array = v.T @ (gains * (u.T @ twist))
    return scaled(velocities, limits)


def _undamped(jacobian: Array, twist: Array) -> Array | None:
    """Return the velocities of least norm where no damping is needed for sure, else None.

    The smallest singular value of a matrix is at least the inverse of the Frobenius norm of its inverse, and
    an inverse costs half of a decomposition. It is most cycles.
    """
    rows, columns = jacobian.shape
    is_square = rows == columns
    if rows > columns:
        return None
    try:
        inverse = np.linalg.inv(jacobian if is_square else jacobian @ jacobian.T)
    except np.linalg.LinAlgError:
        return None
    flat = inverse.ravel()
    norm = math.sqrt(float(flat @ flat))
    smallest = 1 / norm if is_square else math.sqrt(1 / norm)
    if not smallest >= SINGULAR_FROM:
        return None
    velocities: Array = inverse @ twist if is_square else jacobian.T @ (inverse @ twist)
    return velocities


def scaled(velocities: Array, limits: Sequence[float]) -> Array:
    """Return the velocities, slowed down together until none exceeds its limit."""
    values = velocities.tolist()  # NumPy takes longer for so few numbers
    excess = max((abs(value) / limit for value, limit in zip(values, limits, strict=True)), default=1.0)
    return velocities / excess if excess > 1.0 else velocities


def in_base(twist: Array, rotation: Any) -> Array:
    """Return a twist in axes of the tool as one in axes of the base; `rotation` is that of the tool."""
    turn = np.asarray(rotation, dtype=float)
    return np.concatenate([turn @ twist[:3], turn @ twist[3:]])
