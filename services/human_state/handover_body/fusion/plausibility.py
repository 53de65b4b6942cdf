"""Plausibility: which values of a sensor may be used.

A value is plausible within the range of its kind, with a quality of 0.5 at least, and if it does not change
faster than a body can. The first plausible value only starts a series: a value counts from the second one on
that agrees with the one before. So a single outlier never counts, and neither does the first value after a
fault, a lost contact or a pause.

A heart rate that falls is doubted: a detector that misses every second beat looks like a heart that calms
down. After a break (a fault, a pause, a value that is no continuation) a value that is more than
`MAX_FALL_BPM` below those that counted before does not count within `DOUBT_S` of the last of them; nor does
one that glides down by more than `MAX_GLIDE_BPM` in that time. A rise counts at once: it restricts more.

Example: 70, 71, 140, 72 bpm at 1 Hz. 70 starts the series, 71 counts, 140 is too fast (20 bpm/s at most) and
starts a series of its own, 72 does not agree with 140 and starts another one; the next value near 72 counts.
Example: 190 bpm, a fault of 4 s, then 100 bpm: the first value that counts comes 10 s after the last 190.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from handover_body.model.features import MIN_QUALITY, Feature, FeatureName, Status

STALE_S: Final = 3.0
STALE_PERIODS: Final = 3.0
EVENTS: Final = frozenset({FeatureName.APNOEA_EVENT})
"""Features that say that something happened; they feed no limit."""
MAX_PERIOD_S: Final = 60.0
"""A sensor cannot extend its own staleness beyond three of these."""

DOUBT_S: Final = 10.0
MAX_FALL_BPM: Final = 15.0
MAX_GLIDE_BPM: Final = 40.0
HELD_S: Final = 4.0
"""The lowest value of so long a time is what the next ones are compared with: no short peak is."""
MAX_COUNTED: Final = 64


@dataclass(frozen=True, slots=True)
class Range:
    """The plausible values of a feature, and how fast it changes, per second."""

    lowest: float
    highest: float
    slew_per_s: float = math.inf


RANGES: Final[Mapping[FeatureName, Range]] = {
    FeatureName.HEART_RATE: Range(30.0, 220.0, 20.0),
    FeatureName.BREATHING_RATE: Range(3.0, 70.0),
    FeatureName.HRV_RMSSD: Range(0.0, 500.0),
    FeatureName.HRV_SDNN: Range(0.0, 500.0),
    FeatureName.SPO2: Range(50.0, 100.0),
    FeatureName.EDA_TONIC: Range(0.0, 100.0),
    FeatureName.SKIN_TEMPERATURE: Range(10.0, 45.0),
    FeatureName.MOVEMENT: Range(0.0, 1.0),
    FeatureName.BODY_MOVEMENT: Range(0.0, 100.0),
    FeatureName.LOAD: Range(0.0, math.inf),
    FeatureName.BLINK_RATE: Range(0.0, 120.0),
    FeatureName.BLINK_DURATION: Range(20.0, 2000.0),
    FeatureName.FIXATION_DURATION: Range(20.0, 10_000.0),
    FeatureName.SACCADE_RATE: Range(0.0, 10.0),
    FeatureName.SACCADE_AMPLITUDE: Range(0.0, 120.0),
    FeatureName.PUPIL_DIAMETER: Range(1.0, 10.0),
}
"""Heart rate: the contract of human state. The others are what the human body can have."""


def stale_after_s(period_s: float) -> float:
    """Return the age at which a value with this period is stale; a period that is no number counts as 0."""
    period = period_s if math.isfinite(period_s) and period_s > 0 else 0.0
    return max(STALE_S, STALE_PERIODS * min(period, MAX_PERIOD_S))


@dataclass(frozen=True, slots=True)
class Series:
    """The values of one feature of one sensor: the last plausible one, and how many agreed in a row."""

    last: Feature | None = None
    agreeing: int = 0
    counted: tuple[tuple[float, float], ...] = ()
    """Times and heart rates that counted in the last `DOUBT_S`, oldest first; they outlast a break."""

    def broken(self) -> "Series":
        """Return the series after a fault: the next value starts another one."""
        return Series(counted=self.counted)

    def take(self, feature: Feature) -> tuple["Series", Feature | None]:
        """Return the series with the next value, and the value with its status.

        None instead of a value: it starts a series and does not count yet, or it is older than the last one.
        """
        last = self.last
        if not math.isfinite(feature.at_s) or (last is not None and feature.at_s <= last.at_s):
            return self, None
        if feature.status is Status.STALE or not _is_acceptable(feature):
            is_stale = feature.status is Status.STALE
            return self.broken(), feature if is_stale else replace(feature, status=Status.IMPLAUSIBLE)
        if last is None or feature.at_s - last.at_s > stale_after_s(last.period_s):
            # an event happens once: no second one agrees with it
            return replace(self, last=feature, agreeing=1), feature if feature.name in EVENTS else None
        if not _is_reachable(last, feature):
            return replace(self, last=feature, agreeing=1), replace(feature, status=Status.IMPLAUSIBLE)
        return self._continued(feature)

    def _continued(self, feature: Feature) -> tuple["Series", Feature]:
        continued = replace(self, last=feature, agreeing=self.agreeing + 1)
        if feature.name is not FeatureName.HEART_RATE:
            return continued, feature
        if self._is_doubtful_fall(feature):
            return continued, replace(feature, status=Status.IMPLAUSIBLE)
        return replace(continued, counted=_with(self.counted, feature)), feature

    def _is_doubtful_fall(self, feature: Feature) -> bool:
        """Return whether a heart rate is lower than a body explains after those that counted."""
        recent = [(at_s, bpm) for at_s, bpm in self.counted if at_s >= feature.at_s - DOUBT_S]
        if not recent:
            return False
        newest_s = recent[-1][0]
        is_continued = self.last is not None and newest_s >= self.last.at_s
        held_until_s = feature.at_s - DOUBT_S + HELD_S if is_continued else newest_s
        held = [bpm for at_s, bpm in recent if held_until_s - HELD_S <= at_s <= held_until_s]
        return bool(held) and float(feature.value) < min(held) - (
            MAX_GLIDE_BPM if is_continued else MAX_FALL_BPM
        )


def _with(counted: tuple[tuple[float, float], ...], feature: Feature) -> tuple[tuple[float, float], ...]:
    kept = [pair for pair in counted if pair[0] >= feature.at_s - DOUBT_S]
    return (*kept[1 - MAX_COUNTED :], (feature.at_s, float(feature.value)))


def _is_acceptable(feature: Feature) -> bool:
    """Return whether status, quality and range are those of a usable value."""
    if feature.status is not Status.VALID:
        return False
    if not (math.isfinite(feature.quality) and MIN_QUALITY <= feature.quality <= 1.0):
        return False
    if isinstance(feature.value, str):
        return feature.name not in RANGES
    limits = RANGES.get(feature.name, Range(-math.inf, math.inf))
    return math.isfinite(feature.value) and limits.lowest <= feature.value <= limits.highest


def _is_reachable(before: Feature, now: Feature) -> bool:
    if isinstance(before.value, str) or isinstance(now.value, str):
        return True
    limits = RANGES.get(now.name)
    if limits is None:
        return True
    return abs(now.value - before.value) <= limits.slew_per_s * (now.at_s - before.at_s) + 1e-9
