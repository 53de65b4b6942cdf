"""A simulated walker on a belt, and the range sensor before them. Seeded; the time is given in steps.

The walker has a pace of their own. They follow the advice of the coach after some seconds, most times, by a
tenth of a m/s; the pace wanders a little, each step moves the chest, and near an end of the belt they
correct it. Who the walker is, and how the heart answers, is not known here.
"""

import math
import random
from collections import deque
from dataclasses import dataclass
from typing import Final

from handover_cases.machines.treadmill.coach import Advice

NOISE_M: Final = 0.01
"""Standard deviation of the range sensor."""
STEP_SWAY_M: Final = 0.02
MAX_PACE_MPS: Final = 2.0
MAX_PACE_CHANGE: Final = 0.25
"""How fast a walker gains pace, in m/s²."""
MAX_SLOWING: Final = 0.8
"""How fast they slow down: they hold the rails when the belt stops."""
WANDER_S: Final = 20.0
SWAY_HZ: Final = 1.7
PLACE_RATE: Final = 0.5
"""How fast a walker comes back to the middle of a belt that stops, in 1/s."""
END_RATE: Final = 3.0
"""How much a walker beyond comfort adapts to the belt, in 1/s: nobody walks into the rail."""
COMFORT_M: Final = 0.25
"""So far from the middle the walker does not mind."""


@dataclass(frozen=True, slots=True)
class Habits:
    """How a person walks and listens."""

    pace_mps: float = 0.7
    """The pace they begin with."""
    answer_mps: float = 0.12
    """By how much they change the pace on advice."""
    compliance: float = 0.9
    """The share of advice that they follow."""
    reaction_s: tuple[float, float] = (1.5, 5.0)
    wander_mps: float = 0.03


class SimulatedWalker:
    """The walker. `walk_mps` is the speed of the walk, `place_m` the place on the belt, positive ahead."""

    def __init__(self, seed: int, habits: Habits | None = None) -> None:
        self.habits: Final = habits or Habits()
        self.pace_mps = self.habits.pace_mps
        self.walk_mps = 0.0
        self.place_m = 0.0
        self.is_on_belt = True
        self.now_s = 0.0
        self._random = random.Random(seed)  # noqa: S311 - a simulation, nothing secret
        self._wander_mps = 0.0
        self._pending: deque[tuple[float, float]] = deque(maxlen=8)

    def follow(self, advice: Advice) -> None:
        """Follow what the coach says, after the time of reaction, or not."""
        if self._random.random() > self.habits.compliance:
            return
        change_mps = {Advice.FASTER: 1.0, Advice.KEEP: 0.0, Advice.SLOWER: -1.0}[
            advice
        ] * self.habits.answer_mps
        due_s = self.now_s + self._random.uniform(*self.habits.reaction_s)
        self._pending.append((due_s, change_mps * self._random.uniform(0.7, 1.3)))

    def step(self, seconds: float, belt_mps: float, *, is_walking: bool = True) -> None:
        """Let `seconds` pass on a belt of this speed; without a training the walker stays in the middle."""
        self.now_s += seconds
        while self._pending and self._pending[0][0] <= self.now_s:
            self.pace_mps = min(max(self.pace_mps + self._pending.popleft()[1], 0.2), MAX_PACE_MPS)
        share = math.exp(-seconds / WANDER_S)
        noise = self.habits.wander_mps * math.sqrt(1 - share * share)
        self._wander_mps = share * self._wander_mps + self._random.gauss(0.0, noise)
        wanted = self.pace_mps + self._wander_mps - END_RATE * self._beyond_comfort()
        if not is_walking:
            wanted = max(belt_mps - PLACE_RATE * self.place_m, 0.0)
        change = min(max(wanted - self.walk_mps, -MAX_SLOWING * seconds), MAX_PACE_CHANGE * seconds)
        self.walk_mps = max(self.walk_mps + change, 0.0)
        self.place_m += (self.walk_mps - belt_mps) * seconds

    def _beyond_comfort(self) -> float:
        return max(self.place_m - COMFORT_M, 0.0) + min(self.place_m + COMFORT_M, 0.0)

    def reading(self, sensor_to_middle_m: float) -> float | None:
        """Return what the range sensor measures in m; None when nobody is on the belt."""
        if not self.is_on_belt:
            return None
        sway = STEP_SWAY_M * math.sin(math.tau * SWAY_HZ * self.now_s) if self.walk_mps > 0.1 else 0.0
        return sensor_to_middle_m - self.place_m + sway + self._random.gauss(0.0, NOISE_M)
