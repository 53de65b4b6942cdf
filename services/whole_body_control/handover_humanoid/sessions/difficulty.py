"""Throws that are as difficult as a patient can stand: a weighted staircase over one difficulty from 0 to 1.

After each caught ball the difficulty rises by `step_up`, after each missed one it falls by as much as makes
`wanted_share` of the throws a success in the long run (Kaernbach 1991): step_down = step_up p / (1 - p). The
difficulty opens what a throw may use, in this order of effort: away from the middle, to the weaker side,
higher or lower, and faster on a flatter arc.
"""

from dataclasses import dataclass, field

import numpy as np

from handover_humanoid.model.kinematics import Array
from handover_humanoid.patterns.regions import Side


@dataclass(frozen=True, slots=True)
class CatchingSpace:
    """Where a patient reaches a ball, in m in the frame of the robot: x ahead of it, y to its left, z up.

    The default is a person who sits 0.8 m ahead of COMAN. `side_m` and `height_m` are how far the hands move
    from the `centre` (3,). A flight takes `longest_s` for an easy throw, and `shortest_s` for the fastest.
    """

    centre: tuple[float, float, float] = (0.8, 0.0, 0.6)
    side_m: float = 0.3
    height_m: float = 0.15
    longest_s: float = 0.6
    shortest_s: float = 0.4

    def __post_init__(self) -> None:
        values = (*self.centre, self.side_m, self.height_m, self.longest_s, self.shortest_s)
        if not np.isfinite(values).all():
            raise ValueError("the space of a patient has a value that is not finite")
        if not (self.side_m >= 0 and self.height_m >= 0 and 0 < self.shortest_s <= self.longest_s):
            raise ValueError(
                "side_m and height_m must be 0 or more, and shortest_s above 0 and at most longest_s"
            )


@dataclass(frozen=True, slots=True)
class ThrowWish:
    """A throw of a hand of the robot to `target` (3,) in m, with a flight of `flight_s`."""

    target: Array
    hand: Side
    flight_s: float


@dataclass(frozen=True, slots=True)
class DifficultyRules:
    """The staircase, and what a therapist fixes; `weak_side` is the patient's, thrown at more often."""

    start: float = 0.1
    step_up: float = 0.04
    wanted_share: float = 0.75
    is_adaptive: bool = True
    weak_side: Side | None = None
    hand: Side | None = None

    def __post_init__(self) -> None:
        if not (0 <= self.start <= 1 and 0 < self.step_up <= 1 and 0 < self.wanted_share < 1):
            raise ValueError(
                "start must be from 0 to 1, step_up above 0 and at most 1, wanted_share between 0 and 1"
            )


@dataclass(slots=True)
class Difficulty:
    """The difficulty of a session; draws throws from a seeded generator."""

    space: CatchingSpace = field(default_factory=CatchingSpace)
    rules: DifficultyRules = field(default_factory=DifficultyRules)
    seed: int = 0
    level: float = field(init=False)
    _random: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.level = self.rules.start
        self._random = np.random.default_rng(self.seed)

    def learn(self, is_caught: bool) -> None:
        """Move the difficulty by the outcome of a throw."""
        if not self.rules.is_adaptive:
            return
        p = self.rules.wanted_share
        step = self.rules.step_up if is_caught else -self.rules.step_up * p / (1 - p)
        self.level = min(max(self.level + step, 0.0), 1.0)

    def next_throw(self) -> ThrowWish:
        """Return the next throw within the space of the patient."""
        space, level = self.space, self.level
        side = self._side()
        outwards = 1.0 if side == "left" else -1.0
        sideways = outwards * space.side_m * self._random.uniform(0.5, 1.0) * min(2 * level, 1.0)
        upwards = space.height_m * self._random.uniform(-1.0, 1.0) * min(max(2 * level - 0.5, 0.0), 1.0)
        fast = self._random.uniform(0.5, 1.0) * max(2 * level - 1.0, 0.0)
        x, y, z = space.centre
        flight_s = space.longest_s - fast * (space.longest_s - space.shortest_s)
        hand = self.rules.hand or side
        return ThrowWish(np.array([x, y + sideways, z + upwards]), hand, flight_s)

    def _side(self) -> Side:
        """Return the side of the robot to throw to; it faces the patient, whose left is at its right."""
        weak = self.rules.weak_side
        share_left = 0.5 if weak is None else (0.65 if weak == "right" else 0.35)
        return "left" if self._random.random() < share_left else "right"
