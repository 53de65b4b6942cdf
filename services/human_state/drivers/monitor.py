"""Checks of one signal of one sensor, between the driver and everything else. Pure: time is an argument.

Invariants, whatever a device sends:

- times that leave are finite, increase strictly (in recordings: between two clock jumps), and those of live
  sensors lie at most `MAX_AHEAD_S` after the arrival;
- samples before and after a gap or a jump are never joined without a report in between;
- samples with quality above 0 are finite or NaN, within the range of the sensor, at the stated rate, with
  contact as far as the device knows, and not flat;
- memory does not grow with the length of the signal.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from services.human_state.drivers.timing import ClockMap
from services.human_state.model.signals import (
    ClockKind,
    Samples,
    SensorFault,
    SensorReport,
    SignalInfo,
    SignalKind,
)

WAVEFORMS: Final = frozenset(
    {SignalKind.ECG, SignalKind.PPG, SignalKind.EMG, SignalKind.EEG, SignalKind.EOG, SignalKind.ICG,
     SignalKind.BCG}
)  # fmt: skip
"""Signals that are never constant on a body."""
_NEVER_ZERO: Final = frozenset(
    {SignalKind.HEART_RATE, SignalKind.INTER_BEAT_INTERVAL, SignalKind.BREATHING_RATE, SignalKind.SPO2}
)
"""Values that devices send as 0 before they have measured anything."""

MAX_AHEAD_S: Final = 0.5
MAX_AGE_S: Final = 3600.0
"""Samples stamped at their arrival are not older."""
MAX_TIME_S: Final = 1e11
"""Clocks of devices count less; a float resolves 15 microseconds there."""
FAST_SILENCE_S: Final = 0.9
"""Waveforms come in packets; silence of them is found within 1 s."""
MAX_FLAT_S: Final = 0.4
SATURATED_RUN: Final = 3
"""Samples at a bound in a row; single ones are peaks."""
MAX_RATE_ERROR: Final = 0.02
MAX_SLEW: Final = 0.01
"""Times of consecutive packets move by at most this share of their span towards the mapped clock."""
MAX_RESIDUAL_S: Final = 0.5
"""Further off than this, they follow it at once and a clock jump is reported."""
_REPEAT_S: Final = 1.0
"""A lasting fault is reported this often."""
_RATE_SPAN_S: Final = 1.0
_MAX_RATE_SPAN_S: Final = 10.0
_BLOCK_S: Final = 2.0
_UNIT_FACTOR: Final = 100.0

ECG_SPREAD_UV: Final = (5.0, 50_000.0)
"""Peak to peak of an ECG at the skin in microvolt, with room for artefacts; volts lie outside."""
GRAVITY_MPS2: Final = (3.0, 30.0)
"""The median length of an acceleration with gravity, over 2 s; g and milli-g lie outside."""
_MICROVOLTS: Final = {"D82": 1.0, "2Z": 1e3, "VLT": 1e6}


@dataclass(frozen=True, slots=True)
class Checked:
    """What leaves the monitor: the samples with times of our clock, None if none can be used, and news."""

    samples: Samples | None
    reports: tuple[SensorReport, ...] = ()


def default_silence_s(info: SignalInfo) -> float | None:
    """Return how long a signal may be silent: 0.9 s from 10 Hz, else under two periods, None if irregular."""
    if info.rate_hz is None:
        return None
    return FAST_SILENCE_S if info.rate_hz >= 10 else max(FAST_SILENCE_S, 1.8 / info.rate_hz)


class SignalMonitor:
    """The checks of one signal."""

    def __init__(
        self, source: str, info: SignalInfo, max_latency_s: float = 0.1, silence_s: float | None = None
    ) -> None:
        self.info = info
        self._source = source
        self._clock = ClockMap(max_latency_s)
        self._max_latency_s = max_latency_s
        self._silence_s = default_silence_s(info) if silence_s is None else silence_s
        self._arrival_s: float | None = None
        self._is_silent = False
        self._lasting: dict[SensorFault, float] = {}
        self._runs = _Runs(info)
        self._units = _Units(info)
        self._continuity = _Continuity(info)
        self._had_contact: bool | None = None
        self._last_out_s = -math.inf

    def restart(self) -> None:
        """Forget the times: the device was connected again. What was sent stays in the order of time."""
        self._clock.reset()
        self._continuity = _Continuity(self.info)
        self._runs = _Runs(self.info)
        self._arrival_s = None
        self._is_silent = False

    def silence(self, at_s: float) -> SensorReport | None:
        """Return a report once when nothing has arrived for too long."""
        if self._arrival_s is None or self._silence_s is None or self._is_silent:
            return None
        silent_s = at_s - self._arrival_s
        if silent_s < self._silence_s:
            return None
        self._is_silent = True
        text = f"no {self.info.kind} for {silent_s:.1f} s"
        return self._report(SensorFault.GAP, at_s, text, {"silence_s": silent_s})

    def take(self, samples: Samples, arrival_s: float) -> Checked:
        """Check the samples of one packet that arrived at `arrival_s`, in s since 1970."""
        if len(samples.values) == 0:
            return Checked(None)
        self._arrival_s = arrival_s
        self._is_silent = False
        reports: list[SensorReport] = []
        timed = self._timed(samples, arrival_s, reports)
        if timed is None:
            return Checked(None, tuple(reports))
        if not (0.0 <= samples.quality <= 1.0):
            timed = replace(timed, quality=0.0)
        return Checked(self._judged(timed, arrival_s, reports), tuple(reports))

    # Times

    def _timed(self, samples: Samples, arrival_s: float, reports: list[SensorReport]) -> Samples | None:
        times_s = samples.sample_times_s()
        ours_s = arrival_s if samples.clock is ClockKind.ARRIVAL else 0.0
        far_s = MAX_AGE_S if samples.clock is ClockKind.ARRIVAL else MAX_TIME_S
        if not (abs(samples.start_s - ours_s) <= far_s and np.all(np.abs(times_s - ours_s) <= far_s)):
            text = f"{self.info.kind}: an impossible time; the packet was dropped"
            reports.append(self._report(SensorFault.ARTEFACT, arrival_s, text))
            return None
        if self.info.rate_hz is None:
            return self._timed_irregular(samples, times_s, arrival_s, reports)
        return self._timed_regular(samples, arrival_s, reports)

    def _timed_irregular(
        self, samples: Samples, times_s: NDArray[np.float64], arrival_s: float, reports: list[SensorReport]
    ) -> Samples | None:
        is_device = samples.clock is ClockKind.DEVICE
        uncertainty_s = samples.uncertainty_s
        if is_device:
            before = self._clock.offset_s
            newest_s = float(times_s.max())
            difference_s = arrival_s - newest_s
            if before is not None and abs(difference_s - before) > 5.0 + self._max_latency_s:
                self._jumped(difference_s - before, arrival_s, reports)
            times_s = times_s + self._clock.observe(newest_s, arrival_s)
            uncertainty_s += self._clock.uncertainty_s
        elif samples.clock is ClockKind.RECORDING and float(times_s.max()) < self._last_out_s - 1.0:
            self._jumped(float(times_s.max()) - self._last_out_s, arrival_s, reports)
            self._last_out_s = -math.inf
        keep = np.concatenate(([True], np.diff(np.maximum.accumulate(times_s)) > 0)) & (
            times_s > self._last_out_s
        )
        if samples.clock is not ClockKind.RECORDING:
            keep &= times_s <= arrival_s + MAX_AHEAD_S
        if not keep.any():
            return None
        times_s = times_s[keep]
        self._last_out_s = float(times_s[-1])
        return replace(
            samples,
            start_s=float(times_s[0]),
            times_s=times_s,
            values=samples.values[keep],
            uncertainty_s=uncertainty_s,
        )

    def _timed_regular(
        self, samples: Samples, arrival_s: float, reports: list[SensorReport]
    ) -> Samples | None:
        rate_hz = self.info.rate_hz or 1.0
        count = len(samples.values)
        found = self._continuity.take(samples.start_s, count, arrival_s, samples.clock)
        if found.is_repeated:
            return None
        if found.gap_s:
            text = f"{self.info.kind}: {found.gap_s:.2f} s are missing"
            reports.append(self._report(SensorFault.GAP, arrival_s, text, {"gap_s": found.gap_s}))
        if found.jump_s:
            self._jumped(found.jump_s, arrival_s, reports)
            if samples.clock is ClockKind.RECORDING:
                self._last_out_s = -math.inf
        if found.rate_hz is not None:
            text = f"{self.info.kind}: {found.rate_hz:.4g} samples per second arrive, {rate_hz:g} are stated"
            details = {"measured_hz": found.rate_hz, "stated_hz": rate_hz}
            self._lasts(SensorFault.RATE, arrival_s, text, reports, details)
            samples = replace(samples, quality=0.0)
        target_s, uncertainty_s = self._mapped(samples, count / rate_hz, arrival_s)
        if found.is_continued and math.isfinite(self._last_out_s):
            residual_s = target_s - (self._last_out_s + 1 / rate_hz)
            if abs(residual_s) > MAX_RESIDUAL_S:
                self._jumped(residual_s, arrival_s, reports, reset=False)
            elif samples.clock is not ClockKind.RECORDING:
                slew_s = min(MAX_SLEW * count, 0.4) / rate_hz
                rest_s = residual_s - max(-slew_s, min(slew_s, residual_s))
                target_s -= rest_s
                uncertainty_s += abs(rest_s)
        latest_s = math.inf if samples.clock is ClockKind.RECORDING else arrival_s + MAX_AHEAD_S
        return self._cut(replace(samples, start_s=target_s, uncertainty_s=uncertainty_s), latest_s)

    def _mapped(self, samples: Samples, span_s: float, arrival_s: float) -> tuple[float, float]:
        """Return the time of the first sample on our clock, and its uncertainty."""
        start_s, period_s = samples.start_s, 1 / (self.info.rate_hz or 1.0)
        if samples.clock is ClockKind.DEVICE:
            offset_s = self._clock.observe(start_s + span_s - period_s, arrival_s)
            return start_s + offset_s, samples.uncertainty_s + self._clock.uncertainty_s
        if samples.clock is ClockKind.ARRIVAL:
            latest_s = arrival_s - span_s + period_s
            return min(start_s, latest_s), samples.uncertainty_s + self._max_latency_s
        return start_s, samples.uncertainty_s

    def _cut(self, samples: Samples, latest_s: float) -> Samples | None:
        """Drop what is not after the samples sent before, and what is after `latest_s`."""
        rate_hz = self.info.rate_hz or 1.0
        early_s = self._last_out_s + 0.5 / rate_hz - samples.start_s
        first = math.ceil(early_s * rate_hz) if early_s > 0 else 0
        count = len(samples.values)
        late_s = samples.start_s + (count - 1) / rate_hz - latest_s
        end = count - (math.ceil(late_s * rate_hz) if late_s > 0 else 0)
        if first >= end:
            return None
        start_s = samples.start_s + first / rate_hz
        self._last_out_s = start_s + (end - first - 1) / rate_hz
        return replace(samples, values=samples.values[first:end], start_s=start_s, times_s=None)

    def _jumped(
        self, jump_s: float, arrival_s: float, reports: list[SensorReport], *, reset: bool = True
    ) -> None:
        if reset:
            self._clock.reset()
        text = f"{self.info.kind}: the times jumped by {jump_s:+.2f} s"
        reports.append(self._report(SensorFault.CLOCK_JUMP, arrival_s, text, {"jump_s": jump_s}))

    # Values

    def _judged(self, samples: Samples, arrival_s: float, reports: list[SensorReport]) -> Samples:
        kind, values = self.info.kind, samples.values
        quality = samples.quality
        if np.isinf(values).any():
            values = np.where(np.isinf(values), np.nan, values)
            self._lasts(SensorFault.ARTEFACT, arrival_s, f"{kind}: an infinite value", reports)
        if kind in _NEVER_ZERO:
            values = np.where(values <= 0.0, np.nan, values)
        if samples.has_contact is False:
            quality = 0.0
            if self._had_contact is not False:
                self._lasting.pop(SensorFault.NO_CONTACT, None)
            self._lasts(SensorFault.NO_CONTACT, arrival_s, "the sensor does not touch the body", reports)
        self._had_contact = samples.has_contact
        saturated, flat = self._runs.take(values)
        if saturated:
            quality = 0.0
            text = f"{kind}: values at the bound of the sensor"
            self._lasts(SensorFault.SATURATED, arrival_s, text, reports)
            if self.info.rate_hz is None or self.info.rate_hz < 10:
                outside = (values > self.info.max_value) | (values < self.info.min_value)
                values = np.where(outside, np.nan, values)
        if flat:
            quality = 0.0
            self._lasts(SensorFault.FLAT, arrival_s, f"{kind}: the signal is constant", reports)
        unit_fault = self._units.take(values, is_usable=quality > 0)
        if unit_fault:
            quality = 0.0
            self._lasts(SensorFault.UNIT, arrival_s, f"{kind}: {unit_fault}", reports)
        if values is samples.values and quality == samples.quality:
            return samples
        return replace(samples, values=values, quality=quality)

    def _lasts(
        self,
        fault: SensorFault,
        at_s: float,
        text: str,
        reports: list[SensorReport],
        details: dict[str, float] | None = None,
    ) -> None:
        """Report a lasting fault, at most once a second."""
        before_s = self._lasting.get(fault)
        if before_s is not None and 0 <= at_s - before_s < _REPEAT_S:
            return
        self._lasting[fault] = at_s
        reports.append(self._report(fault, at_s, text, details))

    def _report(
        self, fault: SensorFault, at_s: float, text: str, details: dict[str, float] | None = None
    ) -> SensorReport:
        has_contact = False if fault is SensorFault.NO_CONTACT else None
        return SensorReport(
            self._source,
            at_s,
            fault=fault,
            text=text,
            details=details or {},
            has_contact=has_contact,
            kind=self.info.kind,
        )


@dataclass(frozen=True, slots=True)
class _Found:
    gap_s: float = 0.0
    jump_s: float = 0.0
    rate_hz: float | None = None
    """The measured rate, if it is not the stated one."""
    is_continued: bool = False
    is_repeated: bool = False


class _Continuity:
    """Where a packet of a regular signal continues the one before: gaps, jumps, and a rate that lies.

    The device says when its samples were taken (or the arrival does). If a packet starts later than the one
    before ended, either samples are missing, and then as much of our time has passed, or the clock jumped.
    """

    def __init__(self, info: SignalInfo) -> None:
        self._rate_hz = info.rate_hz or 1.0
        self._last: tuple[float, int, float] | None = None  # start, count, arrival
        self._ratio: float | None = None
        self._counted = 0
        self._counted_from_s = 0.0
        self._measured_hz: float | None = None

    def take(self, start_s: float, count: int, arrival_s: float, clock: ClockKind) -> _Found:
        """Take the stamp of the next packet, its number of samples and its arrival."""
        last, self._last = self._last, (start_s, count, arrival_s)
        if last is None:
            self._restart(start_s, count)
            return _Found()
        last_start_s, last_count, last_arrival_s = last
        span_s = last_count / self._rate_hz
        late_s = start_s - last_start_s - span_s
        if clock is ClockKind.ARRIVAL:
            return self._arrived(start_s, count, span_s, late_s)
        if (start_s, count) == (last_start_s, last_count):
            return _Found(is_repeated=True)
        if abs(late_s) <= max(1.5 / self._rate_hz, 0.05 * span_s):
            self._ratio = None
            return self._continued(start_s, count, slack_s=2 / self._rate_hz)
        self._restart(start_s, count)
        ratio, before = (start_s - last_start_s) / span_s, self._ratio
        self._ratio = ratio
        if 0.4 < ratio < 2.5 and before is not None and abs(ratio / before - 1) < 0.02:
            self._measured_hz = self._rate_hz / ratio
            return _Found(max(late_s, 0.0), min(late_s, 0.0), self._measured_hz)
        passed_s = arrival_s - last_arrival_s
        is_lost = late_s > 0 and (clock is ClockKind.RECORDING or passed_s + 1.0 > late_s)
        return _Found(gap_s=late_s) if is_lost else _Found(jump_s=late_s)

    def _arrived(self, start_s: float, count: int, span_s: float, late_s: float) -> _Found:
        """Arrivals jitter: only what exceeds a slow packet is a gap."""
        if late_s > (max(0.25, 3 * span_s) if span_s < 0.5 else 1.5 * span_s):
            self._restart(start_s, count)
            return _Found(gap_s=late_s)
        return self._continued(start_s, count, slack_s=0.3 + span_s)

    def _restart(self, start_s: float, count: int) -> None:
        self._counted = count
        self._counted_from_s = start_s

    def _continued(self, start_s: float, count: int, slack_s: float) -> _Found:
        """Compare the samples counted since some packet with the time between them."""
        span_s = start_s - self._counted_from_s
        stated_s = self._counted / self._rate_hz
        if span_s > 0 and stated_s >= _RATE_SPAN_S:
            is_wrong = abs(span_s - stated_s) > MAX_RATE_ERROR * stated_s + slack_s
            if is_wrong:
                self._measured_hz = self._counted / span_s
            if is_wrong or stated_s >= _MAX_RATE_SPAN_S:
                if not is_wrong:
                    self._measured_hz = None
                self._restart(start_s, 0)
        self._counted += count
        return _Found(rate_hz=self._measured_hz, is_continued=True)


class _Runs:
    """Samples in a row that are at a bound, or equal, across packets; by channel."""

    def __init__(self, info: SignalInfo) -> None:
        channels = len(info.channels)
        self._info = info
        self._at_bound = np.zeros(channels, dtype=np.int64)
        self._equal = np.zeros(channels, dtype=np.int64)
        self._last = np.full(channels, np.nan)
        self._needed = SATURATED_RUN if (info.rate_hz or 0.0) >= 10 else 1
        is_wave = info.kind in WAVEFORMS and info.rate_hz is not None
        self._max_equal = max(3, round(MAX_FLAT_S * (info.rate_hz or 1.0))) if is_wave else None

    def take(self, values: NDArray[np.float64]) -> tuple[bool, bool]:
        """Return whether the samples are saturated, and whether they are flat."""
        bound = (values >= self._info.max_value) | (values <= self._info.min_value)
        if self._needed == 1:
            saturated = bool(((values > self._info.max_value) | (values < self._info.min_value)).any())
        else:
            longest, self._at_bound = _longest_runs(bound, self._at_bound)
            saturated = bool((longest >= self._needed).any())
        if self._max_equal is None:
            return saturated, False
        equal = values == np.vstack((self._last, values[:-1]))
        self._last = values[-1].copy()
        longest, self._equal = _longest_runs(equal, self._equal)
        return saturated, bool((longest >= self._max_equal).any())


def _longest_runs(
    flags: NDArray[np.bool_], before: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return per column the longest run of true rows, and the run at the end; `before` are runs so far."""
    rows = np.arange(1, len(flags) + 1)[:, None]
    last_false = np.maximum.accumulate(np.where(flags, 0, rows), axis=0)
    runs = np.where(last_false > 0, rows - last_false, rows + before)
    runs = np.where(flags, runs, 0)
    return runs.max(axis=0), runs[-1]


