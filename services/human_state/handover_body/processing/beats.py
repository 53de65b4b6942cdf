"""R peaks of an ECG, streaming: a matched filter finds candidates, the most likely sequence of them is kept.

The newest 10 s are kept. After each block:

1. A linear-phase band-pass (5 to 30 Hz) removes baseline and most of the T wave and of muscle noise.
2. Correlation with the person's own QRS complex (the template, learned from the strongest beats and updated
   by each accepted one) gives `match`, 1 for a typical beat. The noise of `match` between beats is `sigma`.
   Correlation with a wave as wide as a ventricular beat finds beats that the template does not explain.
3. Local maxima are candidates. For a beat of amplitude 1 in Gaussian noise the log-likelihood ratio of "beat"
   against "noise" is (match - 1/2) / sigma². Dynamic programming from the last accepted beat takes the
   sequence with the largest sum of these ratios and of a prior of the intervals: near the median interval of
   the last beats, with a bounded penalty for any other, so that early and missing beats stay possible.
4. Candidates of the best sequence that are older than `DECISION_DELAY_S` are accepted and never revised.
5. The time of an accepted beat is the vertex of the parabola through the maximum of the R wave, of the
   band-passed signal where noise is low, of `match` otherwise.

With low noise step 3 is decided by the shape alone and any rhythm is accepted; in noise the rhythm helps.
Invariants: accepted beats are in order and at least `REFRACTORY_S` apart; memory is bounded by `WINDOW_S`.

Example: at 130 Hz a window has 1,300 samples; a block of 73 costs below 2 ms of CPU time.
"""

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal as dsp

Floats = NDArray[np.float64]

WINDOW_S: Final = 10.0
LEARNING_S: Final = 4.0
"""At least; three beats are needed, so a heart of 30 bpm takes 6 s."""
SHORTEST_S: Final = 2.0
DECISION_DELAY_S: Final = 0.7
MAX_DECISION_DELAY_S: Final = 1.5
REFRACTORY_S: Final = 0.24
TEMPLATE_HALF_S: Final = 0.08
ALIKE: Final = 0.85
"""The correlation of two beats with the same shape."""
MIN_ALIKE: Final = 4
"""Three may be the T waves of a slow heart, one of whose beats lies at the edge."""
BEAT_MATCH: Final = 0.7
BEAT_LIKENESS: Final = 0.85
"""From both on a maximum of `match` is a beat, as far as the noise is concerned."""
CLEAN_SIGMA: Final = 0.17
MAX_PENALTY: Final = 5.0
"""The cost of an interval that does not fit the rhythm, as a log-likelihood: about 1 of 150."""
MAX_GAIN: Final = 12.0
CLEAR_GAIN: Final = 3.0
"""A candidate that is a beat without the help of any rhythm: about 20 to 1."""
MIN_CLEAR: Final = 3
MAX_SAME_TEMPO: Final = 0.15
WIDE_BEAT_S: Final = 0.034
"""Standard deviation of a Gaussian as wide as a ventricular QRS complex, 0.14 s from foot to foot."""
WIDE_PENALTY: Final = 1.0
MAX_PRODUCTS: Final = 1_500_000
"""From more products of samples and taps on, a convolution by transforms is faster."""


@dataclass(frozen=True, slots=True)
class Beat:
    """An R peak: its position in samples since the start, with a fraction; quality 0 to 1."""

    position: float
    quality: float
    is_usual_shape: bool
    height: float = 1.0
    """Its amplitude after the matched filter, 1 for a typical beat. It follows breathing."""


def band_pass(rate_hz: float, lower_hz: float, upper_hz: float, length_s: float) -> Floats:
    """Return the coefficients of a linear-phase band-pass of odd length."""
    length = round(length_s * rate_hz) | 1
    return np.asarray(
        dsp.firwin(length, [lower_hz, min(upper_hz, 0.45 * rate_hz)], fs=rate_hz, pass_zero=False), np.float64
    )


def vertex(y: Floats, index: int) -> float:
    """Return the position of the maximum near `index`, by a parabola through three samples."""
    if not 0 < index < len(y) - 1:
        return float(index)
    before, here, after = y[index - 1], y[index], y[index + 1]
    curvature = before - 2 * here + after
    if curvature >= 0:
        return float(index)
    return float(index + np.clip(0.5 * (before - after) / curvature, -0.5, 0.5))


