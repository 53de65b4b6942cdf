"""Faults of a signal: samples that must not become values are found before any analysis sees them.

`SignalGuard.check` takes each packet and returns it if it may be used, else the fault:

| fault | found by |
|---|---|
| gap | the packet begins later than the last one ended |
| clockJump | it begins earlier |
| noContact | the device says so; the ECG becomes quiet, as with a strap that was taken off |
| saturated | samples at the bounds of the sensor, or clipped at one value |
| flat | every channel keeps one value for longer than a body signal can |
| unit | values that no body produces in this unit, gravity that is not 9.8 m/s2, a level that rose by 30 |
| artefact | NaN, or a level 10 times the usual one of this ECG, PPG or breathing signal |

Silence, clocks, and rates that lie are found by `drivers.monitor`, which knows when packets arrived. After a
fault samples are used again when `SETTLE_S` of good ones have come: transients of amplifiers are not values.
Time from the fault to its report is one packet, and at most 1 s of signal.
"""

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from handover.messages import message
from services.human_state.model.signals import (
    ClockKind,
    Samples,
    SensorFault,
    SensorReport,
    SignalInfo,
    SignalKind,
)

Floats = NDArray[np.float64]
Finding = tuple[SensorFault, str, dict[str, float]]
"""A fault, what a person should know of it, and figures."""

SETTLE_S: Final = 1.0
MAX_ARRIVAL_JITTER_S: Final = 0.25
MAX_UNCERTAINTY_S: Final = 0.1
"""An uncertain clock is no reason to join packets that are further apart."""
MIN_LEVEL_S: Final = 2.2
"""So much signal shows the usual level: one beat at least."""
MIN_QUIET_S: Final = 1.05
GRAVITY_MPS2: Final = 9.80665

WAVEFORMS: Final = frozenset(
    {
        SignalKind.ECG, SignalKind.PPG, SignalKind.EDA, SignalKind.EMG, SignalKind.EEG, SignalKind.EOG,
        SignalKind.ICG, SignalKind.BCG, SignalKind.RESPIRATION, SignalKind.ACCELERATION,
        SignalKind.ANGULAR_VELOCITY, SignalKind.MAGNETIC_FIELD,
    }
)  # fmt: skip
STEADY_LEVEL: Final = frozenset({SignalKind.ECG, SignalKind.PPG, SignalKind.RESPIRATION})
"""Kinds whose level does not rise tenfold while they mean anything. A muscle or an arm may."""

FLAT_AFTER_S: Final[dict[SignalKind, float]] = {
    SignalKind.ECG: 0.5,
    SignalKind.PPG: 0.6,
    SignalKind.EMG: 0.5,
    SignalKind.EEG: 0.5,
    SignalKind.ACCELERATION: 0.65,
    SignalKind.RESPIRATION: 3.0,
}

PLAUSIBLE: Final[dict[tuple[SignalKind, str], tuple[float, float]]] = {
    (SignalKind.ECG, "D82"): (-500_000, 500_000),  # microvolt: electrode offsets of 300 mV are normal
    (SignalKind.ECG, "2Z"): (-500, 500),
    (SignalKind.ACCELERATION, "MSK"): (-320, 320),
    (SignalKind.EDA, "D80"): (0.0, 100),
    (SignalKind.HEART_RATE, "BPM"): (25, 250),
    (SignalKind.INTER_BEAT_INTERVAL, "C26"): (240, 2400),
    (SignalKind.INTER_BEAT_INTERVAL, "SEC"): (0.24, 2.4),
    (SignalKind.BREATHING_RATE, "C94"): (3, 70),
    (SignalKind.HEART_RATE_VARIABILITY, "C26"): (0, 500),
    (SignalKind.SPO2, "P1"): (50, 100),
    (SignalKind.SKIN_TEMPERATURE, "CEL"): (10, 45),
}
"""What a body can produce, by kind and unit. A value outside is never used."""


@dataclass(frozen=True, slots=True)
class Checked:
    """The packet if it may be used, and the faults that begin with it."""

    samples: Samples | None
    faults: tuple[SensorReport, ...] = ()


