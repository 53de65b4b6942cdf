"""Samples that cannot be of a body, found before anything analyses, shows or records them. Pure.

`ValueChecks.take` judges each packet of one signal. The first of these faults sets the quality to 0:

| fault | found by |
|---|---|
| noContact | the device reports it; an ECG becomes quiet, as with a strap that was taken off |
| artefact | NaN, infinite, or a level 10 times the usual one of this ECG, PPG or breathing signal |
| saturated | samples at the bounds of the sensor, or clipped at one value |
| unit | values that no body has in this unit, gravity far from 9.8 m/s2, a level 30 times the usual one |
| flat | one value for longer than a body signal can keep it |

After a fault a waveform is used again when `SETTLE_S` of good samples have come: transients of amplifiers are
no values. Times, gaps and rates are those of `monitor`. Kept are figures of the last seconds, and at most 2 s
of samples.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from handover.messages import message
from handover_body.checks.quiet import QuietEcg
from handover_body.model.signals import Samples, SensorFault, SignalInfo, SignalKind

Floats = NDArray[np.float64]

SETTLE_S: Final = 1.0
FAST_HZ: Final = 10.0
"""Slower signals are single values, for which one sample decides."""
GRAVITY_MPS2: Final = 9.80665
MIN_LEVEL_S: Final = 2.2
"""So much signal shows the usual level: one beat at least."""
_BLOCK_S: Final = 2.0
_UNIT_FACTOR: Final = 100.0

NEVER_ZERO: Final = frozenset(
    {SignalKind.HEART_RATE, SignalKind.INTER_BEAT_INTERVAL, SignalKind.BREATHING_RATE, SignalKind.SPO2}
)
"""Values that devices send as 0 before they have measured anything."""
ELECTRODES: Final = frozenset(
    {SignalKind.ECG, SignalKind.EMG, SignalKind.EEG, SignalKind.EOG, SignalKind.ICG, SignalKind.PPG,
     SignalKind.BCG}
)  # fmt: skip
"""Kinds of which no channel is ever constant on a body; of other waveforms all channels have to be."""
WAVEFORMS: Final = ELECTRODES | {
    SignalKind.EDA, SignalKind.RESPIRATION, SignalKind.ACCELERATION, SignalKind.ANGULAR_VELOCITY,
    SignalKind.MAGNETIC_FIELD, SignalKind.JOINT_ANGLES, SignalKind.JOINT_MOMENTS,
}  # fmt: skip
STEADY_LEVEL: Final = frozenset({SignalKind.ECG, SignalKind.PPG, SignalKind.RESPIRATION})
"""Kinds whose level does not rise tenfold while they mean anything. A muscle or an arm may."""
CLIPPING: Final = frozenset({SignalKind.ECG, SignalKind.ACCELERATION, SignalKind.PPG})

FLAT_AFTER_S: Final[dict[SignalKind, float]] = {
    **dict.fromkeys(ELECTRODES, 0.5),
    SignalKind.PPG: 0.6,
    SignalKind.ACCELERATION: 0.65,
    SignalKind.RESPIRATION: 3.0,
}
"""The others after 5 s."""

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
ECG_SPREAD_UV: Final = (5.0, 50_000.0)
"""Peak to peak of an ECG at the skin in microvolt, with room for artefacts; volts lie outside."""
_MICROVOLTS: Final = {"D82": 1.0, "2Z": 1e3, "VLT": 1e6}


@dataclass(frozen=True, slots=True)
class Finding:
    """A fault of a packet, what a person should know of it, and figures."""

    fault: SensorFault
    text: str
    details: dict[str, float]


@dataclass(frozen=True, slots=True)
class Judged:
    """The values, with NaN for what is none, their quality, and the fault that took it."""

    values: Floats
    quality: float
    finding: Finding | None = None


class ValueChecks:
    """The checks of the values of one signal of one sensor."""

    def __init__(self, info: SignalInfo) -> None:
        self._info: Final = info
        self._is_wave: Final = info.kind in WAVEFORMS and (info.rate_hz or 0.0) >= FAST_HZ
        self._settle_s = 0.0
        self._has_value = False
        """Whether the packet before had one."""
        self._flat: Final = _Flat(info) if self._is_wave else None
        self._levels: Final = _Levels(info) if self._is_wave and info.kind in STEADY_LEVEL else None
        self._magnitude: Final = _Magnitude(info) if self._is_wave else None
        self._quiet: Final = (
            QuietEcg(info.rate_hz) if self._is_wave and info.kind is SignalKind.ECG and info.rate_hz else None
        )

    def take(self, samples: Samples) -> Judged:
        """Judge the samples of one packet; those before it are the samples taken before."""
        info = self._info
        values = np.where(np.isinf(samples.values), np.nan, samples.values)
        if info.kind in NEVER_ZERO:
            values = np.where(values <= 0.0, np.nan, values)
        if not self._is_wave and info.kind is not SignalKind.PRESSURE_MAP:
            values = np.where((values > info.max_value) | (values < info.min_value), np.nan, values)
        fault = next(self._found(samples, values), None)
        if fault is not None:
            self._settle_s = SETTLE_S if self._is_wave else 0.0
            self._has_value = False
            return Judged(values, 0.0, fault)
        quality = samples.quality if samples.quality <= 1.0 and not np.isnan(values).all() else 0.0
        self._has_value = quality > 0
        if self._settle_s > 0:
            self._settle_s -= len(values) / (info.rate_hz or 1.0)
            quality = quality if self._settle_s <= 0 else 0.0
        return Judged(values, quality)

    def _found(self, samples: Samples, values: Floats) -> Iterator[Finding]:
        """Give the faults of a packet, the surest first."""
        info, raw = self._info, samples.values
        if samples.has_contact is False:
            text = message("health.sensor.contact", "the sensor does not touch the body")
            yield Finding(SensorFault.NO_CONTACT, text, {})
        yield from self._saturated(raw)
        if np.isinf(raw).any():
            text = message("health.sensor.infinite", "{signal}: an infinite value", signal=info.kind)
            yield Finding(SensorFault.ARTEFACT, text, {})
        if not self._is_wave and np.isnan(values).all() and not self._has_value:
            return  # devices send 0 until they have measured
        if np.isnan(values).any() or not samples.quality > 0:
            text = message(
                "health.sensor.unmeasured",
                "{signal}: the device could not measure some samples",
                signal=info.kind,
            )
            yield Finding(SensorFault.ARTEFACT, text, {})
        lower, upper = PLAUSIBLE.get((info.kind, info.unit), (-np.inf, np.inf))
        if (values < lower).any() or (values > upper).any():
            text = message(
                "health.sensor.outside",
                "{signal}: a value outside {lower} to {upper} {unit}",
                signal=info.kind,
                lower=lower,
                upper=upper,
                unit=info.unit,
            )
            yield Finding(SensorFault.UNIT, text, {})
        for check in (self._flat, self._levels, self._magnitude):
            if check is not None:
                yield from check.take(values)
        if self._quiet is not None and (quiet_s := self._quiet.take(values[:, 0])) is not None:
            text = message(
                "health.sensor.quiet",
                "{signal}: no beat for {seconds} s; is the sensor off?",
                signal=info.kind,
                seconds=round(quiet_s, 1),
            )
            yield Finding(SensorFault.NO_CONTACT, text, {"quiet_s": quiet_s})

    def _saturated(self, values: Floats) -> Iterator[Finding]:
        info = self._info
        if self._is_wave:
            if ((values <= info.min_value) | (values >= info.max_value)).any():
                yield Finding(SensorFault.SATURATED, _saturated_text(info), {})
        elif info.kind is SignalKind.PRESSURE_MAP:
            if (values >= info.max_value).mean() > 0.5:
                text = message(
                    "health.sensor.cells",
                    "{signal}: more than half of the cells are at their maximum",
                    signal=info.kind,
                )
                yield Finding(SensorFault.SATURATED, text, {})
        elif (np.isfinite(values) & ((values > info.max_value) | (values < info.min_value))).any():
            yield Finding(SensorFault.SATURATED, _saturated_text(info), {})


def _saturated_text(info: SignalInfo) -> str:
    return message("health.sensor.saturated", "{signal}: values at the bound of the sensor", signal=info.kind)


class _Flat:
    """Channels that keep one value: all the time, or at an extreme, where they are clipped."""

    def __init__(self, info: SignalInfo) -> None:
        self._info = info
        self._rate_hz = info.rate_hz or 1.0
        self._constant_s = np.zeros(len(info.channels))
        self._last: Floats | None = None

    def take(self, values: Floats) -> Iterator[Finding]:
        kind = self._info.kind
        rows = values if self._last is None else np.vstack((self._last, values))
        self._last = values[-1:].copy()
        same = np.diff(rows, axis=0) == 0
        longest_s = np.zeros(values.shape[1])
        is_clipped = False
        for channel in range(values.shape[1]):
            changes = np.flatnonzero(~same[:, channel])
            if len(changes):
                runs_s = (np.diff(np.concatenate(([-1], changes, [len(same)]))) - 1) / self._rate_hz
                runs_s[0] += self._constant_s[channel]
                longest_s[channel] = runs_s.max()
                self._constant_s[channel] = runs_s[-1]
                is_clipped |= kind in CLIPPING and _is_clipped(values[:, channel], self._rate_hz)
            else:
                self._constant_s[channel] += len(same) / self._rate_hz
                longest_s[channel] = self._constant_s[channel]
        if is_clipped:
            text = message("health.sensor.clipped", "{signal}: clipped at one value", signal=kind)
            yield Finding(SensorFault.SATURATED, text, {})
        flat_s = float(longest_s.max() if kind in ELECTRODES else longest_s.min())
        if flat_s >= FLAT_AFTER_S.get(kind, 5.0):
            text = message(
                "health.sensor.constant",
                "{signal}: one value for {seconds} s",
                signal=kind,
                seconds=round(flat_s, 1),
            )
            yield Finding(SensorFault.FLAT, text, {})


def _is_clipped(values: Floats, rate_hz: float) -> bool:
    """Return whether an extreme of a varying block repeats in a row for 0.06 s."""
    if len(values) < 8 or len(np.unique(values)) < 4:
        return False
    need = max(4, round(0.06 * rate_hz))
    for extreme in (values.max(), values.min()):
        at = np.concatenate(([0], (values == extreme).astype(int), [0]))
        edges = np.diff(at)
        if (np.flatnonzero(edges == -1) - np.flatnonzero(edges == 1)).max() >= need:
            return True
    return False


class _Levels:
    """Whether the level of a packet has risen far above the usual one of the last packets."""

    def __init__(self, info: SignalInfo) -> None:
        self._info = info
        self._rate_hz = info.rate_hz or 1.0
        self._levels: deque[float] = deque(maxlen=80)
        self._level_s = 0.0

    def take(self, values: Floats) -> Iterator[Finding]:
        level = float(np.std(np.diff(values[:, 0]))) if len(values) > 2 else 0.0
        # Short packets of an ECG hold a QRS complex or none: the level of those with one is the usual one.
        self._level_s += len(values) / self._rate_hz
        share = 90 if len(values) >= 0.2 * self._rate_hz else 97
        is_known = self._level_s >= MIN_LEVEL_S and bool(self._levels)
        usual = float(np.percentile(self._levels, share)) if is_known else 0.0
        ratio = level / usual if usual > 0 else 1.0
        if ratio <= 10:
            self._levels.append(level)
            return
        text = message(
            "health.sensor.rose",
            "{signal}: its level rose by a factor of {ratio}",
            signal=self._info.kind,
            ratio=round(ratio),
        )
        yield Finding(
            SensorFault.UNIT if ratio > 30 else SensorFault.ARTEFACT, text, {"ratio": round(ratio, 1)}
        )


class _Magnitude:
    """Whether values have the order of magnitude of their unit: gravity at once, others in blocks of 2 s."""

    def __init__(self, info: SignalInfo) -> None:
        self._info = info
        self._rate_hz = info.rate_hz or 1.0
        self._is_watched = info.kind in ELECTRODES
        self._block: list[Floats] = []
        self._count = 0
        self._typical: float | None = None
        self._odd = 0
        self._last: Finding | None = None
        """The finding of the last block, which holds until the next one."""

    def take(self, values: Floats) -> Iterator[Finding]:
        info = self._info
        if info.kind is SignalKind.ACCELERATION:
            yield from self._gravity(values)
        if not self._is_watched:
            return
        self._block.append(values)
        self._count += len(values)
        if self._count >= _BLOCK_S * self._rate_hz:
            self._last = self._found(np.concatenate(self._block))
            self._block, self._count = [], 0
        if self._last is not None:
            yield self._last

    def _gravity(self, values: Floats) -> Iterator[Finding]:
        info = self._info
        if info.unit not in {"MSK", "K40"} or values.shape[1] != 3 or len(values) < 0.1 * self._rate_hz:
            return
        gravity = GRAVITY_MPS2 if info.unit == "MSK" else 1.0
        size = float(np.median(np.linalg.norm(values, axis=1)))
        if not 0.45 * gravity < size < 2.5 * gravity:
            text = message(
                "health.sensor.gravity",
                "{signal}: gravity is {size}; it must be near {gravity}. Is it another unit?",
                signal=info.kind,
                size=float(f"{size:.3g}"),
                gravity=round(gravity, 2),
            )
            yield Finding(SensorFault.UNIT, text, {"gravity": size})

    def _found(self, block: Floats) -> Finding | None:
        spread = float(np.nanmax(np.nanmax(block, axis=0) - np.nanmin(block, axis=0)))
        factor = _MICROVOLTS.get(self._info.unit)
        if self._info.kind is SignalKind.ECG and factor is not None:
            lower, upper = ECG_SPREAD_UV
            if not lower <= spread * factor <= upper:
                text = message(
                    "health.sensor.no_ecg",
                    "{signal}: {spread} {unit} peak to peak is no ECG; is it another unit?",
                    signal=self._info.kind,
                    spread=float(f"{spread:.3g}"),
                    unit=self._info.unit,
                )
                return Finding(SensorFault.UNIT, text, {})
        return self._compared(spread)

    def _compared(self, spread: float) -> Finding | None:
        if spread <= 0:
            return self._last
        if self._typical is None:
            self._typical = spread
            return None
        ratio = spread / self._typical
        if 1 / _UNIT_FACTOR < ratio < _UNIT_FACTOR:
            self._typical *= max(0.8, min(1.25, ratio))
            self._odd = 0
            return None
        self._odd += 1
        if self._odd < 2:
            return None
        text = message(
            "health.sensor.factor",
            "{signal}: the values changed by a factor of {factor}; did the unit change?",
            signal=self._info.kind,
            factor=float(f"{ratio:.3g}"),
        )
        return Finding(SensorFault.UNIT, text, {})
