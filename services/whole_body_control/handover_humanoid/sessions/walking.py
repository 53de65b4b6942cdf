"""The figures of a session of assisted walking, from the live state of the robot."""

from dataclasses import dataclass

import numpy as np

from handover_humanoid.model.kinematics import Array

MIN_MPS = 0.02
"""Below this speed the wish has no direction."""
LONGEST_GAP_S = 0.5
LEAST_M = 0.005
"""A shorter way is noise of the estimate."""


@dataclass(slots=True)
class WalkFigures:
    """Sums over a session; feed it in the order of time.

    A gap of more than `LONGEST_GAP_S` is left out, as are values that are not finite.
    """

    walked_s: float = 0.0
    distance_m: float = 0.0
    highest_force_n: float = 0.0
    _turned_s: float = 0.0
    _last_s: float | None = None
    _counted: Array | None = None
    """Where the distance was counted last."""

    def update(self, time_s: float, place: Array, wish: Array, velocity: Array, hand_force_n: float) -> None:
        """Take the middle of the feet (2,) in m, which does not sway with each step, the wished and the real
        velocity of the centre of mass (2,) in m/s, and the largest hand force.
        """
        values = (time_s, *place, *wish, *velocity, hand_force_n)
        if not np.isfinite(values).all():
            return
        dt_s = time_s - self._last_s if self._last_s is not None else np.inf
        if 0 < dt_s <= LONGEST_GAP_S and self._counted is not None:
            moved_m = float(np.linalg.norm(place - self._counted))
            if moved_m >= LEAST_M:
                self.distance_m += moved_m
                self._counted = place.copy()
            if float(np.linalg.norm(wish)) >= MIN_MPS:
                self.walked_s += dt_s
                self._turned_s += dt_s * angle_between(wish, velocity)
        else:
            self._counted = place.copy()
        self.highest_force_n = max(self.highest_force_n, hand_force_n)
        self._last_s = time_s

    @property
    def mean_direction_error_rad(self) -> float | None:
        """Return how far the robot went off the wished direction on average, None if nobody wished."""
        return self._turned_s / self.walked_s if self.walked_s else None


def angle_between(first: Array, second: Array) -> float:
    """Return the angle between two vectors (2,) in rad, 0 if one is near zero."""
    if min(float(np.linalg.norm(first)), float(np.linalg.norm(second))) < MIN_MPS:
        return 0.0
    across = first[0] * second[1] - first[1] * second[0]
    return float(abs(np.arctan2(across, first @ second)))
