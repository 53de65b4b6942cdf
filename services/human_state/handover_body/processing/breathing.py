"""Breathing rate: of a breathing wave (belt, radar, PPG) and of the beats of the heart.

The rate is the strongest line of the spectrum between 0.08 and 0.75 Hz of the last 32 s, refined between
bins. Its quality is the share of the band's power in that line and its first harmonic, lowered when the
count of zero crossings disagrees, so a wave without one clear rate has none. Nothing older than the window
is used.

Breathing from an ECG or a PPG alone is off by several breaths a minute on real records (Charlton et al.,
"Breathing rate estimation from the electrocardiogram and photoplethysmogram", IEEE Rev Biomed Eng 11,
2018), so its quality is at most 0.4: it informs and never controls.
"""

from collections import deque
from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal as dsp

from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import Samples, SensorReport, SignalInfo

Floats = NDArray[np.float64]

WINDOW_S: Final = 32.0
SHORTEST_S: Final = 20.0
GRID_HZ: Final = 8.0
BAND_HZ: Final = (0.08, 0.75)
EACH_S: Final = 1.0
IRREGULAR_HZ: Final = 5.0
"""The working rate of waves at irregular times: a radar sends five points a second."""
MAX_STEP_S: Final = 2.0
MAX_QUALITY_OF_BEATS: Final = 0.4


@lru_cache(maxsize=32)
def _breathing_filter(rate_hz: float) -> Floats:
    upper_hz = min(1.0, 0.45 * rate_hz)
    return np.asarray(dsp.butter(2, [0.05, upper_hz], "band", fs=rate_hz, output="sos"), np.float64)


def breathing_of(wave: Floats, rate_hz: float) -> tuple[float, float]:
    """Return the breathing rate per minute and its quality; the rate is 0 where there is none."""
    wave = dsp.detrend(wave)
    spread = float(wave.std())
    if spread <= 1e-12:
        return 0.0, 0.0
    tapered = wave * np.hanning(len(wave))
    size = 8 * (1 << (len(wave) - 1).bit_length())
    power = np.abs(np.fft.rfft(tapered, size)) ** 2
    frequencies = np.fft.rfftfreq(size, 1 / rate_hz)
    band = (frequencies >= BAND_HZ[0]) & (frequencies <= BAND_HZ[1])
    inside = np.flatnonzero(band)
    top = int(inside[np.argmax(power[inside])])
    if top in {inside[0], inside[-1]}:
        return 0.0, 0.0
    # The half of the frequency is the rate where a breath has two humps.
    half = int(np.argmin(np.abs(frequencies - frequencies[top] / 2)))
    if frequencies[half] >= BAND_HZ[0] and power[half] > 0.6 * power[top]:
        top = half
    curve = power[top - 1] - 2 * power[top] + power[top + 1]
    shift = 0.5 * (power[top - 1] - power[top + 1]) / curve if curve < 0 else 0.0
    found_hz = float(frequencies[top] + np.clip(shift, -0.5, 0.5) * frequencies[1])
    width_hz = 2.2 * rate_hz / len(wave)
    near = (np.abs(frequencies - found_hz) < width_hz) | (np.abs(frequencies - 2 * found_hz) < width_hz)
    all_power = float(power[(frequencies >= 0.05) & (frequencies <= 2.0)].sum())
    share = float(power[near].sum()) / max(all_power, 1e-30)
    smooth = dsp.sosfiltfilt(_breathing_filter(rate_hz), wave)
    rises = np.flatnonzero((smooth[:-1] < 0) & (smooth[1:] >= 0))
    counted_hz = (len(rises) - 1) * rate_hz / (rises[-1] - rises[0]) if len(rises) >= 2 else 0.0
    agreement = float(np.clip(1.5 - abs(counted_hz - found_hz) * 60 / 4, 0.2, 1.0))
    return 60 * found_hz, float(np.clip((share - 0.25) / 0.5, 0, 1)) * agreement


