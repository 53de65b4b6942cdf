"""Blink rate, fixations, saccades and pupils: from events of an eye tracker, from its gaze, or from an EOG.

    events    BLINK, FIXATION and SACCADE as the tracker found them
    gaze      in degrees, 60 Hz or more: fixations and saccades by velocity
    EOG       the vertical lead in volts, 50 Hz or more: blinks
    eyeState  pupils

Rates are counts of a window that slides: of blinks 60 s, of saccades and fixations 10 s. Each event gives
one when it ends, from the events before it, so that it does not raise the rate itself: of a sensor that has
sent events for t s, less than a window, n - 1 intervals in t. The quality rises with the share of the window
that is known, and reaches 0.5, from which a value counts, after half of it. An event whose duration no eye
has counts for the rate only, and lowers the quality by its share.

While the same tracker sends gaze or pupils, the time without an event is known, too: the rates of blinks and
saccades follow each second from what the window has, down to 0 of somebody who stares.

Gaze: a saccade is faster than 30 degrees/s over 20 ms (I-VT, Salvucci and Goldberg 2000, "Identifying
fixations and saccades in eye-tracking protocols"), for 5 ms at least; a fixation is what lies between two,
for 60 ms at least. EOG: a blink is a wave of the vertical lead above its slow course, by the higher of 80
microvolt and three quarters of the usual blink, that lasts 50 to 500 ms; saccades are steps, which do not
come back.

No value of the eyes feeds a limit.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal as dsp

from handover.messages import number_text
from handover_body.model.features import Feature, FeatureName
from handover_body.model.signals import Samples, SensorReport, SignalInfo, SignalKind

BLINK_WINDOW_S: Final = 60.0
MOVEMENT_WINDOW_S: Final = 10.0
MAX_EVENTS: Final = 512
"""In one window; more are no eyes."""
BLINK_PERIOD_S: Final = 20.0
"""A blink rate is stale after three of these without a blink."""
MOVEMENT_PERIOD_S: Final = 3.0
EACH_S: Final = 1.0
DURATIONS_S: Final = {
    SignalKind.BLINK: (0.03, 2.0),
    SignalKind.FIXATION: (0.03, 10.0),
    SignalKind.SACCADE: (0.005, 0.3),
}
"""What eyes do; longer blinks are closed eyes."""
WINDOWS_S: Final = {
    SignalKind.BLINK: BLINK_WINDOW_S,
    SignalKind.FIXATION: MOVEMENT_WINDOW_S,
    SignalKind.SACCADE: MOVEMENT_WINDOW_S,
}
_DURATION_OF: Final = {
    SignalKind.BLINK: FeatureName.BLINK_DURATION,
    SignalKind.FIXATION: FeatureName.FIXATION_DURATION,
}
DURATION: Final = "duration_s"
AMPLITUDE: Final = "amplitude_deg"

SACCADE_DEG_S: Final = 30.0
VELOCITY_WINDOW_S: Final = 0.02
MIN_SACCADE_S: Final = 0.005
MIN_FIXATION_S: Final = 0.06
MIN_GAZE_HZ: Final = 60.0

MIN_BLINK_UV: Final = 80.0
BLINK_SHARE: Final = 0.75
BLINK_WIDTH_S: Final = (0.05, 0.5)
EOG_BASELINE_S: Final = 1.5
EOG_LATE_S: Final = 0.75
"""So long after a sample its slow course, the median around it, is known."""
MIN_EOG_HZ: Final = 50.0
_VOLTS: Final = {"D82": 1.0, "2Z": 1e3, "VLT": 1e6}
PUPILS_MM: Final = ("pupil_left_mm", "pupil_right_mm")
PUPIL_RANGE_MM: Final = (1.0, 10.0)

Floats = NDArray[np.float64]


class EventWindow:
    """The events of one kind in a sliding window. Times are in s, and each is that of the end of an event."""

    def __init__(self, kind: SignalKind, method: str) -> None:
        self.window_s: Final = WINDOWS_S[kind]
        self._kind: Final = kind
        self._method: Final = method
        self._events: deque[tuple[float, float, float, float]] = deque(maxlen=MAX_EVENTS)
        """End, duration, amplitude, quality; NaN: not known, or not plausible."""
        self._first_s: float | None = None
        self._due_s = -np.inf

    def clear(self) -> None:
        """Forget all events: what follows does not continue them."""
        self._events.clear()
        self._first_s = None
        self._due_s = -np.inf

    def add(
        self, source: str, at_s: float, duration_s: float, amplitude: float, quality: float
    ) -> list[Feature]:
        """Add an event; return the features that are due."""
        lowest, highest = DURATIONS_S[self._kind]
        is_plausible = lowest <= duration_s <= highest
        before = self._count(at_s)
        self._events.append((at_s, duration_s if is_plausible else np.nan, amplitude, quality))
        return self._due(source, at_s, before) if is_plausible else []

    def nothing_happened(self, source: str, until_s: float) -> list[Feature]:
        """Take note that no event ended after the last one until `until_s`; return the features that are due.

        The duration of fixations does not follow from that: one may last.
        """
        count = self._count(until_s)
        if self._kind is SignalKind.FIXATION or (self._events and until_s < self._events[-1][0]):
            return []
        return self._due(source, until_s, count)

    def _count(self, at_s: float) -> int:
        """Return how many events the window before `at_s` has; the first time begins what is known."""
        if self._first_s is None:
            self._first_s = at_s
        while self._events and self._events[0][0] < at_s - self.window_s:
            self._events.popleft()
        return len(self._events)

    def _due(self, source: str, at_s: float, count: int) -> list[Feature]:
        """Return the features of `count` events in the known part of the window, once a second."""
        covered_s = min(at_s - (self._first_s or 0.0), self.window_s)
        if covered_s <= 0 or at_s < self._due_s:
            return []
        self._due_s = at_s + EACH_S
        table = np.array(self._events).reshape(-1, 4)
        is_finite = np.isfinite(table[:, 1])
        certain = covered_s / self.window_s
        if len(table):
            certain *= float(is_finite.mean()) * (
                float(table[is_finite, 3].mean()) if is_finite.any() else 0.0
            )
        return list(self._features(source, at_s, count / covered_s, table[is_finite], min(certain, 1.0)))

    def _features(
        self, source: str, at_s: float, rate_hz: float, table: Floats, quality: float
    ) -> Iterator[Feature]:
        is_blink = self._kind is SignalKind.BLINK
        period_s = BLINK_PERIOD_S if is_blink else MOVEMENT_PERIOD_S

        def feature(name: FeatureName, value: float) -> Feature:
            return Feature(
                name, source, value, at_s, quality, method=self._method, window_s=self.window_s,
                period_s=period_s,
            )  # fmt: skip

        if is_blink:
            yield feature(FeatureName.BLINK_RATE, 60 * rate_hz)
        if self._kind in _DURATION_OF and len(table):
            yield feature(_DURATION_OF[self._kind], 1000 * float(table[:, 1].mean()))
        if self._kind is SignalKind.SACCADE:
            yield feature(FeatureName.SACCADE_RATE, rate_hz)
            sizes = table[np.isfinite(table[:, 2]), 2]
            if len(sizes):
                yield feature(FeatureName.SACCADE_AMPLITUDE, float(sizes.mean()))


class EyeEventProcessor:
    """Blinks, fixations or saccades as an eye tracker reports them."""

    def __init__(self, info: SignalInfo) -> None:
        if DURATION not in info.channels:
            raise ValueError(f"{info.kind} needs the channel {DURATION}, not {', '.join(info.channels)}")
        self._duration: Final = info.channels.index(DURATION)
        self._amplitude: Final = info.channels.index(AMPLITUDE) if AMPLITUDE in info.channels else None
        self._window: Final = EventWindow(info.kind, info.method or "eye tracker")

    def feed(self, samples: Samples) -> Sequence[Feature]:
        """Take events; return what they complete."""
        features: list[Feature] = []
        for at_s, row in zip(samples.sample_times_s(), samples.values, strict=True):
            size = np.nan if self._amplitude is None else float(row[self._amplitude])
            features += self._window.add(
                samples.source, float(at_s), float(row[self._duration]), size, samples.quality
            )
        return features

    def nothing_happened(self, source: str, until_s: float) -> Sequence[Feature]:
        """Return the rates of eyes that do nothing."""
        return self._window.nothing_happened(source, until_s)

    def report(self, report: SensorReport) -> Sequence[Feature]:
        """Forget the events before a fault."""
        if report.fault is not None or report.has_contact is False:
            self._window.clear()
        return []


class GazeProcessor:
    """Gaze in degrees to fixations and saccades, by velocity."""

    def __init__(self, info: SignalInfo) -> None:
        if info.unit != "DD" or len(info.channels) != 2 or (info.rate_hz or 0.0) < MIN_GAZE_HZ:
            raise ValueError(
                f"gaze needs two channels in degrees (DD) at {MIN_GAZE_HZ:g} Hz at least, not "
                f"{len(info.channels)} in {info.unit or 'no unit'} at {number_text(info.rate_hz)} Hz"
            )
        self._rate_hz: Final = float(info.rate_hz or MIN_GAZE_HZ)
        self._lag: Final = max(1, round(VELOCITY_WINDOW_S * self._rate_hz))
        self._fixations: Final = EventWindow(SignalKind.FIXATION, "gaze, I-VT-1")
        self._saccades: Final = EventWindow(SignalKind.SACCADE, "gaze, I-VT-1")
        self._reset()

    def _reset(self) -> None:
        self._fixations.clear()
        self._saccades.clear()
        self._tail = np.empty((0, 2))
        self._is_fast: bool | None = None
        """None: the first movement, whose beginning is not known."""
        self._is_whole = False
        self._since_s = 0.0
        self._from = np.zeros(2)

    def feed(self, samples: Samples) -> Sequence[Feature]:
        """Take gaze; return the features of the movements that have ended."""
        rows = np.vstack((self._tail, samples.values))
        velocity = np.linalg.norm(rows[self._lag :] - rows[: -self._lag], axis=1) * self._rate_hz / self._lag
        self._tail = rows[-self._lag :]
        times_s = samples.sample_times_s()[-len(velocity) :]
        fast = velocity > SACCADE_DEG_S
        features: list[Feature] = []
        for at in np.flatnonzero(np.diff(fast, prepend=fast[:1] if self._is_fast is None else self._is_fast)):
            # the velocity of a sample is that of the 20 ms before it
            moved_s = float(times_s[at]) - VELOCITY_WINDOW_S / 2
            features += self._ended(
                samples, bool(fast[at]), moved_s, rows[max(at - 1, 0) : at + 1].mean(axis=0)
            )
        if len(fast):
            self._is_fast = bool(fast[-1])
        return features

    def _ended(self, samples: Samples, is_fast: bool, at_s: float, gaze: Floats) -> list[Feature]:
        """End the movement before `at_s`: a fixation if a saccade begins."""
        lasted_s, size = at_s - self._since_s, float(np.linalg.norm(gaze - self._from))
        is_whole, self._is_whole = self._is_whole, True
        self._since_s, self._from = at_s, gaze
        if not is_whole:
            return []
        if is_fast:
            if lasted_s < MIN_FIXATION_S:
                return []
            return self._fixations.add(samples.source, at_s, lasted_s, np.nan, samples.quality)
        if lasted_s < MIN_SACCADE_S:
            return []
        return self._saccades.add(samples.source, at_s, lasted_s, size, samples.quality)

    def report(self, report: SensorReport) -> Sequence[Feature]:
        """Begin again after a fault."""
        if report.fault is not None or report.has_contact is False:
            self._reset()
        return []


class EogProcessor:
    """The vertical lead of an EOG to blinks: the channel `vertical`, else the first one."""

    def __init__(self, info: SignalInfo) -> None:
        if (info.rate_hz or 0.0) < MIN_EOG_HZ or info.unit not in _VOLTS:
            raise ValueError(
                f"EOG needs volts (D82, 2Z, VLT) at {MIN_EOG_HZ:g} Hz at least, not {info.unit} at "
                f"{number_text(info.rate_hz)} Hz"
            )
        self._rate_hz: Final = float(info.rate_hz or MIN_EOG_HZ)
        self._factor: Final = _VOLTS[info.unit]
        self._channel: Final = info.channels.index("vertical") if "vertical" in info.channels else 0
        self._filter: Final = dsp.butter(
            2, min(20.0, 0.4 * self._rate_hz), "low", fs=self._rate_hz, output="sos"
        )
        self._step: Final = max(1, round(self._rate_hz / 50))
        self._window: Final = EventWindow(SignalKind.BLINK, "eog-1")
        self._reset()

    def _reset(self) -> None:
        self._window.clear()
        self._state: Floats | None = None
        self._wave = np.empty(0)
        self._began_s = 0.0
        self._done = 0
        """Samples of the wave that are judged."""
        self._heights: deque[float] = deque(maxlen=15)
        self._rose_s: float | None = None
        self._height = 0.0

    def feed(self, samples: Samples) -> Sequence[Feature]:
        """Take samples; return the features of blinks, `EOG_LATE_S` after they end."""
        x = samples.values[:, self._channel] * self._factor
        if self._state is None:
            self._state = dsp.sosfilt_zi(self._filter) * x[0]
        smooth, self._state = dsp.sosfilt(self._filter, x, zi=self._state)
        self._wave = np.concatenate((self._wave, smooth))
        self._began_s = samples.end_s - (len(self._wave) - 1) / self._rate_hz
        half = round(EOG_BASELINE_S / 2 * self._rate_hz)
        end = len(self._wave) - half
        features: list[Feature] = []
        if end > self._done:
            above = self._above(self._done, end, half)
            for number, value in enumerate(above):
                at_s = self._began_s + (self._done + number) / self._rate_hz
                features += self._judge(samples, at_s, float(value))
            cut = max(end - half, 0)
            self._wave, self._done = self._wave[cut:], end - cut
        return features

    def _above(self, begin: int, end: int, half: int) -> Floats:
        """Return the wave above the median around each sample, which is computed 50 times a second."""
        places = np.arange(begin, end, self._step)
        course = [np.median(self._wave[max(place - half, 0) : place + half : self._step]) for place in places]
        values: Floats = self._wave[begin:end] - np.interp(np.arange(begin, end), places, course)
        return values

    def _judge(self, samples: Samples, at_s: float, value: float) -> list[Feature]:
        usual = float(np.median(self._heights)) if len(self._heights) >= 5 else 0.0
        # a blink begins and ends at half of its height
        if self._rose_s is None:
            if value >= max(MIN_BLINK_UV, BLINK_SHARE * usual) / 2:
                self._rose_s, self._height = at_s, value
            return []
        self._height = max(self._height, value)
        if value >= self._height / 2:
            return []
        lasted_s, height, self._rose_s = at_s - self._rose_s, self._height, None
        if not BLINK_WIDTH_S[0] <= lasted_s <= BLINK_WIDTH_S[1] or height < max(
            MIN_BLINK_UV, BLINK_SHARE * usual
        ):
            return []
        self._heights.append(height)
        return self._window.add(samples.source, at_s, lasted_s, np.nan, samples.quality)

    def report(self, report: SensorReport) -> Sequence[Feature]:
        """Begin again after a fault."""
        if report.fault is not None or report.has_contact is False:
            self._reset()
        return []


class PupilProcessor:
    """The diameter of the pupils: the mean of both, the median of a second."""

    def __init__(self, info: SignalInfo) -> None:
        self._channels: Final = [n for n, name in enumerate(info.channels) if name in PUPILS_MM]
        if not self._channels or info.unit != "MMT":
            raise ValueError(
                f"{info.kind} needs {' or '.join(PUPILS_MM)} in mm (MMT), not {', '.join(info.channels)} in "
                f"{info.unit or 'no unit'}"
            )
        self._method: Final = info.method or "eye tracker"
        self._rows: list[Floats] = []
        self._quality = 1.0
        self._since_s: float | None = None

    def feed(self, samples: Samples) -> Sequence[Feature]:
        """Take samples; return the diameter once a second."""
        if self._since_s is None:
            self._since_s = samples.start_s
        self._rows.append(samples.values[:, self._channels])
        self._quality = min(self._quality, samples.quality)
        if samples.end_s - self._since_s < EACH_S:
            return []
        values = np.concatenate(self._rows)
        lowest, highest = PUPIL_RANGE_MM
        seen = np.where(
            (values >= lowest) & (values <= highest), values, np.nan
        )  # 0 while the lids are closed
        share = float(np.isfinite(seen).mean())
        quality, self._quality, self._rows, self._since_s = self._quality, 1.0, [], samples.end_s
        if share == 0:
            return []
        diameter = float(np.nanmedian(seen))
        return [
            Feature(
                FeatureName.PUPIL_DIAMETER, samples.source, diameter, samples.end_s, quality * share,
                method=self._method, window_s=EACH_S, period_s=EACH_S,
            )
        ]  # fmt: skip

    def report(self, report: SensorReport) -> Sequence[Feature]:
        """Begin again after a fault."""
        if report.fault is not None or report.has_contact is False:
            self._rows, self._since_s = [], None
        return []
