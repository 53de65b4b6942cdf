"""Heart rate and its variability from the times of beats, whatever sensor they come from.

Rules of the windows, after Task Force of ESC and NASPE, "Heart rate variability", Circulation 93:1043,
1996, and Shaffer and Ginsberg, "An overview of heart rate variability metrics and norms", Front Public
Health 5:258, 2017:

| value | window | needs | each |
|---|---|---|---|
| heartRate | 10 s, less while it changes | 3 intervals, 2.5 s | block |
| hrvRmssd | 60 s | 45 s of normal intervals | 5 s |
| hrvSdnn | 300 s | 120 s of normal intervals; quality falls below 300 s | 10 s |
| hrvLfHf | 300 s | 120 s of normal intervals, LF 0.04 to 0.15 Hz, HF 0.15 to 0.4 Hz | 30 s |

Only normal-to-normal intervals enter the variability: an interval next to a beat of another shape, or more
than 20 % from the median of the last nine, is left out (Malik's rule, with a median instead of the last
interval). Successive differences are taken of neighbours only.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from handover_body.model.features import MIN_QUALITY, Feature, FeatureName, Status

Floats = NDArray[np.float64]

HEART_RATE_WINDOW_S: Final = 10.0
RMSSD_WINDOW_S: Final = 60.0
LONG_WINDOW_S: Final = 300.0
MAX_CHANGE: Final = 0.2
MIN_INTERVALS: Final = 3
NEWEST_S: Final = 1.5
MAX_DRIFT: Final = 0.06
MAX_SPREAD: Final = 0.12
CLEAR_QUALITY: Final = 0.9
COVERED_S: Final = 3.0
"""A rate of so much signal has its full quality."""
RISE_S: Final = 9.0
MIN_RISE_BPM: Final = 6.0
MAX_RISE_BPM_PER_S: Final = 5.0
PLAUSIBLE_BPM: Final = (30.0, 220.0)
BOUND_SHARE: Final = 0.02
MAX_APART: Final = 0.06
CONFIRMED_S: Final = 10.0
MAX_UNCONFIRMED: Final = 0.3
"""The quality of a rate that the second estimate does not confirm."""

SecondRate = Callable[[float, float, float], Iterable[float]]
"""Returns independent rates in bpm between the times of two beats, for a mean interval in s."""


@dataclass(frozen=True, slots=True)
class Interval:
    """The time from one beat to the next, which came at `at_s`."""

    at_s: float
    length_s: float
    quality: float
    is_normal: bool
    is_usual_shape: bool = True


def steady_from(lengths_s: Floats, *, is_clear: bool = True) -> int:
    """Return the index from which on intervals, oldest first, have the rate of the newest of them.

    The newest are three intervals and `NEWEST_S` at least, or the last three of a clear signal where those
    differ. Older ones belong to them while their mean differs by no
    more than `MAX_DRIFT`, or than the usual changes from beat to beat explain: a rate that has changed is not
    averaged with the one before, and an irregular heart keeps its long window.

    Example: 0.75 s, 0.75 s, 0.75 s, then nine times 0.32 s give 3.
    """
    sums_s = np.concatenate(([0.0], np.cumsum(lengths_s)))
    count = len(lengths_s)
    newest = min(count - MIN_INTERVALS, int(np.searchsorted(sums_s, sums_s[-1] - NEWEST_S, side="right")) - 1)
    if newest <= 0:
        return 0
    mean_s = (sums_s[-1] - sums_s[newest]) / (count - newest)
    spread_s = 1.05 * float(np.median(np.abs(np.diff(lengths_s))))
    if _is_irregular(lengths_s[newest:]):
        newest = count - MIN_INTERVALS
        if not is_clear or _is_irregular(lengths_s[newest:]):
            return 0  # three intervals that differ are no rate
        mean_s = float(lengths_s[newest:].mean())
    allowed_s = max(MAX_DRIFT * mean_s, 3 * spread_s / np.sqrt(count - newest))
    older_s = (sums_s[newest] - sums_s[:newest]) / np.arange(newest, 0, -1)
    near = np.flatnonzero(np.abs(older_s - mean_s) <= allowed_s)
    return int(near[0]) if len(near) else newest


def _is_irregular(lengths_s: Floats) -> bool:
    return float(lengths_s.std()) > MAX_SPREAD * float(lengths_s.mean())


def rise_bpm(window: list[Interval], steady: list[Interval], at_s: float) -> float:
    """Return how much higher the rate is at `at_s` than in the middle of `steady`, while it rises steadily.

    A mean of the past is too low while the heart rate rises. Only a rise counts, one that lasts for `RISE_S`.
    """
    newest_s = window[-1].at_s
    parts = [
        [
            interval.length_s
            for interval in window
            if newest_s - (n + 1) * RISE_S / 3 < interval.at_s <= newest_s - n * RISE_S / 3
        ]
        for n in (2, 1, 0)
    ]
    if min(len(part) for part in parts) < 2:
        return 0.0
    first, middle, last = (60 / float(np.mean(part)) for part in parts)
    rise = last - first
    if rise < MIN_RISE_BPM or min(middle - first, last - middle) < rise / 4:
        return 0.0
    middle_s = (steady[0].at_s - steady[0].length_s + newest_s) / 2
    return min(1.5 * rise / RISE_S, MAX_RISE_BPM_PER_S) * max(0.0, at_s - middle_s)


def rmssd_ms(intervals: list[Interval]) -> float | None:
    """Return the root mean square of successive differences of neighbouring normal intervals."""
    squares = [
        (later.length_s - earlier.length_s) ** 2
        for earlier, later in pairwise(intervals)
        if earlier.is_normal and later.is_normal and abs(later.at_s - later.length_s - earlier.at_s) < 0.02
    ]
    return 1000 * float(np.sqrt(np.mean(squares))) if len(squares) >= 10 else None


def lf_hf(intervals: list[Interval]) -> tuple[float, float] | None:
    """Return the powers in s² at low and high frequency: Welch's method on intervals resampled at 4 Hz."""
    from scipy import signal as dsp  # noqa: PLC0415 -- an extra

    normal = [interval for interval in intervals if interval.is_normal]
    if len(normal) < 60:
        return None
    at_s = np.array([interval.at_s for interval in normal])
    grid_s = np.arange(at_s[0], at_s[-1], 0.25)
    series = np.interp(grid_s, at_s, [interval.length_s for interval in normal])
    if len(series) < 4 * 100:
        return None
    frequencies, power = dsp.welch(dsp.detrend(series), 4.0, nperseg=min(len(series), 4 * 120))
    low = power[(frequencies >= 0.04) & (frequencies < 0.15)].sum()
    high = power[(frequencies >= 0.15) & (frequencies < 0.4)].sum()
    width = frequencies[1] - frequencies[0]
    return float(low * width), float(high * width)


