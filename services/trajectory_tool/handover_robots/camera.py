"""The simulated camera above a bin: it detects a part with a given probability."""

import random
from collections.abc import Sequence


class Camera:
    """Detects parts with the probability `detection_rate`; a `seed` determines the sequence of results."""

    def __init__(self, detection_rate: float, seed: int) -> None:
        self._detection_rate = detection_rate
        self._chance = random.Random(seed)  # noqa: S311 - a simulation that must repeat

    def look(self, parts: Sequence[str]) -> str | None:
        """Return the topmost of `parts`; None if it is not detected."""
        seen = self._chance.random() < self._detection_rate
        return parts[0] if parts and seen else None
