"""Checks of straight lines in joint space, with a certificate for what lies between the samples.

A point of the robot moves at most `Collisions.travel_m` between two configurations. A configuration that is
free with a margin therefore certifies the line as far as that travel stays within the margin to both sides.
So the middle of a line is checked with the smallest travel of a ladder that covers the whole line; if it is
free, the line is done, otherwise both halves are checked. In free space that takes a few checks, near an
obstacle it ends at the planning margin.

Example: with a margin of 10 mm, a line with a travel of 150 mm and an obstacle 50 mm away, the middle is not
free with 80 mm; the halves (travel 75 mm) are certified by one check with 40 mm each.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from handover_robots.planning.arm import Array
from handover_robots.planning.collision import Collisions

LADDER = (16.0, 8.0, 4.0, 2.0, 1.0)
"""The travels that a check may cover, as multiples of the planning margin."""


class Motions:
    """Straight motions of a robot in a world, with `margin_m` at the samples and no contact between them."""

    def __init__(self, collisions: Collisions, margin_m: float) -> None:
        if not margin_m > 0:
            raise ValueError("a certificate needs a margin above 0")
        self.collisions = collisions
        self.margin_m = margin_m
        self._travels = [step * margin_m for step in LADDER]
        self.checked = 0
        """The number of checked lines, for measurements."""

    def is_state_free(self, joints: Array) -> bool:
        """Return whether a configuration is free with the margin."""
        return self.collisions.is_free(joints, self.margin_m)

    def is_free(self, start: Array, end: Array) -> bool:
        """Return whether the line from `start` to `end` is free; `start` is known to be free."""
        self.checked += 1
        return self.is_state_free(end) and self._is_between_free(start, end)

    def is_path_free(self, path: Sequence[Array]) -> bool:
        """Return whether all lines of a path are free, its ends included."""
        return self.is_state_free(path[0]) and all(self.is_free(start, end) for start, end in pairwise(path))

    def first_contact(self, path: Sequence[Array]) -> Array | None:
        """Return the first configuration of a path with something within the margin; None without one."""
        for start, end in pairwise(path):
            steps = max(int(np.ceil(self.collisions.travel_m(start, end) / (2 * self.margin_m))), 1)
            for share in np.linspace(0.0, 1.0, steps + 1):
                joints = start + share * (end - start)
                if not self.is_state_free(joints):
                    return np.asarray(joints)
        return None

    def are_samples_free(self, samples: Array) -> bool:
        """Return whether a sampled curve is free, its samples and the lines between them."""
        travels = np.abs(np.diff(samples, axis=0)) @ self.collisions.reach
        place = np.concatenate([[0.0], np.cumsum(travels)])
        return self.is_state_free(samples[-1]) and self._are_free(samples, place, 0, len(samples) - 1)

    def _is_between_free(self, start: Array, end: Array) -> bool:
        """Breadth first, so that a blocked line is found early."""
        half_m = self.collisions.travel_m(start, end) / 2
        ways = [(start, end)]
        margin_m, collisions = self.margin_m, self.collisions
        while ways:
            covering = self._covering(half_m)
            rest = []
            for first, last in ways:
                middle = (first + last) / 2
                if covering is not None and collisions.is_free_within(middle, covering, margin_m):
                    continue
                if covering == margin_m or not collisions.is_free(middle, margin_m):
                    return False
                rest += [(first, middle), (middle, last)]
            ways, half_m = rest, half_m / 2
        return True

    def _are_free(self, samples: Array, place: Array, first: int, last: int) -> bool:
        spans = [(first, last)]
        while spans:
            rest = []
            for low, high in spans:
                middle = (low + high) // 2
                half_m = max(place[middle] - place[low], place[high] - place[middle])
                covering = self._covering(half_m)
                if covering is not None and self.collisions.is_free_within(
                    samples[middle], covering, self.margin_m
                ):
                    continue
                if not self.collisions.is_free(samples[middle], self.margin_m):
                    return False
                if high - low > 1:
                    rest += [(low, middle), (middle, high)]
                elif not self._is_between_free(samples[low], samples[high]):
                    return False
            spans = rest
        return True

    def _covering(self, half_m: float) -> float | None:
        """Return the smallest travel of the ladder that covers a travel; None if none does."""
        for travel_m in reversed(self._travels):
            if half_m <= travel_m:
                return travel_m
        return None
