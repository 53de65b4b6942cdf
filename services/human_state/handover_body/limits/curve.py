"""From a heart rate to a fraction of the speed."""

from dataclasses import dataclass
from typing import Final

from handover.messages import number_text
from handover_body.fusion.baseline import Baseline

PAPER_FREE_BPM: Final = 90.0
PAPER_STRAINED_BPM: Final = 125.0
"""The wheelchair of ROS4HC: vmax falls linearly from 90 to 125 bpm."""
FREE_EXERTION: Final = 0.30
STRAINED_EXERTION: Final = 0.60
"""Shares of the heart rate reserve: from 0.30 an exertion is light, from 0.60 vigorous (ACSM guidelines)."""
DEFAULT_LEAST: Final = 0.2


@dataclass(frozen=True, slots=True)
class LimitCurve:
    """Full speed up to `free_bpm`, `least` from `strained_bpm` on, linear between; a `least` of 0 stops."""

    free_bpm: float = PAPER_FREE_BPM
    strained_bpm: float = PAPER_STRAINED_BPM
    least: float = DEFAULT_LEAST

    def __post_init__(self) -> None:
        if not 40 <= self.free_bpm <= self.strained_bpm - 5 or not self.strained_bpm <= 200:
            raise ValueError(
                f"the limit falls from {number_text(self.free_bpm)} to {number_text(self.strained_bpm)} bpm; "
                "it must begin at 40 bpm at least, end at 200 at most, and the two must be 5 bpm apart"
            )
        if not 0 <= self.least < 1:
            raise ValueError(f"the least fraction is {self.least}; it must be 0 or more and below 1")

    def fraction(self, heart_rate_bpm: float) -> float:
        """Return the fraction of the speed, `least` to 1; it never rises with the heart rate."""
        share = (heart_rate_bpm - self.free_bpm) / (self.strained_bpm - self.free_bpm)
        share = min(max(share, 0.0), 1.0)
        return max(1.0 - share * (1.0 - self.least), self.least)


def of_baseline(baseline: Baseline, least: float = DEFAULT_LEAST) -> LimitCurve:
    """Return the curve of a person whose baseline is known."""
    return LimitCurve(baseline.at_exertion(FREE_EXERTION), baseline.at_exertion(STRAINED_EXERTION), least)
