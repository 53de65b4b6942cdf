"""Whether a patient caught the ball, from where the ball and the hands were.

The ball and a tracked hand are seen some 60 times a second, and come nearer by 5 cm between two samples: so
both are taken to move in a straight line in between, and what counts is the smallest distance on it. Places
are in m in one frame, times in s of one clock.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from handover_humanoid.model.kinematics import Array
from handover_humanoid.patterns.regions import Side

Result = Literal["caught", "missed", "lost"]


@dataclass(frozen=True, slots=True)
class CatchRules:
    """When a ball counts as caught.

    `radius_m` is the largest distance of the ball from the palm. With `needs_grip` the hand must also close,
    `grip_window_s` before or after the contact at most. A ball below `ground_m` is missed; so is one that
    flies for longer than `longest_s`, or leaves the room of `room_m` around the robot.
    """

    radius_m: float = 0.12
    needs_grip: bool = False
    grip_window_s: float = 0.2
    closed_grip: float = 0.5
    ground_m: float = 0.05
    longest_s: float = 3.0
    room_m: float = 5.0

    def __post_init__(self) -> None:
        for name in ("radius_m", "grip_window_s", "longest_s", "room_m"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be above 0 and finite")
        if not 0 < self.closed_grip <= 1:
            raise ValueError(f"closed_grip is {self.closed_grip}; it must be above 0, and 1 at most")


@dataclass(frozen=True, slots=True)
class HandSample:
    """The palm of a tracked hand: its place (3,) in m, and how far it is closed, from 0 to 1."""

    position: Array
    grip: float = 0.0

    @property
    def is_finite(self) -> bool:
        """Return whether the values can be used."""
        return bool(np.isfinite(self.position).all() and np.isfinite(self.grip))


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a throw ended, `after_s` its release.

    `side` is the hand that caught it, or was nearest; `closest_m` its smallest distance from the ball, NaN if
    no hand was tracked. `reaction_s` is how long after the release a hand began to move, NaN if none did.
    """

    result: Result
    after_s: float
    side: Side | None
    closest_m: float
    reaction_s: float


MOVES_MPS = 0.15
"""A hand at this speed has begun to move."""


class CatchDetector:
    """Watches one throw from its release. Samples that are not finite, or out of order, are left out."""

    def __init__(self, released_s: float, rules: CatchRules | None = None) -> None:
        self.rules = rules or CatchRules()
        self._released_s = self._last_s = released_s
        self._apart: dict[Side, Array] = {}
        self._hands: dict[Side, Array] = {}
        self._closest: dict[Side, float] = {}
        self._contacts: dict[Side, float] = {}
        self._closed: dict[Side, float] = {}
        self._reaction_s = np.nan
        self.outcome: Outcome | None = None

    def update(self, time_s: float, ball: Array, hands: Mapping[Side, HandSample]) -> Outcome | None:
        """Take the ball (3,) and the hands that are tracked now; return the outcome once it is known."""
        if self.outcome is not None or not (time_s > self._last_s and np.isfinite(ball).all()):
            return self.outcome
        dt_s, self._last_s = time_s - self._last_s, time_s
        seen = {side: hand for side, hand in hands.items() if hand.is_finite}
        for side in [*self._apart]:
            if side not in seen:  # a straight line over a gap would be a guess
                del self._apart[side], self._hands[side]
        for side, hand in seen.items():
            self._follow(side, hand, ball, time_s, dt_s)
        caught = self._caught()
        if caught is not None:
            self.outcome = self._ended("caught", self._contacts[caught] - self._released_s, caught)
        elif self._is_over(ball, time_s):
            is_lost = float(np.linalg.norm(ball)) > self.rules.room_m
            nearest = min(self._closest, key=self._closest.__getitem__, default=None)
            self.outcome = self._ended("lost" if is_lost else "missed", time_s - self._released_s, nearest)
        return self.outcome

    def _follow(self, side: Side, hand: HandSample, ball: Array, time_s: float, dt_s: float) -> None:
        apart = ball - hand.position
        share, distance = _closest(self._apart.get(side, apart), apart)
        self._closest[side] = min(distance, self._closest.get(side, np.inf))
        if distance <= self.rules.radius_m:
            self._contacts.setdefault(side, time_s - (1.0 - share) * dt_s)
        if hand.grip >= self.rules.closed_grip:
            self._closed[side] = time_s
        if side in self._hands and np.isnan(self._reaction_s):
            speed_mps = float(np.linalg.norm(hand.position - self._hands[side])) / dt_s
            if speed_mps > MOVES_MPS:
                self._reaction_s = time_s - self._released_s
        self._apart[side], self._hands[side] = apart, hand.position.copy()

    def _caught(self) -> Side | None:
        """Return the hand that touched the ball first, and closed if it must."""
        for side in sorted(self._contacts, key=self._contacts.__getitem__):
            closed_s = self._closed.get(side, -np.inf)
            if not self.rules.needs_grip or (
                abs(closed_s - self._contacts[side]) <= self.rules.grip_window_s
            ):
                return side
        return None

    def _is_over(self, ball: Array, time_s: float) -> bool:
        """Return whether nobody can catch the ball any more; a hand that touched it may still close."""
        touched_s = max(self._contacts.values(), default=-np.inf)
        if self.rules.needs_grip and time_s - touched_s <= self.rules.grip_window_s:
            return False
        is_away = float(np.linalg.norm(ball)) > self.rules.room_m
        return bool(
            ball[2] < self.rules.ground_m or is_away or time_s - self._released_s > self.rules.longest_s
        )

    def _ended(self, result: Result, after_s: float, side: Side | None) -> Outcome:
        closest_m = self._closest.get(side, np.nan) if side is not None else np.nan
        return Outcome(result, after_s, side, closest_m, float(self._reaction_s))


def _closest(start: Array, end: Array) -> tuple[float, float]:
    """Return the share of the line from `start` to `end` (3,) nearest to the origin, and its distance."""
    way = end - start
    squared = float(way @ way)
    share = min(max(-float(start @ way) / squared, 0.0), 1.0) if squared > 0 else 1.0
    return share, float(np.linalg.norm(start + share * way))