class BeatDetector:
    """Finds R peaks in blocks of an ECG of one lead, in any unit and polarity. 50 to 2,000 Hz."""

    def __init__(self, rate_hz: float) -> None:
        if not 50 <= rate_hz <= 2000:
            raise ValueError(f"R peaks need an ECG of 50 to 2,000 Hz; this one has {rate_hz:g} Hz")
        self.rate_hz: Final = rate_hz
        self._qrs_filter: Final = band_pass(rate_hz, 5, 30, 0.3)
        self._wide_filter: Final = band_pass(rate_hz, 2, 20, 0.5)
        offsets_s = np.arange(-round(0.2 * rate_hz), round(0.2 * rate_hz) + 1) / rate_hz
        self._wide_shape: Final = self._unit_response(np.exp(-0.5 * (offsets_s / WIDE_BEAT_S) ** 2))
        self._half: Final = round(TEMPLATE_HALF_S * rate_hz)
        self._window: Final = round(WINDOW_S * rate_hz)
        self._margin: Final = len(self._qrs_filter) // 2 + self._half + 1
        self.reset()

    def reset(self, *, keep_shape: bool = False) -> None:
        """Forget the signal: the next block has no relation to earlier ones. Positions start at 0 again.

        With `keep_shape` the learned QRS complex stays, so that beats are found 2 s after a gap, not 6 s.
        """
        self._x = np.empty(0)
        self._first = 0
        self._last: float | None = None
        if keep_shape:
            return
        self._template: Floats | None = None
        self._amplitude = 1.0
        self._r_height = 1.0
        self._intervals: deque[float] = deque(maxlen=9)
        self._amplitudes: deque[float] = deque(maxlen=15)
        self.sigma = 1.0
        """Noise of the matched filter, in amplitudes of a beat. Below 0.1 is clean, above 0.4 is doubtful."""

    def feed(self, block: Floats) -> list[Beat]:
        """Take the next samples, finite ones; return the beats that are certain now, oldest first."""
        x = np.concatenate((self._x, block))
        cut = max(0, len(x) - self._window)
        self._x, self._first = x[cut:], self._first + cut
        if len(self._x) < (LEARNING_S if self._template is None else SHORTEST_S) * self.rate_hz:
            return []
        y = self._filtered(self._qrs_filter)
        if self._template is None:
            self._learn(y)
        if self._template is None:
            return []
        return self._decide(y)

    def _unit_response(self, shape: Floats) -> Floats:
        """Return `shape` filtered, scaled so that its correlation with the filtered shape is 1."""
        half = len(self._wide_filter) // 2
        full = np.convolve(np.pad(shape, half), self._wide_filter, "same")[half:-half]
        return np.asarray(full / np.sum(full**2), np.float64)

    def flush(self) -> list[Beat]:
        """Return the beats that wait for a decision, at the end of a recording; the detector is reset."""
        beats: list[Beat] = []
        if self._template is not None:
            beats = self._decide(self._filtered(self._qrs_filter), is_end=True)
        self.reset()
        return beats

    def _filtered(self, taps: Floats) -> Floats:
        half = len(taps) // 2
        padded = np.concatenate((np.full(half, self._x[0]), self._x, np.full(half, self._x[-1])))
        # The transforms of `oaconvolve` cost more than the products of so short a signal.
        if len(padded) * len(taps) <= MAX_PRODUCTS:
            return np.asarray(np.convolve(padded, taps, mode="valid"), np.float64)
        return np.asarray(dsp.oaconvolve(padded, taps, mode="valid"), np.float64)

    # --- the template

    def _learn(self, y: Floats) -> None:
        """Learn the QRS complex from the strongest beats of the window."""
        energy = self._energy(y)
        inside = slice(self._margin, len(y) - self._margin)
        distance = max(1, int(REFRACTORY_S * self.rate_hz))
        peaks, _ = dsp.find_peaks(energy[inside], distance=distance)
        peaks = peaks + self._margin
        if len(peaks) < 3:
            return
        peaks = peaks[self._alike(y, peaks, energy[peaks])]
        if len(peaks) < 3:
            return
        snippets = np.array([y[p - self._half : p + self._half + 1] for p in peaks])
        # Align on the strongest deflection of the median polarity, then twice on the mean shape.
        sign = 1.0 if np.median(snippets.max(1) + snippets.min(1)) >= 0 else -1.0
        centres = np.array(
            [p - self._half + int(np.argmax(sign * s)) for p, s in zip(peaks, snippets, strict=True)]
        )
        template = self._mean_shape(y, centres)
        for _ in range(3):
            match = np.correlate(y, template, "same")
            centres = np.array(
                [
                    c - self._half + int(np.argmax(match[max(0, c - self._half) : c + self._half + 1]))
                    for c in centres
                ]
            )
            template = self._mean_shape(y, centres)
        norm = float(np.sqrt(np.sum(template**2)))
        if norm <= 0:
            return
        self._template = template / norm
        match = np.correlate(y, self._template, "same")
        usable = centres[(centres > self._half) & (centres < len(y) - self._half)]
        self._amplitude = float(np.median(match[usable]))
        self._amplitudes.extend(match[usable].tolist())
        intervals = np.diff(np.sort(usable)) / self.rate_hz
        self._intervals.extend(intervals[(intervals > 0.25) & (intervals < 2.5)].tolist())

    def _alike(self, y: Floats, peaks: NDArray[np.int_], strength: Floats) -> NDArray[np.bool_]:
        """Return which peaks of the energy are beats: the largest group of the same shape and strength.

        Movements are stronger than beats, but no two of them are alike; T waves are alike, but weaker. In
        noise no peaks are alike, and the strongest ones are taken.
        """
        # A slow heart has no more beats than these, and many other peaks.
        level = np.sort(strength)[::-1][: max(3, int(0.5 * len(y) / self.rate_hz))]
        strongest = strength >= max(0.6 * float(np.median(level)), 0.35 * float(level[0]))
        wide = 2 * self._half
        inside = np.flatnonzero((peaks >= wide) & (peaks < len(y) - wide))
        centres = [
            p - self._half + int(np.argmax(np.abs(y[p - self._half : p + self._half + 1])))
            for p in peaks[inside]
        ]
        if len(centres) < 3:
            return np.asarray(strongest, bool)
        shapes = np.array([y[c - self._half : c + self._half + 1] for c in centres])
        shapes /= np.sqrt(np.sum(shapes**2, axis=1, keepdims=True)) + 1e-12
        ratio = strength[inside][:, None] / strength[inside][None, :]
        same = (shapes @ shapes.T > ALIKE) & (ratio > 0.6) & (ratio < 1 / 0.6)
        sizes = same.sum(axis=1)
        # As many stronger peaks are the beats, and these are their T waves.
        is_group = (sizes >= MIN_ALIKE) & ((ratio < 0.6).sum(axis=1) < sizes / 2)
        best = int(np.argmax(is_group * sizes * strength[inside]))
        if not is_group[best]:
            return np.asarray(strongest, bool)
        kept = np.zeros(len(peaks), bool)
        kept[inside[same[best]]] = True
        return kept

    def _mean_shape(self, y: Floats, centres: NDArray[np.int_]) -> Floats:
        inside = centres[(centres >= self._half) & (centres < len(y) - self._half)]
        shapes = np.array([y[c - self._half : c + self._half + 1] for c in inside])
        return (
            np.asarray(np.median(shapes, axis=0), np.float64) if len(shapes) else np.zeros(2 * self._half + 1)
        )

    def _energy(self, y: Floats) -> Floats:
        width = round(0.12 * self.rate_hz) | 1
        return np.sqrt(np.maximum(np.convolve(y * y, np.full(width, 1 / width), "same"), 0))

    # --- the decision

    def _decide(self, y: Floats, *, is_end: bool = False) -> list[Beat]:
        assert self._template is not None  # noqa: S101 -- the caller learns it
        rate = self.rate_hz
        match = np.correlate(y, self._template, "same") / self._amplitude
        # The height of a typical R wave. The band-pass takes about a third of it.
        self._r_height = 1.4 * self._amplitude * float(np.abs(self._template).max())
        last = None if self._last is None else self._last - self._first
        begin = 0 if last is None else max(0, int(last + REFRACTORY_S * rate))
        end = len(y) - (1 if is_end else self._margin)
        if end - begin < 0.2 * rate:
            return []
        maxima = 1 + np.flatnonzero((match[1:-1] > match[:-2]) & (match[1:-1] >= match[2:]))
        self.sigma = self._noise_of(match[:end], maxima[(maxima < end) & (match[maxima] > BEAT_MATCH)], y)
        usual = maxima[(maxima >= begin) & (maxima < end) & (match[maxima] > 0.25)]
        scores = self._ratio(match[usual])
        unusual, their_scores = self._wide_beats(match, begin, end)
        at = np.concatenate((usual, unusual))
        order = np.argsort(at, kind="stable")
        at = at[order]
        gains = np.concatenate((scores, their_scores))[order]
        is_usual = np.concatenate((np.ones(len(usual), bool), np.zeros(len(unusual), bool)))[order]
        path = self._best_sequence(at / rate, gains, None if last is None else last / rate, end / rate)
        delay_s = DECISION_DELAY_S if self.sigma < 0.12 else MAX_DECISION_DELAY_S
        decided = len(y) if is_end else len(y) - max(delay_s * rate, self._margin)
        beats: list[Beat] = []
        for index in path:
            if at[index] >= decided:
                break
            beats.append(self._accept(int(at[index]), bool(is_usual[index]), match, y))
        return beats

    def _noise_of(self, match: Floats, peaks: NDArray[np.int_], y: Floats) -> float:
        """Return the standard deviation of `match` outside beats, of which `peaks` are candidates.

        The flanks of a beat are no noise: at 190 bpm they are half of all samples. Those of an artefact are,
        so only a candidate with the shape of a beat counts as one.
        """
        is_outside = np.abs(match) < 0.9
        for at in peaks:
            part = slice(max(0, at - self._half), at + self._half + 1)
            if match[at] * self._amplitude >= BEAT_LIKENESS * float(np.sqrt(np.sum(y[part] ** 2))):
                is_outside[part] = False
        outside = np.abs(match)[is_outside]
        if len(outside) < 10:
            return 1.0
        return float(max(0.03, np.sqrt(np.mean(np.minimum(outside, 0.5) ** 2))))

    def _ratio(self, match: Floats) -> Floats:
        variance = self.sigma**2 + 0.15**2  # beats differ in amplitude
        return np.clip((np.minimum(match, 1.2) - 0.5) / variance, -MAX_GAIN, MAX_GAIN)

    def _wide_beats(self, match: Floats, begin: int, end: int) -> tuple[NDArray[np.int_], Floats]:
        """Return candidates as wide as a ventricular beat, unlike the template, and their gains."""
        wide = self._filtered(self._wide_filter)
        height = np.correlate(wide, self._wide_shape, "same") / self._r_height
        size = np.abs(height)
        noise = float(np.sqrt(np.mean(np.minimum(size, 0.5) ** 2)))
        peaks = 1 + np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:]))
        peaks = peaks[(peaks >= begin) & (peaks < end) & (size[peaks] > 0.4)]
        near = round(0.1 * self.rate_hz)
        kept = [p for p in peaks if match[max(0, p - near) : p + near + 1].max() < 0.75]
        chosen = np.array(kept, int)
        gains = (np.minimum(size[chosen], 1.2) - 0.5) / (noise**2 + 0.2**2) - WIDE_PENALTY
        return chosen, np.clip(gains, -MAX_GAIN, MAX_GAIN)

    def _best_sequence(self, at_s: Floats, gains: Floats, last_s: float | None, end_s: float) -> list[int]:
        """Return the indices of the most likely sequence of candidates, oldest first."""
        if not len(at_s):
            return []
        usual_s = float(np.median(self._intervals)) if self._intervals else 0.8
        total, path = self._sequence_at(usual_s, at_s, gains, last_s, end_s)
        # The rate may have changed: what the clear candidates say by themselves may explain more of them.
        clear_s = at_s[gains >= CLEAR_GAIN]
        if len(clear_s) >= MIN_CLEAR:
            other_s = float(np.median(np.diff(clear_s)))
            if other_s >= REFRACTORY_S and abs(other_s / usual_s - 1) > MAX_SAME_TEMPO:
                other_total, other = self._sequence_at(other_s, at_s, gains, last_s, end_s)
                if other_total > total + MAX_PENALTY:
                    return other
        return path

    def _sequence_at(
        self, median_s: float, at_s: Floats, gains: Floats, last_s: float | None, end_s: float
    ) -> tuple[float, list[int]]:
        """Return the most likely sequence where `median_s` is the usual interval, and its log-likelihood."""
        count = len(at_s)
        spread_s = 0.08 * median_s + 0.02
        value = np.empty(count)
        before = np.full(count, -1)

        def prior(interval_s: Floats) -> Floats:
            return -np.minimum(0.5 * ((interval_s - median_s) / spread_s) ** 2, MAX_PENALTY)

        for j in range(count):
            start = float(prior(np.array([at_s[j] - last_s]))[0]) if last_s is not None else 0.0
            best, choice = start, -1
            previous = np.flatnonzero(at_s[:j] <= at_s[j] - REFRACTORY_S)
            if len(previous):
                sums = value[previous] + prior(at_s[j] - at_s[previous])
                top = int(np.argmax(sums))
                if sums[top] > best:
                    best, choice = float(sums[top]), int(previous[top])
            value[j], before[j] = best + gains[j], choice
        # A sequence that stops long before the end misses a beat there: the cost of an odd interval.
        total = value - np.where(end_s - at_s > median_s + 3 * spread_s, MAX_PENALTY, 0)
        index = int(np.argmax(total))
        if total[index] <= 0:
            return 0.0, []
        likelihood, path = float(total[index]), []
        while index >= 0:
            path.append(index)
            index = int(before[index])
        return likelihood, path[::-1]

    def _accept(self, at: int, is_usual: bool, match: Floats, y: Floats) -> Beat:
        assert self._template is not None  # noqa: S101
        rate = self.rate_hz
        snippet = y[max(0, at - self._half) : at + self._half + 1]
        norm = float(np.sqrt(np.sum(snippet**2)))
        likeness = float(match[at] * self._amplitude / norm) if norm > 0 else 0.0
        if not is_usual:
            peak = self._wide_peak(at)
        elif self.sigma < CLEAN_SIGMA:
            low = max(0, at - round(0.04 * rate))
            part = self._sign() * y[low : at + round(0.04 * rate) + 1]
            peak = low + vertex(part, int(np.argmax(part)))
        else:
            peak = vertex(match, at)
        position = self._first + peak
        if self._last is not None:
            interval_s = (position - self._last) / rate
            if 0.25 < interval_s < 2.5:
                self._intervals.append(interval_s)
        self._last = position
        if is_usual and likeness > 0.8 and len(snippet) == len(self._template):
            self._amplitudes.append(float(match[at] * self._amplitude))
            updated = 0.95 * self._template + 0.05 * snippet / norm
            self._template = updated / np.sqrt(np.sum(updated**2))
            self._amplitude = float(np.median(self._amplitudes))
        clarity = float(np.clip((0.36 - self.sigma) / 0.13, 0, 1))  # noise without beats gives 0.3 and more
        shape = float(np.clip((likeness - 0.3) / 0.5, 0, 1)) if is_usual else 0.5
        return Beat(position, clarity * (0.3 + 0.7 * shape), is_usual, float(match[at]))

    def _wide_peak(self, at: int) -> float:
        """Return where the signal is farthest from its local median: the band-pass shifts wide waves."""
        around = round(0.5 * self.rate_hz)
        reach = round(0.12 * self.rate_hz)
        width = round(0.04 * self.rate_hz) | 1
        low = max(0, at - reach)
        baseline = np.median(self._x[max(0, at - around) : at + around + 1])
        part = self._x[max(0, low - width) : at + reach + width + 1] - baseline
        smooth = np.abs(np.convolve(part, np.full(width, 1 / width), "same"))[low - max(0, low - width) :]
        smooth = smooth[: 2 * reach + 1]
        return low + vertex(smooth, int(np.argmax(smooth)))

    def _sign(self) -> float:
        assert self._template is not None  # noqa: S101
        return 1.0 if self._template.max() >= -self._template.min() else -1.0