class Rhythm:
    """The intervals of the last 300 s of one sensor, and the features of them."""

    def __init__(self, method: str) -> None:
        self.method: Final = method
        self._intervals: deque[Interval] = deque(maxlen=1200)
        self._recent: deque[float] = deque(maxlen=9)
        self._last: tuple[float, bool] | None = None
        self._due_s: dict[FeatureName, float] = {}
        self._was_valid = False
        self._confirmed = 0.0, -math.inf

    def reset(self) -> None:
        """Forget all intervals: no value depends on beats before a fault and after it."""
        self._intervals.clear()
        self._recent.clear()
        self._last = None
        self._due_s.clear()
        self._was_valid = False
        self._confirmed = 0.0, -math.inf

    @property
    def intervals(self) -> list[Interval]:
        """Return the intervals of the last 300 s, oldest first."""
        return list(self._intervals)

    def add_beat(self, at_s: float, quality: float, *, is_usual_shape: bool = True) -> None:
        """Take the next beat."""
        if self._last is not None:
            last_s, was_usual = self._last
            self.add_interval(at_s, at_s - last_s, quality, is_usual_shape=is_usual_shape and was_usual)
        self._last = (at_s, is_usual_shape)

    def add_interval(
        self, at_s: float, length_s: float, quality: float, *, is_usual_shape: bool = True
    ) -> None:
        """Take the interval that ended at `at_s`."""
        if not 0.24 <= length_s <= 2.4:
            return
        usual_s = float(np.median(self._recent)) if len(self._recent) >= 3 else length_s
        is_near = abs(length_s - usual_s) <= MAX_CHANGE * usual_s
        self._recent.append(length_s)
        self._intervals.append(Interval(at_s, length_s, quality, is_near and is_usual_shape, is_usual_shape))
        while self._intervals and self._intervals[0].at_s < at_s - LONG_WINDOW_S:
            self._intervals.popleft()

    def features(
        self, source: str, at_s: float, period_s: float, second: SecondRate | None = None
    ) -> list[Feature]:
        """Return the features that are due, of the signal up to `at_s`."""
        rate = self.heart_rate(source, at_s, period_s, second)
        rates = [rate] if rate is not None else []
        if rate is None or rate.status is not Status.VALID:
            return rates
        for name, each_s in (
            (FeatureName.HRV_RMSSD, 5.0),
            (FeatureName.HRV_SDNN, 10.0),
            (FeatureName.HRV_LF_HF, 30.0),
        ):
            if at_s >= self._due_s.get(name, at_s):
                feature = self._variability(name, source, at_s, each_s)
                self._due_s[name] = at_s + each_s
                if feature is not None:
                    rates.append(feature)
        return rates

    def heart_rate(
        self, source: str, at_s: float, period_s: float, second: SecondRate | None = None
    ) -> Feature | None:
        """Return the rate of the newest beats; once implausible when beats stop, None before the first."""
        # Beats are accepted up to 1.5 s late; two intervals more without one are a fault.
        interval_s = float(np.median(self._recent)) if self._recent else 1.0
        window = [
            interval for interval in self._intervals if interval.at_s > at_s - HEART_RATE_WINDOW_S - 1.5
        ]
        if len(window) >= MIN_INTERVALS and at_s - window[-1].at_s < 1.6 + max(1.0, 2 * interval_s):
            is_clear = min(interval.quality for interval in window[-MIN_INTERVALS:]) >= CLEAR_QUALITY
            first = steady_from(np.array([interval.length_s for interval in window]), is_clear=is_clear)
            steady = window[first:]
            feature = self._rate_of(steady, source, at_s, period_s)
            if feature is None:
                return None
            rate = float(feature.value)
            if second is not None and not self._is_confirmed(steady, rate, second):
                feature = replace(feature, quality=min(feature.quality, MAX_UNCONFIRMED))
            # What no heart has is no value; what a rate at the bound seems to have is the bound.
            lowest, highest = PLAUSIBLE_BPM
            bounded = min(max(rate + rise_bpm(window, steady, at_s), lowest), highest)
            is_plausible = lowest * (1 - BOUND_SHARE) <= rate <= highest * (1 + BOUND_SHARE)
            feature = replace(feature, value=bounded if is_plausible else rate)
            feature = feature if is_plausible else replace(feature, quality=0.0, status=Status.IMPLAUSIBLE)
            self._was_valid = feature.status is Status.VALID
            return feature
        if self._was_valid:
            self._was_valid = False
            last = self._intervals[-1].length_s if self._intervals else 1.0
            return Feature(
                FeatureName.HEART_RATE,
                source,
                60 / last,
                at_s,
                0.0,
                Status.IMPLAUSIBLE,
                self.method,
                0.0,
                period_s,
            )
        return None

    def _is_confirmed(self, window: list[Interval], rate: float, second: SecondRate) -> bool:
        """Return whether independent estimates of the same time confirm a rate, to 6 % or one beat.

        Where movements spoil them, so that no two agree, an unchanged rate stays confirmed for `CONFIRMED_S`.
        """
        from_s, to_s = window[0].at_s - window[0].length_s, window[-1].at_s
        others = []
        allowed = max(MAX_APART * rate, 1.2 * 60 / (to_s - from_s))
        for other in second(from_s, to_s, 60 / rate):
            if abs(other - rate) <= allowed:
                self._confirmed = rate, to_s
                return True
            others.append(other)
        if any(higher - lower <= MAX_APART * lower for lower, higher in pairwise(sorted(others))):
            return False
        before, at_s = self._confirmed
        return to_s - at_s <= CONFIRMED_S and abs(rate - before) <= MAX_APART * before

    def _rate_of(self, window: list[Interval], source: str, at_s: float, period_s: float) -> Feature | None:
        """Return the mean rate of a window; None while good beats are too few for a value."""
        lengths = np.array([interval.length_s for interval in window])
        total_s = float(lengths.sum())
        median_s = float(np.median(lengths))
        is_near = np.abs(lengths - median_s) <= MAX_CHANGE * median_s
        regular = float(np.mean(is_near & np.array([interval.is_usual_shape for interval in window])))
        quality = float(np.mean([interval.quality for interval in window])) * (0.4 + 0.6 * regular)
        coverage = min(1.0, total_s / COVERED_S)
        if not self._was_valid and quality * coverage < MIN_QUALITY <= quality:
            return None  # good beats, but too few of them so far: no value yet, not a bad one
        return Feature(
            FeatureName.HEART_RATE,
            source,
            60 * len(lengths) / total_s,
            at_s,
            quality * coverage,
            method=self.method,
            window_s=total_s,
            period_s=period_s,
        )

    def _variability(self, name: FeatureName, source: str, at_s: float, period_s: float) -> Feature | None:
        window_s = RMSSD_WINDOW_S if name is FeatureName.HRV_RMSSD else LONG_WINDOW_S
        window = [interval for interval in self._intervals if interval.at_s > at_s - window_s]
        normal_s = sum(interval.length_s for interval in window if interval.is_normal)
        all_s = sum(interval.length_s for interval in window)
        if normal_s < (45 if name is FeatureName.HRV_RMSSD else 120):
            return None
        value: float | None
        if name is FeatureName.HRV_RMSSD:
            value = rmssd_ms(window)
        elif name is FeatureName.HRV_SDNN:
            value = 1000 * float(
                np.std([interval.length_s for interval in window if interval.is_normal], ddof=1)
            )
        else:
            powers = lf_hf(window)
            value = powers[0] / powers[1] if powers is not None and powers[1] > 0 else None
        if value is None:
            return None
        share = normal_s / all_s
        quality = float(np.mean([interval.quality for interval in window])) * max(0.0, 2.5 * share - 1.5)
        if name is not FeatureName.HRV_RMSSD:
            quality *= min(1.0, normal_s / (0.9 * LONG_WINDOW_S))
        return Feature(name, source, value, at_s, quality, Status.VALID, self.method, all_s, period_s)
