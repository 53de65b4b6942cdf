"""Lasting strain: the exertion of a person, averaged over minutes, above what one can work at for long.

An average of 30 % of the heart rate reserve is the usual bound for a shift (Rodgers 1986; Rohmert's endurance
limit); above 60 % a person tires within minutes. A break is proposed when the moving mean of five minutes has
reached the threshold, once, and again only after it has fallen well below.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

WINDOW_S: Final = 300.0
DEFAULT_THRESHOLD: Final = 0.45
RECOVERED_SHARE: Final = 0.7
MAX_GAP_S: Final = 10.0


@dataclass(frozen=True, slots=True)
class Strain:
    """The exponential mean of exertion (0 to 1) with a time constant of `window_s`; frozen, time given."""

    threshold: float = DEFAULT_THRESHOLD
    window_s: float = WINDOW_S
    mean: float = 0.0
    at_s: float | None = None
    is_lasting: bool = False

    def take(self, exertion: float, at_s: float) -> "Strain":
        """Return the strain with the exertion at a time; pauses of more than 10 s count as 10 s."""
        if self.at_s is None:
            return replace(self, at_s=at_s)
        passed_s = min(max(at_s - self.at_s, 0.0), MAX_GAP_S)
        weight = 1 - math.exp(-passed_s / self.window_s)
        mean = self.mean + weight * (min(max(exertion, 0.0), 1.0) - self.mean)
        is_lasting = mean >= self.threshold * (RECOVERED_SHARE if self.is_lasting else 1.0)
        return replace(self, mean=mean, at_s=max(at_s, self.at_s), is_lasting=is_lasting)