class SignalGuard:
    """Checks the packets of one signal of one sensor. It keeps figures of the last 20 s, no samples."""

    def __init__(self, info: SignalInfo) -> None:
        self.info: Final = info
        self._next_s: float | None = None
        self._constant_s = np.zeros(len(info.channels))
        self._last_row: Floats | None = None
        self._levels: deque[float] = deque(maxlen=80)
        self._level_s = 0.0
        self._quiet_s = 0.0
        self._quiet_runs_s: deque[float] = deque([1.5], maxlen=20)
        self._settle_s = 0.0
        self._fault: SensorFault | None = None
        self._source = ""

    @property
    def fault(self) -> SensorFault | None:
        """Return the fault that lasts, or None."""
        return self._fault

    def check(self, samples: Samples) -> Checked:
        """Return the packet if it may be used, and new faults."""
        self._source = samples.source
        if not len(samples.values):
            return Checked(None)
        times_s = samples.sample_times_s()
        found = self._clock_fault(samples, times_s) or self._value_fault(samples)
        duration_s = self._duration_s(samples, times_s)
        self._last_row = samples.values[-1]
        if found is not None:
            fault, text, details = found
            return Checked(None, self._begin(fault, float(times_s[-1]), text, **details))
        if self._fault is not None:
            self._settle_s -= duration_s if self.info.rate_hz is not None else SETTLE_S
            if self._settle_s > 0:
                return Checked(None)
            self._fault = None
        return Checked(samples)

    def _begin(
        self, fault: SensorFault, at_s: float, text: str, **details: float
    ) -> tuple[SensorReport, ...]:
        self._settle_s = SETTLE_S if self.info.kind in WAVEFORMS else 0.0
        if fault is self._fault:
            return ()
        self._fault = fault
        return (SensorReport(self._source, at_s, fault=fault, text=text, details=details),)

    def _duration_s(self, samples: Samples, times_s: Floats) -> float:
        rate_hz = self.info.rate_hz
        if rate_hz is not None:
            return len(samples.values) / rate_hz
        return float(times_s[-1] - times_s[0])

    # --- time

    def _clock_fault(  # noqa: PLR0911 -- one return a rule
        self, samples: Samples, times_s: Floats
    ) -> Finding | None:
        """Find packets that do not continue the one before: nothing is analysed over a joint.

        Why they do not, and rates that lie, are found by the monitor of the driver, which sees arrivals.
        """
        expected_s, rate_hz = self._next_s, samples.info.rate_hz
        if not np.isfinite(times_s).all() or (np.diff(times_s) < 0).any():
            self._next_s = None
            return (
                SensorFault.CLOCK_JUMP,
                message("health.sensor.order", "{signal}: its times are not in order", signal=self.info.kind),
                {},
            )
        start_s, end_s = float(times_s[0]), float(times_s[-1])
        if rate_hz is None:
            self._next_s = end_s
            is_early = expected_s is not None and start_s < expected_s - 0.001
            return (
                (
                    SensorFault.CLOCK_JUMP,
                    message(
                        "health.sensor.order", "{signal}: its times are not in order", signal=self.info.kind
                    ),
                    {},
                )
                if is_early
                else None
            )
        self._next_s = start_s + len(samples.values) / rate_hz
        if rate_hz != self.info.rate_hz:
            return (
                SensorFault.RATE,
                message(
                    "health.sensor.other_rate",
                    "{signal}: says {rate} Hz, was {before} Hz",
                    signal=self.info.kind,
                    rate=rate_hz,
                    before=self.info.rate_hz,
                ),
                {},
            )
        if expected_s is None:
            return None
        offset_s = start_s - expected_s
        tolerance_s = max(1.5 / rate_hz, 0.01, 3 * min(samples.uncertainty_s, MAX_UNCERTAINTY_S))
        if samples.clock is ClockKind.ARRIVAL:
            tolerance_s = max(tolerance_s, MAX_ARRIVAL_JITTER_S)
            if abs(offset_s) <= tolerance_s:  # jitter of the arrival must not add up
                self._next_s = expected_s + 0.1 * offset_s + len(samples.values) / rate_hz
        if abs(offset_s) <= tolerance_s:
            return None
        if offset_s > 0:
            return (
                SensorFault.GAP,
                message(
                    "health.sensor.gap",
                    "{signal}: {seconds} s are missing",
                    signal=self.info.kind,
                    seconds=round(offset_s, 3),
                ),
                {"gap_s": offset_s},
            )
        return (
            SensorFault.CLOCK_JUMP,
            message(
                "health.sensor.jump",
                "{signal}: the times jumped by {seconds} s",
                signal=self.info.kind,
                seconds=round(offset_s, 3),
            ),
            {"jump_s": offset_s},
        )

    # --- values

    def _value_fault(  # noqa: PLR0911 -- one return a rule
        self, samples: Samples
    ) -> Finding | None:
        values, info = samples.values, self.info
        if samples.has_contact is False:
            return (
                SensorFault.NO_CONTACT,
                message("health.sensor.contact", "the sensor does not touch the body"),
                {},
            )
        if samples.info.unit != info.unit:
            return (
                SensorFault.UNIT,
                message(
                    "health.sensor.unit_changed",
                    "{signal}: its unit changed from {before} to {unit}",
                    signal=self.info.kind,
                    before=info.unit,
                    unit=samples.info.unit,
                ),
                {},
            )
        if not np.isfinite(values).all() or samples.quality <= 0:
            return (
                SensorFault.ARTEFACT,
                message(
                    "health.sensor.unmeasured",
                    "{signal}: the device could not measure some samples",
                    signal=self.info.kind,
                ),
                {},
            )
        saturated = (values <= info.min_value) | (values >= info.max_value)
        if info.kind in WAVEFORMS and saturated.any():
            return (
                SensorFault.SATURATED,
                message(
                    "health.sensor.saturated",
                    "{signal}: values at the bound of the sensor",
                    signal=self.info.kind,
                ),
                {},
            )
        if info.kind is SignalKind.PRESSURE_MAP and (values >= info.max_value).mean() > 0.5:
            return (
                SensorFault.SATURATED,
                message(
                    "health.sensor.cells",
                    "{signal}: more than half of the cells are at their maximum",
                    signal=self.info.kind,
                ),
                {},
            )
        lower, upper = PLAUSIBLE.get((info.kind, info.unit), (-np.inf, np.inf))
        if (values < lower).any() or (values > upper).any():
            return (
                SensorFault.UNIT,
                message(
                    "health.sensor.outside",
                    "{signal}: a value outside {lower} to {upper} {unit}",
                    signal=self.info.kind,
                    lower=lower,
                    upper=upper,
                    unit=info.unit,
                ),
                {},
            )
        if info.kind not in WAVEFORMS or info.rate_hz is None:
            return None
        return self._flat_fault(samples) or self._level_fault(samples)

    def _flat_fault(self, samples: Samples) -> Finding | None:
        """Find channels that keep one value; a part of them that do at an extreme is clipped."""
        rate_hz = samples.info.rate_hz or 1.0
        values = samples.values
        rows = values if self._last_row is None else np.vstack((self._last_row, values))
        same = np.diff(rows, axis=0) == 0
        limit_s = FLAT_AFTER_S.get(self.info.kind, 5.0)
        longest_s = np.zeros(values.shape[1])
        for channel in range(values.shape[1]):
            changes = np.flatnonzero(~same[:, channel])
            if len(changes):
                runs = np.diff(np.concatenate(([-1], changes, [len(same)]))) - 1
                runs_s = runs / rate_hz
                runs_s[0] += self._constant_s[channel]
                longest_s[channel] = runs_s.max()
                self._constant_s[channel] = runs_s[-1]
                at_extreme = self._is_clipped(values[:, channel], rate_hz)
            else:
                self._constant_s[channel] += len(same) / rate_hz
                longest_s[channel] = self._constant_s[channel]
                at_extreme = False
            if at_extreme:
                return (
                    SensorFault.SATURATED,
                    message("health.sensor.clipped", "{signal}: clipped at one value", signal=self.info.kind),
                    {},
                )
        if longest_s.min() >= limit_s:
            return (
                SensorFault.FLAT,
                message(
                    "health.sensor.constant",
                    "{signal}: one value for {seconds} s",
                    signal=self.info.kind,
                    seconds=round(float(longest_s.min()), 1),
                ),
                {},
            )
        return None

    def _is_clipped(self, values: Floats, rate_hz: float) -> bool:
        """Return whether an extreme of a varying block repeats in a row for 0.06 s."""
        if self.info.kind not in {SignalKind.ECG, SignalKind.ACCELERATION, SignalKind.PPG} or len(values) < 8:
            return False
        distinct = len(np.unique(values))
        if distinct < 4:
            return False
        need = max(4, round(0.06 * rate_hz))
        for extreme in (values.max(), values.min()):
            at = np.concatenate(([0], (values == extreme).astype(int), [0]))
            edges = np.diff(at)
            if (np.flatnonzero(edges == -1) - np.flatnonzero(edges == 1)).max() >= need:
                return True
        return False

    def _level_fault(  # noqa: PLR0911 -- one return a rule
        self, samples: Samples
    ) -> Finding | None:
        kind, values = self.info.kind, samples.values
        rate_hz = samples.info.rate_hz or 1.0
        if kind is SignalKind.ACCELERATION and values.shape[1] == 3 and self.info.unit in {"MSK", "K40"}:
            size = float(np.median(np.linalg.norm(values, axis=1)))
            gravity = GRAVITY_MPS2 if self.info.unit == "MSK" else 1.0
            if len(values) >= 0.1 * rate_hz and not 0.45 * gravity < size < 2.5 * gravity:
                return (
                    SensorFault.UNIT,
                    message(
                        "health.sensor.other_gravity",
                        "{signal}: gravity is {size}; it must be near {gravity}",
                        signal=self.info.kind,
                        size=round(size, 2),
                        gravity=round(gravity, 2),
                    ),
                    {"gravity": size},
                )
            return None
        if kind not in STEADY_LEVEL:
            return None
        level = float(np.std(np.diff(values[:, 0]))) if len(values) > 2 else 0.0
        # Short packets of an ECG hold a QRS complex or none: the level of those with one is the usual one.
        self._level_s += len(values) / rate_hz
        share = 90 if len(values) >= 0.2 * rate_hz else 97
        usual = float(np.percentile(self._levels, share)) if self._level_s >= MIN_LEVEL_S else None
        duration_s = len(values) / rate_hz
        if usual is None or usual <= 0:
            self._levels.append(level)
            return None
        ratio = level / usual
        if ratio > 30:
            return (
                SensorFault.UNIT,
                message(
                    "health.sensor.rose",
                    "{signal}: its level rose by a factor of {ratio}",
                    signal=self.info.kind,
                    ratio=round(ratio),
                ),
                {"ratio": ratio},
            )
        if ratio > 10:
            return (
                SensorFault.ARTEFACT,
                message(
                    "health.sensor.rose",
                    "{signal}: its level rose by a factor of {ratio}",
                    signal=self.info.kind,
                    ratio=round(ratio),
                ),
                {"ratio": ratio},
            )
        if kind is not SignalKind.ECG:
            self._levels.append(level)
            return None
        if ratio >= 0.12:
            self._quiet_runs_s.append(self._quiet_s)
            self._quiet_s = 0.0
        else:
            self._quiet_s += duration_s
        # A slow heart is quiet for longer between its beats than a strap that is off may stay unnoticed.
        allowed_s = max(MIN_QUIET_S, 1.3 * max(self._quiet_runs_s, default=MIN_QUIET_S))
        if ratio < 1 / 500 or self._quiet_s > allowed_s:
            return (
                SensorFault.NO_CONTACT,
                message(
                    "health.sensor.fell",
                    "{signal}: its level fell to {ratio} of the usual one",
                    signal=self.info.kind,
                    ratio=round(ratio, 3),
                ),
                {"ratio": ratio},
            )
        self._levels.append(level)
        return None
