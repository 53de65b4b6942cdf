"""Pulse rate and oxygen saturation of a PPG, in windows of 10 s.

The pulse is the median interval of the steepest rises. Quality asks three questions: do the pulses look alike
(mean correlation with their mean shape), does the autocorrelation give the same rate, and are the intervals
regular. Motion breaks all three, so a window of quality 0.5 or more is one to believe; the rest is not.

SpO2 is 110 - 25 R (Webster, "Design of pulse oximeters", 1997), R the ratio of the relative pulsations of red
and infrared. Without a calibration of this sensor on people it can be off by many percent: it is marked as
uncalibrated and never feeds a limit.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal as dsp

from handover.messages import number_text
from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import Samples, SensorReport, SignalInfo
from handover_body.processing.breathing import MAX_QUALITY_OF_BEATS, WaveBreathing
from handover_body.processing.rhythm import BOUND_SHARE, PLAUSIBLE_BPM

Floats = NDArray[np.float64]

METHOD: Final = "ppg-2"
WINDOW_S: Final = 10.0
SHORTEST_S: Final = 6.0
EACH_S: Final = 1.0
WORKING_HZ: Final = 50.0
WRAP_SHARE: Final = 0.8
PULSE_BAND_HZ: Final = (0.6, 5.0)
RED_NAMES: Final = frozenset({"red", "r", "660"})
INFRARED_NAMES: Final = frozenset({"ir", "infrared", "940", "880"})


@lru_cache(maxsize=32)
def _band(lower_hz: float, upper_hz: float, rate_hz: float) -> Floats:
    return np.asarray(dsp.butter(2, [lower_hz, upper_hz], "band", fs=rate_hz, output="sos"), np.float64)


def pulse_of(ppg: Floats, rate_hz: float) -> tuple[float, float]:
    """Return the pulse rate in bpm of a window and its quality; (0, 0) where there is none."""
    upper_hz = min(PULSE_BAND_HZ[1], 0.45 * rate_hz)
    band = _band(PULSE_BAND_HZ[0], upper_hz, rate_hz)
    wave = np.asarray(dsp.sosfiltfilt(band, dsp.detrend(ppg)), np.float64)
    spread = float(wave.std())
    if spread <= 1e-12 * (1 + float(np.abs(ppg).max())):
        return 0.0, 0.0
    wave = np.clip(wave / spread, -4, 4)
    slope = np.gradient(wave) * rate_hz
    period_s, periodicity = _period(wave, rate_hz)
    if period_s == 0:
        return 0.0, 0.0
    steep = 0.3 * float(np.quantile(slope, 0.98))
    rises, _ = dsp.find_peaks(slope, distance=max(1, int(0.6 * period_s * rate_hz)), height=steep)
    if len(rises) < 4:
        return 0.0, 0.0
    intervals_s = np.diff(rises) / rate_hz
    interval_s = float(np.mean(intervals_s))
    median_s = float(np.median(intervals_s))
    spread_of_intervals = float(np.median(np.abs(intervals_s - median_s))) / median_s
    worst = float(np.abs(intervals_s / median_s - 1).max())
    apart = min(abs(period_s - interval_s) / interval_s, abs(period_s - median_s) / median_s)
    agreement = float(np.clip(1 - (apart - 0.03) / 0.12, 0, 1))
    regularity = float(np.clip(1.2 - 3 * spread_of_intervals - 0.5 * max(0.0, worst - 0.25), 0, 1))
    shape = float(np.clip((_likeness(wave, rises, period_s, rate_hz) - 0.5) / 0.3, 0, 1))
    strength = float(np.clip((periodicity - 0.15) / 0.35, 0, 1))
    single = _singleness(slope, rises, steep) * _fundamental(wave, interval_s, rate_hz)
    bpm = 60 / interval_s
    lowest, highest = PLAUSIBLE_BPM
    if not lowest * (1 - BOUND_SHARE) <= bpm <= highest * (1 + BOUND_SHARE):
        return bpm, 0.0
    return float(np.clip(bpm, lowest, highest)), single * shape * agreement * regularity * strength


def _singleness(slope: Floats, rises: NDArray[np.int_], steep: float) -> float:
    """Return 1 where each pulse has one rise, and 0 where rises between the pulses may be pulses as well.

    A dicrotic wave rises, too, but less steeply than the pulse before it. Rises between the pulses that are
    as steep mean that half of the rate was found, or a periodic movement.
    """
    every, _ = dsp.find_peaks(slope, height=steep)
    others = np.setdiff1d(every, rises)
    if not len(others):
        return 1.0
    share = len(others) / len(rises)
    ratio = float(np.median(slope[others]) / np.median(slope[rises]))
    doubt = float(np.clip((ratio - 0.55) / 0.25, 0, 1))
    return float(np.clip(1.3 - 1.5 * share * doubt - 0.3 * (1 - doubt) * (share > 2.5), 0, 1))


def _fundamental(wave: Floats, interval_s: float, rate_hz: float) -> float:
    """Return 1 where the rate is the fundamental of the wave, 0 where it may be half of it or twice of it.

    Of a pulse wave the fundamental is strong, and there is nothing at half of it.
    """
    power = np.abs(np.fft.rfft(wave * np.hanning(len(wave)), 8 * len(wave))) ** 2
    step_hz = rate_hz / (8 * len(wave))

    def at(frequency_hz: float) -> float:
        low, high = int(0.9 * frequency_hz / step_hz), int(1.1 * frequency_hz / step_hz) + 2
        return float(power[low:high].max(initial=0.0))

    half, same, two = (at(share / interval_s) for share in (0.5, 1.0, 2.0))
    if same <= 0:
        return 0.0
    return float(np.clip((same / (two + 1e-12) - 0.3) / 0.5, 0, 1) * np.clip((0.9 - half / same) / 0.5, 0, 1))


def _period(wave: Floats, rate_hz: float) -> tuple[float, float]:
    """Return the lag of the first large maximum of the autocorrelation in s, and its height."""
    spectrum = np.fft.rfft(wave, 2 * len(wave))
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)[: len(wave)]
    correlation /= correlation[0] * (1 - np.arange(len(wave)) / len(wave) + 1e-9)
    first, last = int(rate_hz * 60 / 220), min(len(wave) // 2, int(rate_hz * 60 / 30))
    peaks, _ = dsp.find_peaks(correlation[first:last])
    if not len(peaks):
        return 0.0, 0.0
    peaks += first
    heights = correlation[peaks]
    chosen = int(peaks[np.flatnonzero(heights >= 0.85 * heights.max())[0]])
    return chosen / rate_hz, float(correlation[chosen])


def unwrapped(x: Floats) -> Floats:
    """Return a wave (samples, channels) whose converter has run over its range, as it was before.

    No pulse crosses most of its range from one sample to the next; a counter that overflows does, and comes
    back.
    """
    span = np.ptp(x, axis=0)
    jumps = np.diff(x, axis=0)
    is_jump = np.abs(jumps) > WRAP_SHARE * span
    troughs = x
    for channel in np.flatnonzero((is_jump & (jumps > 0)).any(axis=0) & (is_jump & (jumps < 0)).any(axis=0)):
        if troughs is x:
            troughs = x.copy()
        turns = np.where(is_jump[:, channel], -np.sign(jumps[:, channel]), 0.0)
        troughs[1:, channel] += np.cumsum(turns) * span[channel]
    return troughs


def _likeness(wave: Floats, rises: NDArray[np.int_], period_s: float, rate_hz: float) -> float:
    before, after = int(0.3 * period_s * rate_hz), int(0.6 * period_s * rate_hz)
    shapes = np.array(
        [wave[at - before : at + after] for at in rises if at >= before and at + after <= len(wave)]
    )
    if len(shapes) < 3:
        return 0.0
    mean = shapes.mean(axis=0)
    return float(np.mean([np.corrcoef(shape, mean)[0, 1] for shape in shapes]))


def saturation_of(red: Floats, infrared: Floats, rate_hz: float) -> float | None:
    """Return the uncalibrated SpO2 in percent, or None where there is no pulse or no steady light."""
    band = _band(0.6, min(4.0, 0.45 * rate_hz), rate_hz)
    means = float(red.mean()), float(infrared.mean())
    if min(means) <= 0:
        return None
    pulsations = [float(np.std(dsp.sosfiltfilt(band, light - light.mean()))) for light in (red, infrared)]
    if pulsations[1] <= 0:
        return None
    value = 110 - 25 * (pulsations[0] / means[0]) / (pulsations[1] / means[1])
    return min(100.0, value) if value >= 50 else None


class PpgProcessor:
    """A PPG of 20 Hz or more; channels named red and infrared give SpO2.

    The pulse comes from infrared, or the first channel.
    """

    def __init__(self, info: SignalInfo) -> None:
        if info.rate_hz is None or info.rate_hz < 20:
            raise ValueError(
                f"a pulse needs a PPG of 20 Hz at least; this one has {number_text(info.rate_hz)}"
            )
        names = [name.lower() for name in info.channels]
        self._red: Final = next((n for n, name in enumerate(names) if name in RED_NAMES), None)
        infrared = next((n for n, name in enumerate(names) if name in INFRARED_NAMES), None)
        self._infrared: Final = infrared
        self._step: Final = max(1, int(info.rate_hz // WORKING_HZ))
        self._rate_hz: Final = info.rate_hz / self._step
        self._raw = self._window = np.empty((0, len(info.channels)))
        self._info_hz: Final = info.rate_hz
        self._kept: Final = round(WINDOW_S * info.rate_hz)
        self._due_s = -np.inf
        self._info: Final = info
        self._breathing: Final = WaveBreathing(replace(info, channels=("",)), METHOD, MAX_QUALITY_OF_BEATS)

    def feed(self, samples: Samples) -> Sequence[Feature]:
        """Take samples; return features once a second, after 6 s."""
        self._raw = np.concatenate((self._raw, samples.values))[-self._kept :]
        pulse_channel = self._infrared or 0
        baseline = replace(
            samples,
            info=replace(self._info, channels=("",)),
            values=samples.values[:, pulse_channel : pulse_channel + 1],
        )
        features = list(self._breathing.feed(baseline))
        at_s = samples.end_s
        if len(self._raw) < SHORTEST_S * self._info_hz or at_s < self._due_s:
            return features
        self._due_s = at_s + EACH_S - 0.5 / self._rate_hz
        self._window = self._thinned()
        pulse, quality = pulse_of(self._window[:, pulse_channel], self._rate_hz)
        quality *= samples.quality
        if pulse > 0:
            length_s = len(self._window) / self._rate_hz
            features.append(
                Feature(
                    FeatureName.HEART_RATE,
                    samples.source,
                    pulse,
                    at_s,
                    quality,
                    Status.VALID,
                    METHOD,
                    length_s,
                )
            )
            features += self._saturation(samples.source, at_s, quality)
        return features

    def _thinned(self) -> Floats:
        whole = len(self._raw) // self._step * self._step
        raw = unwrapped(self._raw[len(self._raw) - whole :])
        return np.asarray(raw.reshape(-1, self._step, raw.shape[1]).mean(axis=1), np.float64)

    def _saturation(self, source: str, at_s: float, quality: float) -> list[Feature]:
        if self._red is None or self._infrared is None or quality < 0.3:
            return []
        value = saturation_of(self._window[:, self._red], self._window[:, self._infrared], self._rate_hz)
        if value is None:
            return []
        feature = Feature(FeatureName.SPO2, source, value, at_s, quality, method=METHOD, window_s=WINDOW_S)
        return [replace(feature, is_calibrated=False)]

    def report(self, report: SensorReport) -> Sequence[Feature]:
        """Forget the signal before a fault."""
        if report.fault is not None or report.has_contact is False:
            self._raw = self._raw[:0]
            self._due_s = -np.inf
            self._breathing.report(report)
        return []
