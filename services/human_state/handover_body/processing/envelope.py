"""A second heart rate of an ECG, from its envelope: it has no part in common with the beats of `beats`.

The envelope is the smoothed magnitude of the signal between 10 and 25 Hz, where a QRS complex has its slopes
and a T wave nearly nothing. Its peaks above a share of the usual height are counted. There is no learned
shape, no expected interval and no memory but the samples, so an error of the first rate, which has all three,
does not continue here: a heart of 190 bpm that is taken for one of 95 has twice as many peaks as beats.

The peaks between two beats are counted. Where movements add some, the median interval of peaks without a
movement in between is right, and the first maximum of the autocorrelation of the envelope, which noise does
not move. A heart without a rhythm has no such maximum, and needs none while its peaks are clear. Where every
second beat is lower, that maximum is at two beats; it does not count while peaks stand in its middle.

Memory: `KEPT_S` of the signal at about 125 Hz.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal as dsp
from scipy.fft import next_fast_len

from handover_body.processing.beats import band_pass

Floats = NDArray[np.float64]

KEPT_S: Final = 14.0
WORKING_HZ: Final = 125.0
BAND_HZ: Final = (10.0, 25.0)
FILTER_S: Final = 0.2
SMOOTH_S: Final = 0.08
SHORTEST_S: Final = 0.24
"""Two peaks that are closer are one."""
SHARE: Final = 0.38
"""A peak with less of the usual height is none."""
SEGMENT: Final = 1.5
"""In each so many intervals there is a beat; if the interval is too long, there are more."""
MAX_HEIGHT: Final = 1.8
"""What is higher, in usual heights, is no beat but a movement: it has no part in the autocorrelation."""
MOVEMENT_S: Final = 0.15
MIN_INTERVALS: Final = 3
MIN_PERIODICITY: Final = 0.3
EQUAL: Final = 0.12
"""Intervals that differ by less, as a share, are equal."""
MOST: Final = 0.8


class EnvelopeRate:
    """Counts the peaks of the envelope of one lead, by the time of its newest sample."""

    def __init__(self, rate_hz: float) -> None:
        self._step: Final = max(1, int(rate_hz // WORKING_HZ))
        self._rate_hz: Final = rate_hz / self._step
        self._taps: Final = band_pass(self._rate_hz, *BAND_HZ, FILTER_S)
        self._kept: Final = round(KEPT_S * self._rate_hz)
        self._width: Final = max(1, round(SMOOTH_S * self._rate_hz))
        self.reset()

    def reset(self) -> None:
        """Forget the signal."""
        self._x: Floats = np.empty(0)
        self._rest: Floats = np.empty(0)
        self._end_s = 0.0
        self._envelope: Floats | None = None

    def feed(self, block: Floats, end_s: float) -> None:
        """Take the next samples, the newest of which was taken at `end_s`."""
        x = np.concatenate((self._rest, block))
        whole = len(x) // self._step * self._step
        self._rest = x[whole:]
        means = x[:whole].reshape(-1, self._step).mean(axis=1)
        self._x = np.concatenate((self._x, means))[-self._kept :]
        self._end_s = end_s - (len(self._rest) + (self._step - 1) / 2) / (self._rate_hz * self._step)
        self._envelope = None

    def rates_bpm(self, from_s: float, to_s: float, interval_s: float) -> Iterator[float]:
        """Give the rates from a beat at `from_s` to one at `to_s`: by peaks, their intervals, and periods.

        `interval_s` is the mean interval that is checked. Each is computed when it is asked for.
        """
        if self._envelope is None:
            self._envelope = self._enveloped()
        margin_s = min(0.15, 0.4 * interval_s)
        if to_s <= from_s or self._index(from_s) < -self._width:
            return
        part = self._envelope[max(0, self._index(from_s - margin_s)) : max(0, self._index(to_s + margin_s))]
        segment = max(2, round(SEGMENT * interval_s * self._rate_hz))
        if len(part) < 2 * segment:
            return
        usual = float(
            np.percentile([part[at : at + segment].max() for at in range(0, len(part), segment)], 40)
        )
        peaks, _ = dsp.find_peaks(
            part, distance=max(1, round(SHORTEST_S * self._rate_hz)), height=SHARE * usual
        )
        yield 60 * (len(peaks) - 1) / (to_s - from_s)
        near = round(MOVEMENT_S * self._rate_hz)
        is_moving = np.convolve(part > MAX_HEIGHT * usual, np.ones(2 * near + 1), "same") > 0.5
        # Movements add peaks and hide beats; the intervals between them are as they were.
        moved = np.concatenate(([0], np.cumsum(is_moving)))
        intervals = np.diff(peaks)[moved[peaks[1:] + 1] == moved[peaks[:-1]]]
        if len(intervals) >= MIN_INTERVALS:
            yield 60 * self._rate_hz / float(np.median(intervals))
        period_s = self._period_s(np.minimum(part, usual), ~is_moving)
        if period_s and not _has_two_beats(intervals, period_s * self._rate_hz):
            yield 60 / period_s

    def _enveloped(self) -> Floats:
        half = len(self._taps) // 2
        padded = np.concatenate((np.full(half, self._x[0]), self._x, np.full(half, self._x[-1])))
        size = np.abs(np.convolve(padded, self._taps, "valid"))
        return np.asarray(np.convolve(size, np.full(self._width, 1 / self._width), "same"), np.float64)

    def _index(self, at_s: float) -> int:
        return len(self._x) - 1 - round((self._end_s - at_s) * self._rate_hz)

    def _period_s(self, wave: Floats, is_known: NDArray[np.bool_]) -> float:
        """Return the first large maximum of the autocorrelation of known samples; 0 where none is."""
        finite = is_known.astype(np.float64)
        if finite.mean() < 0.5:
            return 0.0
        wave = (wave - wave[is_known].mean()) * finite
        first, last = int(SHORTEST_S * self._rate_hz), min(len(wave) * 2 // 3, int(2.2 * self._rate_hz))
        products, weights = _autocorrelation(wave)[:last], _autocorrelation(finite)[:last]
        if products[0] <= 0:
            return 0.0
        correlation = products / np.maximum(weights, 1.0) * weights[0] / products[0]
        correlation[weights < len(wave) / 6] = 0.0
        peaks, _ = dsp.find_peaks(correlation[first:])
        if not len(peaks):
            return 0.0
        heights = correlation[peaks + first]
        if heights.max() < MIN_PERIODICITY:
            return 0.0
        return float(peaks[np.flatnonzero(heights >= 0.8 * heights.max())[0]] + first) / self._rate_hz


def _has_two_beats(intervals: NDArray[np.int64], period: float) -> bool:
    """Return whether a period has two peaks in equal intervals: beats of two heights, which alternate."""
    if len(intervals) < MIN_INTERVALS:
        return False
    median = float(np.median(intervals))
    are_equal = np.mean(np.abs(intervals - median) <= EQUAL * median) >= MOST
    return bool(are_equal) and abs(period / median - 2) <= 2 * EQUAL


def _autocorrelation(wave: Floats) -> Floats:
    size = next_fast_len(2 * len(wave), real=True)
    return np.asarray(np.fft.irfft(np.abs(np.fft.rfft(wave, size)) ** 2, size)[: len(wave)], np.float64)
