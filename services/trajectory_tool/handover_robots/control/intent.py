"""Intent prediction: which goal a person steers to.

Each goal has a probability. A commanded velocity towards a goal raises it, away from it lowers it: the update
of a Bayesian observer who assumes that people prefer the shortest way (maximum entropy, after Dragan and
Srinivasa, 2013). Old evidence fades, so that a change of mind is seen within a second or two. Without
commands nothing changes.
"""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from handover_robots.model.poses import Pose

Array = NDArray[np.float64]

RATIONALITY: Final = 6.0
"""How strongly a direction counts: the log-likelihood per second of full speed along it."""
FADES_IN_S: Final = 2.0
MIN_SPEED_MPS: Final = 0.005


class IntentPrediction:
    """The probabilities of goals by name."""

    def __init__(self) -> None:
        self._evidence: dict[str, float] = {}

    def set_goals(self, names: Mapping[str, Pose]) -> None:
        """Change the goals; known ones keep their evidence."""
        self._evidence = {name: self._evidence.get(name, 0.0) for name in names}

    def observe(
        self, here: Pose, human: Array, goals: Mapping[str, Pose], dt_s: float, full_speed_mps: float
    ) -> None:
        """Take a commanded velocity (m/s, axes of the base) of the last `dt_s` seconds into account."""
        speed = float(np.linalg.norm(human[:3]))
        if speed < MIN_SPEED_MPS or dt_s <= 0:
            return
        fading = math.exp(-dt_s / FADES_IN_S)
        weight = RATIONALITY * min(speed / full_speed_mps, 1.0) * dt_s
        for name, goal in goals.items():
            way = np.subtract(goal.position, here.position)
            distance = float(np.linalg.norm(way))
            cosine = float(human[:3] @ way) / (speed * distance) if distance > 0 else 0.0
            self._evidence[name] = fading * self._evidence.get(name, 0.0) + weight * cosine

    def probabilities(self) -> dict[str, float]:
        """Return the probabilities of all goals; they sum to 1."""
        if not self._evidence:
            return {}
        highest = max(self._evidence.values())
        weights = {name: math.exp(value - highest) for name, value in self._evidence.items()}
        total = sum(weights.values())
        return {name: weight / total for name, weight in weights.items()}

    def best(self) -> tuple[str, float] | None:
        """Return the most probable goal and the confidence in it: 0 if all are equal, 1 if it is certain."""
        by_goal = self.probabilities()
        if not by_goal:
            return None
        name = max(by_goal, key=lambda goal: by_goal[goal])
        uniform = 1 / len(by_goal)
        confidence = 1.0 if len(by_goal) == 1 else (by_goal[name] - uniform) / (1 - uniform)
        return name, max(confidence, 0.0)
