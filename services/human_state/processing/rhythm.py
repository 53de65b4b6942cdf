"""Heart rate and its variability from the times of beats, whatever sensor they come from.

Rules of the windows, after Task Force of ESC and NASPE, "Heart rate variability", Circulation 93:1043,
1996, and Shaffer and Ginsberg, "An overview of heart rate variability metrics and norms", Front Public
Health 5:258, 2017:

| value | window | needs | each |
|---|---|---|---|
| heartRate | 10 s | 3 intervals | block |
| hrvRmssd | 60 s | 45 s of normal intervals | 5 s |
| hrvSdnn | 300 s | 120 s of normal intervals; quality falls below 300 s | 10 s |
| hrvLfHf | 300 s | 120 s of normal intervals, LF 0.04 to 0.15 Hz, HF 0.15 to 0.4 Hz | 30 s |

Only normal-to-normal intervals enter the variability: an interval next to a beat of another shape, or more
than 20 % from the median of the last nine, is left out (Malik's rule, with a median instead of the last
interval). Successive differences are taken of neighbours only.
"""

from collections import deque
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from services.human_state.model.features import Feature, FeatureName, Status

Floats = NDArray[np.float64]

HEART_RATE_WINDOW_S: Final = 10.0
RMSSD_WINDOW_S: Final = 60.0
LONG_WINDOW_S: Final = 300.0
MAX_CHANGE: Final = 0.2
PLAUSIBLE_BPM: Final = (30.0, 220.0)
WARM_QUALITY: Final = 0.5
"""A value with less does not count."""


@dataclass(frozen=True, slots=True)
class Interval:
    """The time from one beat to the next, which came at `at_s`."""

    at_s: float
    length_s: float
    quality: float
    is_normal: bool


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

    normal = [each for each in intervals if each.is_normal]
    if len(normal) < 60:
        return None
    at_s = np.array([each.at_s for each in normal])
    grid_s = np.arange(at_s[0], at_s[-1], 0.25)
    series = np.interp(grid_s, at_s, [each.length_s for each in normal])
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

    def reset(self) -> None:
        """Forget all intervals: no value depends on beats before a fault and after it."""
        self._intervals.clear()
        self._recent.clear()
        self._last = None
        self._due_s.clear()
        self._was_valid = False

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
        self._intervals.append(Interval(at_s, length_s, quality, is_near and is_usual_shape))
        while self._intervals and self._intervals[0].at_s < at_s - LONG_WINDOW_S:
            self._intervals.popleft()

    def features(self, source: str, at_s: float, period_s: float) -> list[Feature]:
        """Return the features that are due, of the signal up to `at_s`."""
        rate = self.heart_rate(source, at_s, period_s)
        found = [rate] if rate is not None else []
        if rate is None or rate.status is not Status.VALID:
            return found
        for name, each_s in (
            (FeatureName.HRV_RMSSD, 5.0),
            (FeatureName.HRV_SDNN, 10.0),
            (FeatureName.HRV_LF_HF, 30.0),
        ):
            if at_s >= self._due_s.get(name, at_s):
                feature = self._variability(name, source, at_s, each_s)
                self._due_s[name] = at_s + each_s
                if feature is not None:
                    found.append(feature)
        return found

    def heart_rate(self, source: str, at_s: float, period_s: float) -> Feature | None:
        """Return the mean rate of the last 10 s; once implausible when beats stop, None before the first."""
        # Beats are accepted up to 1.5 s late; two intervals more without one are a fault.
        interval_s = float(np.median(self._recent)) if self._recent else 1.0
        window = [each for each in self._intervals if each.at_s > at_s - HEART_RATE_WINDOW_S - 1.5]
        if len(window) >= 3 and at_s - window[-1].at_s < 1.6 + max(1.0, 2 * interval_s):
            lengths = np.array([each.length_s for each in window])
            total_s = float(lengths.sum())
            bpm = 60 * len(lengths) / total_s
            quality = float(np.mean([each.quality for each in window]))
            coverage = min(1.0, total_s / min(6.0, HEART_RATE_WINDOW_S))
            regular = float(np.mean([each.is_normal for each in window]))
            quality *= 0.4 + 0.6 * regular
            if not self._was_valid and quality * coverage < WARM_QUALITY <= quality:
                return None  # good beats, but too few of them so far: no value yet, not a bad one
            quality *= coverage
            is_plausible = PLAUSIBLE_BPM[0] <= bpm <= PLAUSIBLE_BPM[1]
            self._was_valid = is_plausible
            found = Feature(FeatureName.HEART_RATE, source, bpm, at_s, quality, Status.VALID, self.method)
            found = replace(found, window_s=total_s, period_s=period_s)
            return found if is_plausible else replace(found, quality=0.0, status=Status.IMPLAUSIBLE)
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

    def _variability(self, name: FeatureName, source: str, at_s: float, period_s: float) -> Feature | None:
        window_s = RMSSD_WINDOW_S if name is FeatureName.HRV_RMSSD else LONG_WINDOW_S
        window = [each for each in self._intervals if each.at_s > at_s - window_s]
        normal_s = sum(each.length_s for each in window if each.is_normal)
        all_s = sum(each.length_s for each in window)
        if normal_s < (45 if name is FeatureName.HRV_RMSSD else 120):
            return None
        value: float | None
        if name is FeatureName.HRV_RMSSD:
            value = rmssd_ms(window)
        elif name is FeatureName.HRV_SDNN:
            value = 1000 * float(np.std([each.length_s for each in window if each.is_normal], ddof=1))
        else:
            powers = lf_hf(window)
            value = powers[0] / powers[1] if powers is not None and powers[1] > 0 else None
        if value is None:
            return None
        share = normal_s / all_s
        quality = float(np.mean([each.quality for each in window])) * max(0.0, 2.5 * share - 1.5)
        if name is not FeatureName.HRV_RMSSD:
            quality *= min(1.0, normal_s / (0.9 * LONG_WINDOW_S))
        return Feature(name, source, value, at_s, quality, Status.VALID, self.method, all_s, period_s)
