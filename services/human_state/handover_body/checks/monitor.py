"""Checks of one signal of one sensor, between the driver and everything else. Pure: time is an argument.

Every check has one place: times, rates, gaps and silence are here, with `continuity` and `timing`; values are
in `values`. What is behind the monitor (analysis, page, recording, streams) uses quality and reports, and
checks nothing again.

Invariants, whatever a device sends:

- times that leave are finite, increase strictly (in recordings: between two clock jumps), and those of live
  sensors lie at most `MAX_AHEAD_S` after the arrival;
- samples before and after a gap or a jump are never joined without a report in between;
- samples with quality above 0 have passed all checks of `values`: they are finite, within the range of the
  sensor and of a body, at the stated rate, with contact as far as the device knows;
- memory does not grow with the length of the signal.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from handover.messages import message
from handover_body.checks.continuity import Continuity
from handover_body.checks.timing import WINDOW_S, ClockMap
from handover_body.checks.values import ValueChecks
from handover_body.model.signals import (
    EYE_EVENTS,
    ClockKind,
    Samples,
    SensorFault,
    SensorReport,
    SignalInfo,
    SignalKind,
)

MAX_AHEAD_S: Final = 0.5
MAX_AGE_S: Final = 3600.0
"""Samples stamped at their arrival are not older."""
MAX_TIME_S: Final = 1e11
"""Clocks of devices count less; a float resolves 15 microseconds there."""
FAST_SILENCE_S: Final = 0.85
"""Waveforms come in packets; silence of them is found within 1 s."""
MAX_SLEW: Final = 0.01
"""Times of consecutive packets move by at most this share of their span towards the mapped clock."""
MAX_RESIDUAL_S: Final = 0.5
"""Further off than this, they follow it at once and a clock jump is reported."""
MAX_LATE_S: Final = 2.0
"""Packets of a device with a clock of its own may come so much later than those before."""
EXCUSED_S: Final = 1.0
"""After a pause of this machine, what waited arrives within this time and that of the pause."""
DRAINING: Final = 0.5
"""Packets that come within this share of the time in which they were measured had to wait."""
MIN_OFF_PACE_S: Final = (0.02, 0.05)
"""So much earlier or later than all before, a packet that says only when it began has another rate."""
EVENT_SILENCE_S: Final = {
    SignalKind.BLINK: 60.0,
    SignalKind.FIXATION: 10.0,
    SignalKind.SACCADE: 10.0,
    SignalKind.GAIT: math.inf,
    SignalKind.MOOD: math.inf,
}
"""Longer than somebody who is awake does not blink or look elsewhere; who stands has no gait at all."""
MIN_PERIODS: Final = 3
SILENT_PERIODS: Final = 1.9
"""With the time between two looks (`WATCH_S`), silence is found within two periods."""
_REPEAT_S: Final = 1.0
"""A lasting fault is reported this often."""


@dataclass(frozen=True, slots=True)
class Checked:
    """What leaves the monitor: the samples with times of our clock, None if none can be used, and news."""

    samples: Samples | None
    reports: tuple[SensorReport, ...] = ()


def default_silence_s(info: SignalInfo) -> float | None:
    """Return how long a signal may be silent: 0.85 s from 10 Hz, else under two periods; None: irregular.

    Events of the eyes and of a gait have no period: people stare, and stand.
    """
    if info.rate_hz is None:
        return EVENT_SILENCE_S.get(info.kind)
    return FAST_SILENCE_S if info.rate_hz >= 10 else max(FAST_SILENCE_S, 1.8 / info.rate_hz)


class SignalMonitor:
    """The checks of one signal."""

    def __init__(
        self,
        source: str,
        info: SignalInfo,
        max_latency_s: float = 0.1,
        silence_s: float | None = None,
        *,
        stamps_oldest: bool = False,
    ) -> None:
        """`stamps_oldest`: packets have the time of their oldest sample, so only the arrival says when the
        newest one was taken."""
        self.info = info
        self._stamps_oldest = stamps_oldest
        self._source = source
        self._clock = ClockMap(max_latency_s)
        self._max_latency_s = max_latency_s
        self._silence_s = default_silence_s(info) if silence_s is None else silence_s
        self._arrival_s: float | None = None
        self._is_silent = False
        self._lasting: dict[SensorFault, float] = {}
        self._values = ValueChecks(info)
        self._continuity = Continuity(info)
        self._has_contact: bool | None = None
        self._last_out_s = -math.inf
        self._periods_s: deque[float] = deque(maxlen=9)
        self._quiet_s = -math.inf
        """Until then nothing is known to have happened."""
        self._late_s = 0.0
        self._is_draining = False
        """Whether packets come faster than they were measured: those that had to wait."""
        self._late_until_s = -math.inf
        self._busy_until_s = -math.inf
        """Until then the mapped clock may know only packets that had to wait."""

    def restart(self) -> None:
        """Forget the times: the device was connected again. What was sent stays in the order of time."""
        self._clock.reset()
        self._continuity = Continuity(self.info)
        self._values = ValueChecks(self.info)
        self._arrival_s = None
        self._is_silent = False

    def delayed(self, at_s: float, late_s: float) -> None:
        """Take note that this machine took nothing for `late_s` before `at_s`: that is no silence."""
        if self._arrival_s is not None:
            self._arrival_s = min(self._arrival_s + late_s, at_s)
        self._late_s = max(late_s, self._late_s if at_s <= self._late_until_s else 0.0)
        self._late_until_s = at_s + late_s + EXCUSED_S
        self._busy_until_s = at_s + late_s + WINDOW_S

    def silence(self, at_s: float) -> SensorReport | None:
        """Return a report once when nothing has arrived for too long."""
        limit_s = self._silence_limit_s()
        if self._arrival_s is None or limit_s is None or self._is_silent:
            return None
        silent_s = at_s - self._arrival_s
        if silent_s < limit_s:
            return None
        self._is_silent = True
        text = message(
            "health.sensor.silent",
            "no {signal} for {seconds} s",
            signal=self.info.kind,
            seconds=round(silent_s, 1),
        )
        return self._report(SensorFault.GAP, at_s, text, {"silence_s": silent_s})

    def nothing_happened(self, until_s: float, arrival_s: float) -> Samples | None:
        """Take note that a sensor that sends other signals has had no event of this one until `until_s`.

        Returns an empty packet with that time, once a second. `until_s` is on our clock.
        """
        self._arrival_s = arrival_s
        self._is_silent = False
        if 0 <= until_s - self._quiet_s < _REPEAT_S:
            return None
        self._quiet_s = until_s
        return Samples(self._source, self.info, until_s, np.empty((0, len(self.info.channels))), np.empty(0))

    def _empty(self, samples: Samples, arrival_s: float) -> Samples | None:
        """Take an empty packet: of events of the eyes it says that there was none."""
        until_s = samples.start_s
        if self.info.kind not in EYE_EVENTS or not samples.quality > 0 or not abs(until_s) <= MAX_TIME_S:
            return None
        if samples.clock is ClockKind.DEVICE:
            until_s += self._clock.observe(until_s, arrival_s)
        return self.nothing_happened(min(until_s, arrival_s), arrival_s)

    def _silence_limit_s(self) -> float | None:
        """Return how long the signal may be silent: under two periods of one that comes irregularly."""
        if self._silence_s is not None or self.info.rate_hz is not None or len(self._periods_s) < MIN_PERIODS:
            return self._silence_s
        return max(FAST_SILENCE_S, SILENT_PERIODS * float(np.median(self._periods_s)))

    def take(self, samples: Samples, arrival_s: float) -> Checked:
        """Check the samples of one packet that arrived at `arrival_s`, in s since 1970."""
        if len(samples.values) == 0:
            return Checked(self._empty(samples, arrival_s))
        if self._arrival_s is not None and not self._is_silent:
            self._periods_s.append(max(arrival_s - self._arrival_s, 0.0))
        passed_s = math.inf if self._arrival_s is None else arrival_s - self._arrival_s
        self._is_draining = self.info.rate_hz is not None and (
            passed_s < DRAINING * len(samples.values) / self.info.rate_hz
        )
        self._arrival_s = arrival_s
        self._is_silent = False
        reports: list[SensorReport] = []
        timed = self._timed(samples, arrival_s, reports)
        if timed is None:
            return Checked(None, tuple(reports))
        return Checked(self._judged(timed, arrival_s, reports), tuple(reports))

    # Times

    def _timed(self, samples: Samples, arrival_s: float, reports: list[SensorReport]) -> Samples | None:
        times_s = samples.sample_times_s()
        ours_s = arrival_s if samples.clock is ClockKind.ARRIVAL else 0.0
        far_s = MAX_AGE_S if samples.clock is ClockKind.ARRIVAL else MAX_TIME_S
        if not (abs(samples.start_s - ours_s) <= far_s and np.all(np.abs(times_s - ours_s) <= far_s)):
            text = message(
                "health.sensor.time",
                "{signal}: an impossible time; the packet was dropped",
                signal=self.info.kind,
            )
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
        late_s = self._late_s if arrival_s <= self._late_until_s else 0.0
        gap = self._continuity.take(samples.start_s, count, arrival_s, samples.clock, late_s)
        if gap.is_repeated:
            return None
        if gap.gap_s:
            text = message(
                "health.sensor.gap",
                "{signal}: {seconds} s are missing",
                signal=self.info.kind,
                seconds=round(gap.gap_s, 2),
            )
            reports.append(self._report(SensorFault.GAP, arrival_s, text, {"gap_s": gap.gap_s}))
        if gap.jump_s:
            self._jumped(gap.jump_s, arrival_s, reports)
            if samples.clock is ClockKind.RECORDING:
                self._last_out_s = -math.inf
        if gap.rate_hz is not None:
            text = message(
                "health.sensor.rate",
                "{signal}: {measured} samples per second arrive, {stated} are stated",
                signal=self.info.kind,
                measured=round(gap.rate_hz, 2),
                stated=round(rate_hz, 2),
            )
            details = {"measured_hz": gap.rate_hz, "stated_hz": rate_hz}
            self._lasts(SensorFault.RATE, arrival_s, text, reports, details)
            samples = replace(samples, quality=0.0)
        elif gap.is_continued and not self._is_on_pace(samples, count / rate_hz, arrival_s, reports):
            samples = replace(samples, quality=0.0)
        target_s, uncertainty_s = self._mapped(samples, count / rate_hz, arrival_s)
        if gap.is_continued and math.isfinite(self._last_out_s):
            residual_s = target_s - (self._last_out_s + 1 / rate_hz)
            if abs(residual_s) > self._max_residual_s(residual_s, arrival_s, samples.clock):
                if residual_s < 0 and self._is_late(arrival_s, samples.clock):
                    self._came_late(-residual_s, arrival_s, reports)
                else:
                    self._jumped(residual_s, arrival_s, reports, reset=False)
            elif samples.clock is not ClockKind.RECORDING:
                slew_s = min(MAX_SLEW * count, 0.4) / rate_hz
                rest_s = residual_s - max(-slew_s, min(slew_s, residual_s))
                target_s -= rest_s
                uncertainty_s += abs(rest_s)
        latest_s = math.inf if samples.clock is ClockKind.RECORDING else arrival_s + MAX_AHEAD_S
        return self._cut(replace(samples, start_s=target_s, uncertainty_s=uncertainty_s), latest_s)

    def _is_on_pace(
        self, samples: Samples, span_s: float, arrival_s: float, reports: list[SensorReport]
    ) -> bool:
        """Compare the end of a packet that states only its beginning with the arrival: is the rate true?"""
        offset_s, jitter_s = self._clock.offset_s, self._clock.jitter_s
        if not self._stamps_oldest or offset_s is None or jitter_s is None or arrival_s <= self._busy_until_s:
            return True
        late_s = arrival_s - (samples.start_s + span_s - 1 / (self.info.rate_hz or 1.0)) - offset_s
        if late_s > max(MIN_OFF_PACE_S[1], 2 * jitter_s):
            self._came_late(late_s, arrival_s, reports)
            return False
        if -late_s > max(MIN_OFF_PACE_S[0], jitter_s):
            text = message(
                "health.sensor.early",
                "{signal}: packets come {seconds} s before their samples can have been taken",
                signal=self.info.kind,
                seconds=round(-late_s, 2),
            )
            self._lasts(SensorFault.RATE, arrival_s, text, reports, {"early_s": -late_s})
            return False
        return True

    def _is_late(self, arrival_s: float, clock: ClockKind) -> bool:
        """Return whether this machine or the link was busy just now."""
        return clock is not ClockKind.RECORDING and (self._is_draining or arrival_s <= self._busy_until_s)

    def _max_residual_s(self, residual_s: float, arrival_s: float, clock: ClockKind) -> float:
        """Return how far times may be off: packets that come later than before only raise the uncertainty."""
        if residual_s < 0 or clock is ClockKind.RECORDING:
            return MAX_RESIDUAL_S
        is_late = arrival_s <= self._late_until_s
        return max(MAX_LATE_S if clock is ClockKind.DEVICE else MAX_RESIDUAL_S, self._late_s * is_late)

    def _came_late(self, late_s: float, arrival_s: float, reports: list[SensorReport]) -> None:
        """Packets before were later than known: what overlaps them is dropped."""
        text = message(
            "health.sensor.late",
            "{signal}: packets came {seconds} s late",
            signal=self.info.kind,
            seconds=round(late_s, 1),
        )
        reports.append(self._report(SensorFault.LATE, arrival_s, text, {"late_s": late_s}))

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
        text = message(
            "health.sensor.jump",
            "{signal}: the times jumped by {seconds} s",
            signal=self.info.kind,
            seconds=round(jump_s, 2),
        )
        reports.append(self._report(SensorFault.CLOCK_JUMP, arrival_s, text, {"jump_s": jump_s}))

    # Values

    def _judged(self, samples: Samples, arrival_s: float, reports: list[SensorReport]) -> Samples:
        judged = self._values.take(samples)
        had_contact, self._has_contact = self._has_contact, samples.has_contact
        if judged.finding is not None:
            fault = judged.finding
            if self._has_contact is False and had_contact is not False:
                self._lasting.pop(SensorFault.NO_CONTACT, None)
            self._lasts(fault.fault, arrival_s, fault.text, reports, fault.details)
        elif judged.quality > 0:
            self._lasting.clear()
        return replace(samples, values=judged.values, quality=judged.quality)

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
        is_contact = fault is SensorFault.NO_CONTACT  # of the whole sensor, not of one signal
        return SensorReport(
            self._source,
            at_s,
            fault=fault,
            text=text,
            details=details or {},
            has_contact=False if is_contact and self._has_contact is False else None,
            kind=None if is_contact else self.info.kind,
        )