class WaveBreathing:
    """The breathing rate of a wave: a belt, the baseline of a PPG, a radar that sends at irregular times."""

    def __init__(self, info: SignalInfo, method: str = "wave-1", max_quality: float = 1.0) -> None:
        if info.rate_hz is not None and info.rate_hz < 2:
            raise ValueError(f"a breathing wave needs 2 Hz at least; {info.kind} has {info.rate_hz:g} Hz")
        self._method: Final = method
        self._max_quality: Final = max_quality
        self._is_irregular: Final = info.rate_hz is None
        rate_hz = info.rate_hz or IRREGULAR_HZ
        self._step: Final = max(1, int(rate_hz // GRID_HZ))
        self._rate_hz: Final = rate_hz / self._step
        self._wave: deque[float] = deque(maxlen=int(WINDOW_S * self._rate_hz))
        self._rest = np.empty(0)
        self._last: tuple[float, float] | None = None
        self._due_s = -np.inf

    def feed(self, samples: Samples) -> Sequence[Feature]:
        """Take samples; return the rate once a second, after 20 s."""
        x = np.concatenate((self._rest, self._regular(samples)))
        whole = len(x) // self._step * self._step
        self._wave.extend(x[:whole].reshape(-1, self._step).mean(axis=1).tolist())
        self._rest = x[whole:]
        at_s = samples.end_s
        if len(self._wave) < SHORTEST_S * self._rate_hz or at_s < self._due_s:
            return []
        self._due_s = at_s + EACH_S - 0.5 / self._rate_hz
        rate, quality = breathing_of(np.array(self._wave), self._rate_hz)
        quality *= samples.quality
        return _feature(samples.source, rate, quality, at_s, self._method, max_quality=self._max_quality)

    def _regular(self, samples: Samples) -> Floats:
        """Return the samples at the working rate; those at irregular times are interpolated."""
        values = samples.values[:, 0]
        if not self._is_irregular:
            return values
        times_s = samples.sample_times_s()
        if self._last is not None and times_s[0] - self._last[0] > MAX_STEP_S:
            self._wave.clear()
            self._last = None
        if self._last is not None:
            times_s, values = np.append(self._last[0], times_s), np.append(self._last[1], values)
        ticks = np.arange(np.floor(times_s[0] * IRREGULAR_HZ) + 1, np.floor(times_s[-1] * IRREGULAR_HZ) + 1)
        self._last = float(times_s[-1]), float(values[-1])
        return np.interp(ticks / IRREGULAR_HZ, times_s, values)

    def report(self, report: SensorReport) -> Sequence[Feature]:
        """Forget the wave before a fault."""
        if report.fault is not None or report.has_contact is False:
            self._wave.clear()
            self._rest = np.empty(0)
            self._last = None
            self._due_s = -np.inf
        return []


class BeatBreathing:
    """The breathing rate of the heights of beats and of the intervals between them, the clearer of both."""

    def __init__(self, method: str) -> None:
        self._method: Final = method
        self._beats: deque[tuple[float, float, float]] = deque(maxlen=160)
        self._due_s = -np.inf

    def reset(self) -> None:
        """Forget all beats."""
        self._beats.clear()
        self._due_s = -np.inf

    def add_beat(self, at_s: float, height: float, quality: float) -> None:
        """Take the next beat."""
        self._beats.append((at_s, height, quality))
        while self._beats[0][0] < at_s - WINDOW_S:
            self._beats.popleft()

    def features(self, source: str, at_s: float) -> list[Feature]:
        """Return the breathing rate every 2 s, after 20 s of beats."""
        if at_s < self._due_s or len(self._beats) < 12 or at_s - self._beats[-1][0] > 5:
            return []
        beats = np.array(self._beats)
        if beats[-1, 0] - beats[0, 0] < SHORTEST_S:
            return []
        self._due_s = at_s + 2.0
        grid_s = np.arange(beats[1, 0], beats[-1, 0], 0.25)
        mean_hz = len(beats) / (beats[-1, 0] - beats[0, 0])
        candidates = []
        for series in (beats[1:, 1], np.diff(beats[:, 0])):
            steady = np.clip(series, *np.percentile(series, [5, 95]))
            rate, quality = breathing_of(np.interp(grid_s, beats[1:, 0], steady), 4.0)
            if rate < 30 * mean_hz:  # beats sample breathing; above half their rate nothing can be said
                candidates.append((quality, rate))
        if not candidates:
            return []
        quality, rate = max(candidates)
        quality *= float(beats[:, 2].mean())
        return _feature(source, rate, quality, at_s, self._method, max_quality=MAX_QUALITY_OF_BEATS)


def _feature(
    source: str, rate: float, quality: float, at_s: float, method: str, *, max_quality: float
) -> list[Feature]:
    if rate <= 0:
        return []
    quality = min(quality, max_quality)
    return [
        Feature(
            FeatureName.BREATHING_RATE, source, rate, at_s, quality, Status.VALID, method, WINDOW_S, EACH_S
        )
    ]
