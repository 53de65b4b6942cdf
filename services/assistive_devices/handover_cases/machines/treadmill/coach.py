"""What the coach decides: faster, keep or slower, every 30 s, by code. Pure; the time is an argument.

The heart answers a change of pace within a minute, so a decision that looks at the present rate only
arrives too late and the rate swings around the zone. The coach looks at the present rate and at the rate
that the trend of the last 20 s leads to in 30 s:

| present | expected in 30 s | advice |
|---|---|---|
| below the zone | below it | faster, unless the belt is at its limit: keep |
| below the zone | in it or above | keep |
| in the zone | above / below it / in it | slower / faster / keep |
| above the zone | above it, or in its upper half | slower |
| above the zone | in its lower half, or below it | keep |

Without a valid, fresh heart rate the advice is slower. Advice never moves the belt: the walker does.
"""

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

ADVICE_EVERY_S: Final = 30.0
TREND_S: Final = 20.0
LEAD_S: Final = 30.0
MAX_TREND_BPM_S: Final = 0.5
FRESH_S: Final = 5.0
MAX_RATES: Final = 64
AT_LIMIT_SHARE: Final = 0.97


class Advice(StrEnum):
    """What the walker should do."""

    FASTER = "faster"
    KEEP = "keep"
    SLOWER = "slower"


class Reason(StrEnum):
    """Why."""

    BELOW = "below"
    INSIDE = "inside"
    ABOVE = "above"
    RISING = "rising"
    FALLING = "falling"
    AT_LIMIT = "atLimit"
    NO_SIGNAL = "noSignal"


class Intensity(StrEnum):
    """What the person chooses."""

    GENTLE = "gentle"
    LIGHT = "light"
    MODERATE = "moderate"
    BRISK = "brisk"


@dataclass(frozen=True, slots=True)
class Zone:
    """A range of heart rates in bpm."""

    low_bpm: float
    high_bpm: float

    def __contains__(self, bpm: float) -> bool:
        """Return whether a heart rate lies in the zone, its ends included."""
        return self.low_bpm <= bpm <= self.high_bpm

    @property
    def middle_bpm(self) -> float:
        """Return the middle."""
        return (self.low_bpm + self.high_bpm) / 2

    def judged(self, present: float, expected: float) -> "tuple[Advice, Reason]":
        """Return the advice for a present and an expected heart rate: the table of this module."""
        if present > self.high_bpm:
            is_falling = expected < self.middle_bpm
            return (Advice.KEEP, Reason.FALLING) if is_falling else (Advice.SLOWER, Reason.ABOVE)
        if present < self.low_bpm:
            is_rising = expected >= self.low_bpm
            return (Advice.KEEP, Reason.RISING) if is_rising else (Advice.FASTER, Reason.BELOW)
        if expected > self.high_bpm:
            return Advice.SLOWER, Reason.RISING
        return (Advice.FASTER, Reason.FALLING) if expected < self.low_bpm else (Advice.KEEP, Reason.INSIDE)


ZONES: Final[dict[Intensity, Zone]] = {
    Intensity.GENTLE: Zone(75, 85),
    Intensity.LIGHT: Zone(85, 95),
    Intensity.MODERATE: Zone(95, 105),
    Intensity.BRISK: Zone(105, 115),
}
"""The light zone is that of ROS4HC (85 to 95 bpm); the others are ours, 10 bpm apart."""


@dataclass(frozen=True, slots=True)
class Decision:
    """One intervention. `at_s` is on the clock of the coach."""

    advice: Advice
    reason: Reason
    at_s: float


@dataclass(frozen=True, slots=True)
class Coach:
    """The coach of one session that began at `since_s`. Frozen: `take` and `decide` return what follows."""

    zone: Zone
    since_s: float
    decision_count: int = 0
    """How many decisions were made."""
    rates: tuple[tuple[float, float], ...] = ()
    """The last valid heart rates: time in s, bpm."""

    def take(self, bpm: float, at_s: float) -> "Coach":
        """Return the coach with one more valid heart rate; what is no rate, or older, is ignored."""
        if not (math.isfinite(bpm) and 20 <= bpm <= 250) or (self.rates and at_s <= self.rates[-1][0]):
            return self
        kept = tuple(rate for rate in self.rates if at_s - rate[0] <= TREND_S)[-(MAX_RATES - 1) :]
        return replace(self, rates=(*kept, (at_s, bpm)))

    def decide(self, now_s: float, *, is_at_limit: bool) -> tuple["Coach", Decision | None]:
        """Return the coach and, when 30 s have passed, the next decision. A pause makes up for none."""
        passed = math.floor((now_s - self.since_s) / ADVICE_EVERY_S)
        if passed <= self.decision_count:
            return self, None
        advice, reason = self._judged(now_s, is_at_limit=is_at_limit)
        return replace(self, decision_count=passed), Decision(advice, reason, now_s)

    def _judged(self, now_s: float, *, is_at_limit: bool) -> tuple[Advice, Reason]:
        if not self.rates or now_s - self.rates[-1][0] > FRESH_S:
            return Advice.SLOWER, Reason.NO_SIGNAL
        present = self.rates[-1][1]
        expected = present + LEAD_S * self._trend()
        judgement = self.zone.judged(present, expected)
        if judgement[0] is Advice.FASTER and is_at_limit:
            return Advice.KEEP, Reason.AT_LIMIT
        return judgement

    def _trend(self) -> float:
        """Return the slope of the last rates by least squares, in bpm a second, at most half a bpm."""
        if len(self.rates) < 5 or self.rates[-1][0] - self.rates[0][0] < TREND_S / 2:
            return 0.0
        times = [at_s - self.rates[-1][0] for at_s, _ in self.rates]
        mean_s = sum(times) / len(times)
        mean_bpm = sum(bpm for _, bpm in self.rates) / len(self.rates)
        spread = sum((at_s - mean_s) ** 2 for at_s in times)
        slope = sum(
            (at_s - mean_s) * (bpm - mean_bpm) for at_s, (_, bpm) in zip(times, self.rates, strict=True)
        )
        return min(max(slope / spread, -MAX_TREND_BPM_S), MAX_TREND_BPM_S)