class _Units:
    """Whether values have the order of magnitude of their unit, in blocks of 2 s."""

    def __init__(self, info: SignalInfo) -> None:
        self._info = info
        self._size = round(_BLOCK_S * info.rate_hz) if info.rate_hz and info.rate_hz >= 10 else 0
        self._is_watched = self._size > 0 and info.kind in (WAVEFORMS | {SignalKind.ACCELERATION})
        self._block: list[NDArray[np.float64]] = []
        self._count = 0
        self._typical: float | None = None
        self._odd = 0
        self._fault = ""

    def take(self, values: NDArray[np.float64], *, is_usable: bool) -> str:
        """Return what is wrong with the unit; an empty text if nothing is known to be wrong."""
        if not self._is_watched:
            return ""
        if not is_usable:
            self._block, self._count = [], 0
            return self._fault
        self._block.append(values)
        self._count += len(values)
        if self._count >= self._size:
            self._fault = self._fault_of(np.concatenate(self._block))
            self._block, self._count = [], 0
        return self._fault

    def _fault_of(self, block: NDArray[np.float64]) -> str:
        if not np.isfinite(block).any():
            return ""
        if self._info.kind is SignalKind.ACCELERATION:
            if self._info.unit != "MSK" or block.shape[1] != 3:
                return ""
            length = float(np.nanmedian(np.linalg.norm(block, axis=1)))
            lower, upper = GRAVITY_MPS2
            if lower <= length <= upper:
                return ""
            return f"a median of {length:.3g} m/s² is no acceleration with gravity; is it another unit?"
        spread = float(np.nanmax(np.nanmax(block, axis=0) - np.nanmin(block, axis=0)))
        factor = _MICROVOLTS.get(self._info.unit)
        if self._info.kind is SignalKind.ECG and factor is not None:
            lower, upper = ECG_SPREAD_UV
            if not lower <= spread * factor <= upper:
                return f"{spread:.3g} {self._info.unit} peak to peak is no ECG; is it another unit?"
        return self._compared(spread)

    def _compared(self, spread: float) -> str:
        if spread <= 0:
            return self._fault
        if self._typical is None:
            self._typical = spread
            return ""
        ratio = spread / self._typical
        if 1 / _UNIT_FACTOR < ratio < _UNIT_FACTOR:
            self._typical *= max(0.8, min(1.25, ratio))
            self._odd = 0
            return ""
        self._odd += 1
        return (
            f"the values changed by a factor of {ratio:.3g}; did the unit change?" if self._odd >= 2 else ""
        )
