"""The camera above a bin, simulated: it sees a part that lies there, or, now and then, it does not."""

import random
from collections.abc import Sequence


class Camera:
    """Sees parts with the probability `detection_rate`; the same `seed` gives the same sequence of scans."""

    def __init__(self, detection_rate: float, seed: int) -> None:
        self._detection_rate = detection_rate
        self._chance = random.Random(seed)  # noqa: S311 - a simulation that must repeat

    def look(self, parts: Sequence[str]) -> str | None:
        """Return the part of `parts` that lies on top, or None if none is seen this time."""
        seen = self._chance.random() < self._detection_rate
        return parts[0] if parts and seen else None
