"""The flight of a ball without drag: positions (3,) in m, velocities (3,) in m/s, z upwards.

Drag is left out: a ball of 60 g and 5 cm at 3 m/s loses 1 mm on a metre.
"""

import numpy as np

from handover_humanoid.model.kinematics import GRAVITY_MPS2, Array

GRAVITY = np.array([0.0, 0.0, -GRAVITY_MPS2])
GRAVITY.flags.writeable = False


def release_velocity(start: Array, landing: Array, flight_s: float) -> Array:
    """Return the velocity with which a ball gets from `start` to `landing` in `flight_s`."""
    return np.asarray((landing - start) / flight_s - 0.5 * GRAVITY * flight_s)


def position_after(start: Array, velocity: Array, time_s: float) -> Array:
    """Return where a ball is after `time_s`."""
    return np.asarray(start + velocity * time_s + 0.5 * GRAVITY * time_s**2)


def time_to_fall(start: Array, velocity: Array, height_m: float) -> float:
    """Return when a ball comes down through `height_m`; NaN if it is never so high from now on."""
    root = float(velocity[2] ** 2 + 2 * GRAVITY[2] * (height_m - start[2]))
    time_s = (float(velocity[2]) + np.sqrt(root)) / -float(GRAVITY[2]) if root >= 0 else np.nan
    return time_s if time_s >= 0 else np.nan


def landing_point(start: Array, velocity: Array, height_m: float) -> Array:
    """Return where a ball comes down through `height_m`; NaN (3,) if it never rises so high."""
    return position_after(start, velocity, time_to_fall(start, velocity, height_m))


def peak_height(start: Array, velocity: Array) -> float:
    """Return the largest height of a flight."""
    rising = max(float(velocity[2]), 0.0)
    return float(start[2]) - rising**2 / (2 * float(GRAVITY[2]))
